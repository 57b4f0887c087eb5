"""The gradients of DQN's loss, compiled: by all weights of a small network, in one pass over a minibatch.

They are those that autograd finds for ``DQN.gradients``. The networks are those of
:mod:`pearl_marl.policies.dense`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.policies import dense
from pearl_marl.policies.dense import (
    ROWS,
    Layers,
    NetworkInputs,
    backward_rows,
    forward_rows,
    gradient_sums,
    padded,
    store_gradients,
    tile_of,
)
from pearl_marl.policies.network import MASKED

_MASKED = np.float32(MASKED)


class Steps(NamedTuple):
    """Actions and their consequences, a row for each."""

    actions: Array  # int64
    rewards: Array  # float32
    over: Array  # whether the episode ended
    alive: Array  # whether the agent took part; if not, the row is not learned from
    masks: Array  # (n, outputs), 0 for actions that were not allowed next; or (0, 0)


def _gradients(
    policy: Layers,
    target: Layers,
    gradients: Layers,
    inputs: NetworkInputs,
    next_inputs: NetworkInputs,
    target_inputs: NetworkInputs,
    steps: Steps,
    discount: float,
) -> float:
    """Compute the gradients of Huber's loss, with double estimation; return the loss.

    ``next_inputs`` and ``target_inputs`` are the same observations for the policy and for the target, which
    standardise them by statistics of their own.
    """
    n, outputs = len(steps.actions), len(policy.bias3)
    weights, target_weights = padded(policy), padded(target)
    out = len(weights.bias3)
    tile, target_tile, total = tile_of(policy), tile_of(target), gradient_sums(gradients)
    there = 0
    for row in range(n):
        there += steps.alive[row]
    share, loss = 1 / max(there, 1), 0.0
    numbers, masked = np.arange(n), len(steps.masks) > 0
    wanted = np.empty(ROWS)
    for first in range(0, n, ROWS):
        some = numbers[first : first + ROWS]
        forward_rows(policy, weights, next_inputs, some, tile)
        forward_rows(target, target_weights, target_inputs, some, target_tile)
        for s in range(len(some)):
            row, best, most = some[s], 0, _MASKED
            for k in range(outputs):
                value = tile.outputs[s * out + k]
                if value > most and not (masked and steps.masks[row, k] == 0):
                    best, most = k, value
            later = 0.0 if steps.over[row] else discount * target_tile.outputs[s * out + best]
            wanted[s] = steps.rewards[row] + later
        forward_rows(policy, weights, inputs, some, tile)
        for s in range(len(some)):
            row = some[s]
            error = tile.outputs[s * out + steps.actions[row]] - wanted[s]
            near = min(max(error, -1.0), 1.0)
            tile.outputs[s * out : (s + 1) * out] = 0
            if steps.alive[row]:
                loss += (error - 0.5 * near) * near * share
                tile.outputs[s * out + steps.actions[row]] = near * share
        tile.outputs[len(some) * out :] = 0
        backward_rows(policy, weights, inputs, some, tile, total, gradients)
    store_gradients(total, gradients)
    return loss


gradients_of = compiled_loop(_gradients, dense, fused=True)
