"""The gradients of PQN's loss, compiled: by all weights of a small network, in one pass over a minibatch.

They are those that autograd finds for ``PQN.autograd``. The networks are those of
:mod:`pearl_marl.policies.dense`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
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
from pearl_marl.policies.network import Pictures, takes_planes
from pearl_marl.training.action_values import ActionValues
from pearl_marl.training.halves import Halves
from pearl_marl.training.rollout import RolloutBuffer


def _gradients(
    layers: Layers,
    gradients: Layers,
    inputs: NetworkInputs,
    actions: Array,
    returns: Array,
    rows: Array,
    share: float,
) -> float:
    """Compute the gradients of the squared errors of some rows; return their loss.

    ``share`` is that of a row in the loss.
    """
    n, weights, tile, total = len(rows), padded(layers), tile_of(layers), gradient_sums(gradients)
    out, loss = len(weights.bias3), 0.0
    for first in range(0, n, ROWS):
        some = rows[first : first + ROWS]
        forward_rows(layers, weights, inputs, some, tile)
        for s in range(len(some)):
            row, start = some[s], s * out
            error = tile.outputs[start + actions[row]] - returns[row]
            loss += 0.5 * error * error
            tile.outputs[start : start + out] = 0
            tile.outputs[start + actions[row]] = error * share
        tile.outputs[len(some) * out :] = 0
        backward_rows(layers, weights, inputs, some, tile, total, gradients)
    store_gradients(total, gradients)
    return loss * share


_gradients_of = compiled_loop(_gradients, dense, fused=True)


class PQNGradients:
    """Finds gradients for minibatches of a rollout, whose steps and agents are one axis.

    Called with the rows of a minibatch, it leaves the gradients with the model's parameters, and returns what
    ``PQN.autograd`` returns.
    """

    def __init__(self, model: ActionValues, rollout: RolloutBuffer) -> None:
        network: Any = model.policy.network
        inputs = rollout.inputs
        self._network, self._pictures = network, None
        if takes_planes(network):
            self._pictures = Pictures(network, inputs.obs, inputs.position)
            self._inputs = self._pictures.inputs
        else:
            self._inputs = network.observed(inputs.obs, inputs.position)
        self._actions = rollout.actions.contiguous().numpy()
        self._returns = rollout.returns.contiguous().numpy()
        self._halves = Halves(model, network.hidden.in_features, lambda tensors: tensors)

    def __call__(self, rows: Tensor) -> Tensor:
        """Find the gradients of some rows."""
        share = 1 / len(rows)

        def half(some: Array, gradients: Mapping[Tensor, Tensor]) -> Array:
            layers, samples = self._network.layers, (self._inputs, self._actions, self._returns, some, share)
            if self._pictures is None:
                return np.array([_gradients_of()(layers(), layers(gradients), *samples)])
            with self._pictures.first_layer(torch.from_numpy(some), gradients) as (made, by_made):
                weights, by_weights = layers(made=made), layers(gradients, by_made)
                return np.array([_gradients_of()(weights, by_weights, *samples)])

        return self._halves.find(rows.numpy(), half)
