"""Policies: loading one from what people have, running it, and the network that the trainers learn."""

from pearl_marl.policies.loading import RANDOM, Policy, load_policy, random_policy, table_policy

__all__ = ["RANDOM", "Policy", "load_policy", "random_policy", "table_policy"]
