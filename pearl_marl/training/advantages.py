"""How much better than expected it went: generalised advantage estimation (arXiv:1506.02438), agent by agent.

Agents need not act in every step. Who waits for its turn, or for its world to end, has nothing to decide.
What it earns meanwhile belongs to its last decision, which led to where it decides again.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Course(NamedTuple):
    """What happened, a row a step and a column an agent."""

    rewards: Tensor  # with the discounted value of what was to come, where a time limit cut it off
    values: Tensor  # what the critic expected; a row more, of where the last step led
    ended: Tensor
    acting: Tensor  # who decided something; a row more
    unknown: Tensor  # who cannot say what was to come after this step


def advantages(course: Course, discount: float, trace: float) -> tuple[Tensor, Tensor]:
    """Return the advantages, and whether there is something to learn from in each step."""
    if course.acting.all() and not course.unknown.any():
        return _of_every_step(course, discount, trace), course.acting[:-1]
    return _of_decisions(course, discount, trace)


def _of_every_step(course: Course, discount: float, trace: float) -> Tensor:
    values = course.values
    going_on = (~course.ended).float() * discount
    errors = course.rewards + values[1:] * going_on - values[:-1]
    going_on *= trace
    result = torch.empty_like(errors)
    advantage = torch.zeros_like(errors[0])
    for t in reversed(range(len(errors))):
        advantage = torch.addcmul(errors[t], going_on[t], advantage)
        result[t] = advantage
    return result


def _of_decisions(course: Course, discount: float, trace: float) -> tuple[Tensor, Tensor]:
    """Return the same where steps lie between an agent's decisions; those are not discounted.

    A decision of which is not known where it led is not learned from: the one before it goes by its value.
    """
    rewards, values, ended, acting, unknown = course
    result, learned = torch.zeros_like(rewards), acting[:-1].clone()
    # Of the decision that comes next: its value and advantage, whether it is known, what is earned before it.
    value, advantage = values[-1] * acting[-1], torch.zeros_like(rewards[0])
    known, earned = acting[-1], torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        over, acts = ended[t], acting[t]
        value, advantage, earned = (part.masked_fill(over, 0) for part in (value, advantage, earned))
        known = (known | over) & ~unknown[t]
        earned = earned + rewards[t]
        new = earned + discount * value - values[t] + discount * trace * advantage
        new = new.masked_fill(~known, 0)
        result[t] = new.masked_fill(~acts, 0)
        learned[t] &= known
        value, advantage = torch.where(acts, values[t], value), torch.where(acts, new, advantage)
        known, earned = known | acts, earned.masked_fill(acts, 0)
    return result, learned
