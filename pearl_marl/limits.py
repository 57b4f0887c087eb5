"""Limits of what has none of its own, apart from what takes long to import."""

MANY = 10**12
"""The most of anything that is counted: more would never end."""
