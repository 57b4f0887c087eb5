"""MountainCar: rock a weak car up a hill, in fixed point. Read ``step.py`` first, then ``spec.py``."""
