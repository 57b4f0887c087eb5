"""Inventory: order goods along a chain of suppliers, neither too few nor too many."""
