"""Throughput of this package and of its peers, measured side by side.

May import ``interfaces``, ``wrappers`` and what is below them.
"""
