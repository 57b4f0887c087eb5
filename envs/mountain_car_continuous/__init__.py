"""MountainCarContinuous: drive an underpowered car up a hill, with as little force as possible."""
