"""The gradients of losses of action values, compiled: by all weights, in one pass over a minibatch.

They are those that autograd finds for ``PQN.autograd``, ``VDN.autograd`` and ``DQN.gradients``. The networks
are those of :mod:`pearl_marl.policies.dense`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from torch import Tensor

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
from pearl_marl.policies.network import MASKED, Pictures, is_dense, takes_planes
from pearl_marl.training.action_values import ActionValues
from pearl_marl.training.halves import Halves
from pearl_marl.training.mixers import SumMixer
from pearl_marl.training.rollout import RolloutBuffer

_MASKED = np.float32(MASKED)


def _gradients(
    layers: Layers,
    gradients: Layers,
    inputs: NetworkInputs,
    actions: Array,
    returns: Array,
    acting: Array,
    team: int,
    rows: Array,
    share: float,
) -> float:
    """Compute the gradients of the squared errors of some teams, of ``team`` rows each; return their loss.

    A team's value is the sum of those of its agents that are ``acting``. ``share`` is that of a team in the
    loss.
    """
    n, weights, tile, total = len(rows), padded(layers), tile_of(layers), gradient_sums(gradients)
    out, loss, step = len(weights.bias3), 0.0, ROWS // team * team
    for first in range(0, n, step):
        some = rows[first : first + step]
        forward_rows(layers, weights, inputs, some, tile)
        for start in range(0, len(some), team):
            error = -returns[some[start]]
            for s in range(start, start + team):
                if acting[some[s]]:
                    error += tile.outputs[s * out + actions[some[s]]]
            loss += 0.5 * error * error
            for s in range(start, start + team):
                tile.outputs[s * out : (s + 1) * out] = 0
                if acting[some[s]]:
                    tile.outputs[s * out + actions[some[s]]] = error * share
        tile.outputs[len(some) * out :] = 0
        backward_rows(layers, weights, inputs, some, tile, total, gradients)
    store_gradients(total, gradients)
    return loss * share


_gradients_of = compiled_loop(_gradients, dense, fused=True)


def fits(model: ActionValues, team: int = 1) -> bool:
    """Return whether these loops can learn a model, of teams of so many agents."""
    network = model.policy.network
    summed = model.mixer is None or isinstance(model.mixer, SumMixer)
    return summed and team <= ROWS and (is_dense(network) or takes_planes(network))


class PQNGradients:
    """Finds gradients for minibatches of a rollout, whose steps and agents are one axis.

    Called with the rows of a minibatch, or the worlds of one with a ``team`` of agents each, it leaves the
    gradients with the model's parameters, and returns what ``PQN.autograd`` or ``VDN.autograd`` returns.
    """

    def __init__(self, model: ActionValues, rollout: RolloutBuffer, team: int = 1) -> None:
        network: Any = model.policy.network
        inputs = rollout.inputs
        self._pictures: Pictures | None = None
        if takes_planes(network):
            self._pictures = Pictures(network, inputs.obs, inputs.position)
            self._inputs, gradients = self._pictures.inputs, self._pictures.gradients
        else:
            self._inputs, self._weights = network.observed(inputs.obs, inputs.position), network.layers()
            gradients = network.layers
        self._actions = rollout.actions.contiguous().numpy()
        self._returns = rollout.returns.contiguous().numpy()
        self._acting, self._team = rollout.loss_mask.contiguous().numpy(), np.arange(team)
        width = team * network.hidden.in_features
        self._halves = Halves(model, width, gradients)

    def __call__(self, rows: Tensor) -> Tensor:
        """Find the gradients of some rows, or worlds."""
        share, team = 1 / len(rows), len(self._team)

        def half(some: Array, gradients: Any) -> Array:
            agents = (some[:, None] * team + self._team).ravel()
            samples = self._inputs, self._actions, self._returns, self._acting, team, agents, share
            if self._pictures is None:
                return np.array([_gradients_of()(self._weights, gradients, *samples)])
            with self._pictures.first_layer(agents, gradients) as (weights, by_weights):
                return np.array([_gradients_of()(weights, by_weights, *samples)])

        return self._halves.find(rows.numpy(), half)


class Steps(NamedTuple):
    """Actions and their consequences, a row for each."""

    actions: Array  # int64
    rewards: Array  # float32
    over: Array  # whether the episode ended
    alive: Array  # whether the agent took part; if not, the row is not learned from
    masks: Array  # (n, outputs), 0 for actions that were not allowed next; or (0, 0)


def _huber_gradients(
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
    share, loss = 1 / max(int(np.count_nonzero(steps.alive)), 1), 0.0
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


huber_gradients_of = compiled_loop(_huber_gradients, dense, fused=True)
