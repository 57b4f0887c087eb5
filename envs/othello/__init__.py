"""Othello: two players place discs that turn the other's, and the one with more in the end wins."""
