"""The actions of a network of floats, chosen beside the environments of the CPU.

Trainings gather rollouts by it, with noise, and evaluate what they have learned, without. Its floats are
rounded as this processor does, so another machine may take another action where two are about as good.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, NamedTuple

import numpy as np
from numba import types

from pearl_marl.base.arrays import Array
from pearl_marl.compiler import addresses
from pearl_marl.compiler.addresses import address_of, fields_at, in_memory
from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.policies import dense, integer_vectors
from pearl_marl.policies.dense import ROWS, Layers, NetworkInputs, Vector, forward_rows, padded, tile_of
from pearl_marl.policies.device_policy import (
    ACT_ARGUMENTS,
    ActionChoice,
    CompiledPolicy,
    DevicePolicy,
    best_of_fields,
)
from pearl_marl.policies.integer_vectors import take
from pearl_marl.spec import EnvSpec

Numbers = Annotated[Array, types.Array(types.int64, 1, "C")]

_MASKED = np.finfo(np.float32).min  # as in pearl_marl.policies.network, which takes torch


@dataclass(frozen=True, eq=False)
class DenseNetwork(DevicePolicy):
    """A network of :class:`~pearl_marl.policies.dense.Layers` that takes the action of the greatest output.

    ``mean`` and ``scale`` standardise vectors, ``float32``, an element each. Numbers choose rows of a table
    instead, each plus its element of ``offsets``, ``int64``. ``counts`` says how many outputs each field of
    an action has.
    """

    spec: EnvSpec
    layers: Layers
    mean: Array
    scale: Array
    offsets: Array
    counts: tuple[int, ...]

    @property
    def units(self) -> Array:
        """What an element is multiplied by to be what the network was shown, ``float32``."""
        return np.array([2.0**-bits for bits in self.spec.element_fractions], np.float32)

    def choose(self, elements: Array, agents: Array, masks: Array | None, draws: Array) -> ActionChoice:
        """See :class:`DevicePolicy`."""
        n = len(elements)
        x, numbers = np.empty((n, 0), np.float32), np.empty((n, 0), np.int64)
        if len(self.offsets):
            numbers = elements.reshape(n, -1) + self.offsets
        else:
            x = elements.reshape(n, -1).astype(np.float32) * self.units
        position = agents.astype(np.int64) if len(self.layers.indicator) else np.empty(0, np.int64)
        outputs = np.empty((n, len(self.layers.bias3)), np.float32)
        dense.forward()(self.layers, NetworkInputs(x, self.mean, self.scale, numbers, position), outputs)
        if masks is not None:
            outputs = np.where(masks, outputs, -np.inf)
        return ActionChoice(best_of_fields(outputs, self.counts), None)


class DenseFields(NamedTuple):
    """A network as the loop takes it."""

    layers: Layers
    mean: Vector
    scale: Vector
    units: Vector
    offsets: Numbers
    counts: Numbers
    size: int  # bytes of an element
    signed: int  # 1 where it has a sign
    agents: int  # of a world


_network_at = fields_at(DenseFields)


def _act(network, elements, masks, draws, words, logits):  # type: ignore[no-untyped-def]
    net = _network_at(network)
    layers, count = net.layers, len(net.units)
    weights, tile, numbered = padded(layers), tile_of(layers), len(net.offsets) > 0
    taken, rows = np.empty((count, ROWS), np.int64), np.arange(ROWS)
    x = np.empty((0 if numbered else ROWS, count), np.float32)
    numbers = np.empty((ROWS, count if numbered else 0), np.int64)
    position = np.empty(ROWS if len(layers.indicator) else 0, np.int64)
    observed = NetworkInputs(x, net.mean, net.scale, numbers, position)
    outputs, noise, kept = len(weights.bias3), draws.view(np.float32), logits.view(np.float32)
    noisy, keep = noise.shape[1] > 0, kept.shape[1] > 0
    for first in range(0, len(words), ROWS):
        n = min(ROWS, len(words) - first)
        take((elements, taken), (first, n, count, net.size, net.signed, ROWS))
        for s in range(n):
            for k in range(count):
                if numbered:
                    numbers[s, k] = taken[k, s] + net.offsets[k]
                else:
                    x[s, k] = np.float32(taken[k, s]) * net.units[k]
        for s in range(len(position)):
            position[s] = (first + s) % net.agents
        forward_rows(layers, weights, observed, rows[:n], tile)
        for s in range(n):
            start, row = 0, first + s
            for field in range(len(net.counts)):
                best, found, greatest = 0, False, _MASKED
                for j in range(net.counts[field]):
                    output = tile.outputs[s * outputs + start + j]
                    allowed = len(masks) == 0 or masks[row, j] != 0
                    if keep:
                        kept[row, start + j] = output if allowed else _MASKED
                    if noisy:
                        output += noise[row, start + j]
                    if allowed and (not found or output > greatest):
                        best, found, greatest = j, True, output
                words[row, field] = best
                start += net.counts[field]


compiled_act = compiled_loop(_act, addresses, dense, integer_vectors, fused=True)


def compiled(network: DenseNetwork, elements: np.dtype[Any]) -> CompiledPolicy:
    """Return a network as a rollout calls it, for elements of a dtype."""
    fields = DenseFields(
        network.layers,
        network.mean,
        network.scale,
        network.units,
        network.offsets,
        np.array(network.counts, np.int64),
        elements.itemsize,
        int(elements.kind == "i"),
        network.spec.agents,
    )
    return CompiledPolicy(_address_of_act(), in_memory(fields), 0, fields)


@cache
def _address_of_act() -> int:
    return address_of(compiled_act(), *ACT_ARGUMENTS)
