"""Seaquest: submarines, fish and divers, as MinAtar has them. ``step.py`` says how its lists are kept."""
