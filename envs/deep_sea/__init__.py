"""DeepSea: dive along the one way that leads to the treasure."""
