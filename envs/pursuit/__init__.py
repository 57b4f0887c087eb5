"""Pursuit: pursuers surround evaders, who walk at random around a building."""
