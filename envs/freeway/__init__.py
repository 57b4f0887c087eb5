"""Freeway: a chicken crosses eight lanes of cars, as MinAtar has it."""
