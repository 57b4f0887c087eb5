"""Taxi: pick up a passenger and drive to the destination."""
