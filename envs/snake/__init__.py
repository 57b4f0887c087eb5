"""Snake: eat fruit, grow longer with each, and run into nothing."""
