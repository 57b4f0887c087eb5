"""Game2048: slide tiles over a board, and merge those that are equal."""
