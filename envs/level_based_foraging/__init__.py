"""LevelBasedForaging: players of different levels pick up food, much of it only together."""
