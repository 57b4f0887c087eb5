"""Overcooked: two cooks share a kitchen, put onions into pots, wait, and serve the soup."""
