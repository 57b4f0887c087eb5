"""The memory of a recurrent policy: a gated recurrent unit (GRU; Cho et al., 2014, arXiv:1406.1078).

A memory is empty, all zeros, where an episode begins. It moves on where its agent acts: not while the agent
waits for its turn, or for its world to end.

On a CPU, its steps are compiled, forward and back. PyTorch calls a dozen operations for each step, and small
networks would wait for these calls. Here a few agents go through all steps, while their memories are in the
processor's first cache. PyTorch multiplies the features of all steps by the unit's weights beforehand, in one
product.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn.functional import linear

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.policies import dense
from pearl_marl.policies.dense import (
    HIGH,
    ROWS,
    WIDE,
    begin_with,
    called,
    column_sums,
    exponential,
    product,
    rounded_up,
)

MEMORY = ("none", "gru")
"""Possible memories of a policy."""


class Recall(NamedTuple):
    """What some steps of some agents remember."""

    memory: Tensor  # before the first step, (agents, size)
    begins: Tensor | None = None  # (steps, agents): where an episode begins
    acting: Tensor | None = None  # (steps, agents): where it moves on; by default everywhere


def acting(masks: Tensor | None) -> Tensor | None:
    """Return which agents have something to decide, by the masks of their actions."""
    return None if masks is None else (masks != 0).any(-1)


_ONE, _TWO = np.float32(1), np.float32(2)


@called
def _moved(memory: Array, recurrent: Array, given: Array, kept: Array) -> None:
    """Move a memory on by a step of an agent; keep what the way back needs.

    ``given`` is what the step's features add to the reset gate, the update gate and the new memory, three
    parts as wide as the memory; ``recurrent`` is what the memory before adds, each part padded. ``kept`` gets
    both gates, the new memory, and the last part of ``recurrent``.
    """
    size, high = len(memory), len(recurrent) // 3
    of_reset, of_update, of_new = given[:size], given[size : 2 * size], given[2 * size :]
    by_reset, by_update, by_new = recurrent[:size], recurrent[high : high + size], recurrent[2 * high :]
    reset, update = kept[:size], kept[size : 2 * size]
    new, last = kept[2 * size : 3 * size], kept[3 * size :]
    for i in range(size):
        reset[i] = _ONE / (_ONE + exponential(-(of_reset[i] + by_reset[i])))
    for i in range(size):
        update[i] = _ONE / (_ONE + exponential(-(of_update[i] + by_update[i])))
    for i in range(size):
        last[i] = by_new[i]
        new[i] = _ONE - _TWO / (exponential((of_new[i] + reset[i] * by_new[i]) * _TWO) + _ONE)
    for i in range(size):
        memory[i] = new[i] + update[i] * (memory[i] - new[i])


@called
def _moved_back(by_memory: Array, before: Array, kept: Array, by_given: Array, by_recurrent: Array) -> None:
    """Turn the gradient by a memory into the part that goes straight to the memory before.

    Write the gradients by ``given`` and ``recurrent``; the caller takes the latter through the weights.
    """
    size, high = len(by_memory), len(by_recurrent) // 3
    reset, update = kept[:size], kept[size : 2 * size]
    new, last = kept[2 * size : 3 * size], kept[3 * size :]
    to_reset, to_update, to_new = by_given[:size], by_given[size : 2 * size], by_given[2 * size :]
    for i in range(size):
        by_new = by_memory[i] * (_ONE - update[i]) * (_ONE - new[i] * new[i])
        to_new[i] = by_new
        to_reset[i] = by_new * last[i] * reset[i] * (_ONE - reset[i])
        to_update[i] = by_memory[i] * (before[i] - new[i]) * update[i] * (_ONE - update[i])
        by_memory[i] *= update[i]
    by_recurrent[:size], by_recurrent[high : high + size] = to_reset, to_update
    by_last = by_recurrent[2 * high : 2 * high + size]
    for i in range(size):
        by_last[i] = to_new[i] * reset[i]


def _forward(
    weights: Array,
    bias: Array,
    given: Array,
    start: Array,
    begins: Array,
    acting: Array,
    memories: Array,
    kept: Array,
) -> None:
    """Compute the ``memories`` after each step, shape ``(steps, agents, size)``.

    The memory before each step is multiplied by ``weights``, ``(3 * size, size)``, and ``bias`` is added.
    ``begins`` and ``acting``, ``(steps, agents)`` or empty, are those of
    :class:`Recall`.
    """
    steps, agents, size = memories.shape
    high = rounded_up(size, WIDE)
    wide = 3 * high
    columns, biases = np.zeros(size * wide, np.float32), np.zeros(wide, np.float32)
    for gate in range(3):
        for i in range(size):
            biases[gate * high + i] = bias[gate * size + i]
            for k in range(size):
                columns[k * wide + gate * high + i] = weights[gate * size + i, k]
    tile, sums = np.empty(ROWS * high, np.float32), np.empty(ROWS * wide, np.float32)
    for first in range(0, agents, ROWS):
        n = min(ROWS, agents - first)
        some = rounded_up(n, HIGH)
        tile[:] = 0
        for s in range(n):
            tile[s * high : s * high + size] = start[first + s]
        for t in range(steps):
            for s in range(n if len(begins) else 0):
                if begins[t, first + s]:
                    tile[s * high : (s + 1) * high] = 0
            begin_with(sums, biases, some)
            product(sums, wide, tile, high, 1, columns, wide, some, wide, size)
            for s in range(n):
                agent, memory = first + s, tile[s * high : s * high + size]
                if len(acting) == 0 or acting[t, agent]:
                    _moved(memory, sums[s * wide : (s + 1) * wide], given[t, agent], kept[t, agent])
                memories[t, agent] = memory


def _backward(
    weights: Array,
    start: Array,
    begins: Array,
    acting: Array,
    memories: Array,
    kept: Array,
    by_memories: Array,
    by_weights: Array,
    by_bias: Array,
    by_given: Array,
    by_start: Array,
) -> None:
    """Compute gradients from those by the memories after each step."""
    steps, agents, size = memories.shape
    high = rounded_up(size, WIDE)
    wide = 3 * high
    rows = np.zeros(wide * high, np.float32)
    for gate in range(3):
        for i in range(size):
            for k in range(size):
                rows[(gate * high + i) * high + k] = weights[gate * size + i, k]
    tile, before = np.empty(ROWS * high, np.float32), np.empty(ROWS * high, np.float32)
    sums = np.zeros(ROWS * wide, np.float32)
    total, total_bias = np.zeros(high * wide, np.float32), np.zeros(wide, np.float32)
    for first in range(0, agents, ROWS):
        n = min(ROWS, agents - first)
        some = rounded_up(n, HIGH)
        tile[:] = before[:] = sums[:] = 0
        for t in range(steps - 1, -1, -1):
            for s in range(n):
                agent = first + s
                memory, previous = tile[s * high : s * high + size], before[s * high : s * high + size]
                memory += by_memories[t, agent]
                if len(begins) and begins[t, agent]:
                    previous[:] = 0
                else:
                    previous[:] = memories[t - 1, agent] if t else start[agent]
                by_sums = sums[s * wide : (s + 1) * wide]
                if len(acting) == 0 or acting[t, agent]:
                    _moved_back(memory, previous, kept[t, agent], by_given[t, agent], by_sums)
                else:
                    by_sums[:] = 0
                    by_given[t, agent] = 0
            column_sums(sums, total_bias, some)
            product(total, wide, before, 1, high, sums, wide, high, wide, some)
            product(tile, high, sums, wide, 1, rows, high, some, high, wide)
            for s in range(n if len(begins) else 0):
                if begins[t, first + s]:
                    tile[s * high : (s + 1) * high] = 0
        for s in range(n):
            by_start[first + s] = tile[s * high : s * high + size]
    for gate in range(3):
        for i in range(size):
            by_bias[gate * size + i] = total_bias[gate * high + i]
            for k in range(size):
                by_weights[gate * size + i, k] = total[k * wide + gate * high + i]


_forward_of = compiled_loop(_forward, dense, fused=True)
_backward_of = compiled_loop(_backward, dense, fused=True)


class GRUSteps(torch.autograd.Function):
    """The memories after each step, ``(steps, agents, size)``, by compiled loops.

    They are computed from what the features add at each step, ``(steps, agents, 3 * size)``; the weights and
    biases for the memory before; and the fields of :class:`Recall`.
    """

    @staticmethod
    def forward(
        ctx: Any,
        given: Tensor,
        weights: Tensor,
        bias: Tensor,
        start: Tensor,
        begins: Tensor | None,
        acting: Tensor | None,
    ) -> Tensor:
        """Return the memories."""
        steps, agents, size = *given.shape[:2], weights.shape[1]
        memories, kept = (np.empty((steps, agents, parts * size), np.float32) for parts in (1, 4))
        none = np.empty((0, 0), np.bool_)
        of_weights, of_bias, of_given, of_start = map(_array, (weights, bias, given, start))
        flags = [none if some is None else _array(some) for some in (begins, acting)]
        _forward_of()(of_weights, of_bias, of_given, of_start, *flags, memories, kept)
        ctx.arrays = of_weights, of_start, *flags, memories, kept
        return torch.from_numpy(memories)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_memories: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients by what :meth:`forward` was given."""
        weights, start, *_, memories, _ = ctx.arrays
        steps, agents, size = memories.shape
        shapes = weights.shape, (3 * size,), (steps, agents, 3 * size), start.shape
        by_weights, by_bias, by_given, by_start = found = [np.empty(shape, np.float32) for shape in shapes]
        _backward_of()(*ctx.arrays, _array(by_memories), *found)
        return *map(torch.from_numpy, (by_given, by_weights, by_bias, by_start)), None, None


def _array(tensor: Tensor) -> Array:
    return tensor.detach().contiguous().numpy()


class Memory(nn.Module):
    """Memories of ``size`` numbers, which move on by as many features of each step.

    On a CPU, compiled loops move them; on a GPU, PyTorch does.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.cell = nn.GRUCell(size, size)

    def forward(self, features: Tensor, recall: Recall) -> Tensor:
        """Return the memories after each step, shape ``(steps, agents, size)``.

        Features have the shape ``(steps * agents, size)``.
        """
        memory, begins, acts = recall
        if features.device.type == "cpu":
            cell, agents = self.cell, len(memory)
            shape = len(features) // max(agents, 1), agents, 3 * cell.hidden_size
            given = linear(features, cell.weight_ih, cell.bias_ih).reshape(shape)
            made: Tensor = GRUSteps.apply(given, cell.weight_hh, cell.bias_hh, *recall)  # type: ignore[no-untyped-call]
            return made
        memories = []
        for t, now in enumerate(features.reshape(-1, *memory.shape)):
            if begins is not None:
                memory = memory.masked_fill(begins[t, :, None], 0)
            moved = self.cell(now, memory)
            memory = moved if acts is None else torch.where(acts[t, :, None], moved, memory)
            memories.append(memory)
        return torch.stack(memories)
