"""Blackjack: get closer to 21 than the dealer, but not beyond."""
