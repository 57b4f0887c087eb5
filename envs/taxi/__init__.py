"""Taxi: fetch a passenger and drive him where he wants to go."""
