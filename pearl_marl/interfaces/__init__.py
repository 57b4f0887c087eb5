"""PettingZoo's and Gymnasium's forms of a batch of slots.

May import ``devices``, ``evaluation`` and what is below them.
"""
