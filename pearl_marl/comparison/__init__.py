"""Comparing two devices' words: where they differ, said in words, and kept in a file that can be replayed.

May import ``batch`` and what is below it.
"""
