"""From a golden function to the graph of what it does, and what is wrong with it."""
