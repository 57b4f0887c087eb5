"""Damaged and crafted files of every kind that the package reads."""
