"""CartPole: balance a pole on a cart, in fixed point. Read ``step.py`` first, then ``spec.py``."""
