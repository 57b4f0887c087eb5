"""SimpleTag: slow adversaries chase faster agents around obstacles."""
