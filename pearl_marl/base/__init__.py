"""What everything stands on: files, the cache folder, compiled code, and calls that signals do not interrupt.

May import ``errors``.
"""
