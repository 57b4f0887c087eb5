"""Asterix: enemies and treasure in eight rows, as MinAtar has them."""
