"""Minesweeper: find every cell of a board that hides no mine."""
