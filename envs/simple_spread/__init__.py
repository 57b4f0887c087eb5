"""SimpleSpread: agents cover landmarks, and keep out of each other's way."""
