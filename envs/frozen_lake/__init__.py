"""FrozenLake: cross a slippery lake without falling through a hole in the ice."""
