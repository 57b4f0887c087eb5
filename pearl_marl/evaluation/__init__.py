"""How well a policy does on a device: runs, what each stage of a step takes, a page about it."""

from pearl_marl.evaluation.matches import Match, cross_table
from pearl_marl.evaluation.run import LIMIT, Evaluation

__all__ = ["LIMIT", "Evaluation", "Match", "cross_table"]
