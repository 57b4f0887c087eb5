"""Catch: move a paddle under a ball that falls."""
