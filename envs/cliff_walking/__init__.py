"""CliffWalking: the tutorial of how an environment is made. Read ``step.py`` first, then ``spec.py``."""
