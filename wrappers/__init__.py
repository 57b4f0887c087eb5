"""Wrappers that work on whole batches."""
