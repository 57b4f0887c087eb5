"""Pendulum: swing it up and hold it there, in fixed point. Read ``step.py`` first, then ``spec.py``."""
