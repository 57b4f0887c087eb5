"""What DQN learns from a minibatch, compiled: the gradients by all weights, in one pass over the rows.

For networks that :mod:`pearl_marl.policies.dense` can do. It does what DQN's own operations of PyTorch do.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.policies import dense
from pearl_marl.policies.dense import (
    ROWS,
    Given,
    Layers,
    ahead,
    back,
    given_back,
    padded,
    sums,
    tile,
)
from pearl_marl.policies.network import MASKED

Array = npt.NDArray[Any]

_MASKED = np.float32(MASKED)


class Steps(NamedTuple):
    """What was done and what came of it, a row each."""

    actions: Array  # int64
    rewards: Array  # float32
    over: Array  # whether that was the end
    alive: Array  # whether the agent was there; who was not is not learned from
    masks: Array  # (n, outputs), 0 for what was not allowed next; or (0, 0)


def _learn(
    policy: Layers,
    target: Layers,
    gradients: Layers,
    seen: Given,
    arrivals: Given,
    judged: Given,
    steps: Steps,
    discount: float,
) -> float:
    """Compute the gradients of Huber's loss, with double estimation; return the loss.

    ``arrivals`` and ``judged`` are the same observations for the policy and for the target, each of which has
    its own statistics to standardise them by.
    """
    n, outputs = len(steps.actions), len(policy.bias3)
    weights, target_weights = padded(policy), padded(target)
    out = len(weights.bias3)
    room, target_room, total = tile(policy), tile(target), sums(gradients)
    there = 0
    for row in range(n):
        there += steps.alive[row]
    share, loss = 1 / max(there, 1), 0.0
    numbers, masked = np.arange(n), len(steps.masks) > 0
    wanted = np.empty(ROWS)
    for first in range(0, n, ROWS):
        some = numbers[first : first + ROWS]
        ahead(policy, weights, arrivals, some, room)
        ahead(target, target_weights, judged, some, target_room)
        for s in range(len(some)):
            row, best, most = some[s], 0, _MASKED
            for k in range(outputs):
                value = room.outputs[s * out + k]
                if value > most and not (masked and steps.masks[row, k] == 0):
                    best, most = k, value
            later = 0.0 if steps.over[row] else discount * target_room.outputs[s * out + best]
            wanted[s] = steps.rewards[row] + later
        ahead(policy, weights, seen, some, room)
        for s in range(len(some)):
            row = some[s]
            apart = room.outputs[s * out + steps.actions[row]] - wanted[s]
            near = min(max(apart, -1.0), 1.0)
            room.outputs[s * out : (s + 1) * out] = 0
            if steps.alive[row]:
                loss += (apart - 0.5 * near) * near * share
                room.outputs[s * out + steps.actions[row]] = near * share
        room.outputs[len(some) * out :] = 0
        back(policy, weights, seen, some, room, total, gradients)
    given_back(total, gradients)
    return loss


learn = compiled_loop(_learn, dense)
