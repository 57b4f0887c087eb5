"""Othello: two players place discs that turn the other's, and who has more in the end wins."""
