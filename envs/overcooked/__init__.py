"""Overcooked: two cooks put onions into pots, wait, and serve the soup, if they do not stand in each other's way."""
