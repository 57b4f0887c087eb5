"""Whole trainings beside those of other packages: each in a process of its own, started in turns.

May import everything but the experiments and ``cli``. Needs the ``train`` extra; for the others, ``peers``.
"""
