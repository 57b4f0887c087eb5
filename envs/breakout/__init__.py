"""Breakout: a paddle, a ball and three rows of bricks, as MinAtar has them."""
