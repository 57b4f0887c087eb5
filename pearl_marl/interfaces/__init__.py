"""PettingZoo's and Gymnasium's forms of a batch of slots."""
