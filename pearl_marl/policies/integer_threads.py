"""Integer networks on a GPU: a thread takes an agent through all layers.

numba-cuda compiles these functions, and its simulator runs them as they are. They compute what
:meth:`~pearl_marl.policies.integer_network.IntegerNetwork.choose` does.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.golden.rng import CHAIN_A, CHAIN_B, draw, key
from pearl_marl.policies.device_policy import FIRST_DRAW
from pearl_marl.policies.integer_network import ENTRIES, HALF, IntegerNetwork, Patches, loop_parts

SIDE = 3
"""Rows and columns of a patch."""

HIGH = 4
"""Outputs whose sums a thread keeps in registers."""


class ThreadNetwork(NamedTuple):
    """A network as a thread takes it. The weights of all layers lie one after the other, a row an output.

    Each layer has outputs up to a multiple of :data:`HIGH`. Where a network has no part of a kind, its array
    is empty.
    """

    offset: Array  # int64, one an element; of rows, one a choice
    multiplier: Array  # int64
    input_shift: Array  # int64
    input_limit: int
    factors: Array  # int64, (choices, elements)
    table: Array  # int32, (rows, width)
    indicator: Array  # int32, (agents, width)
    filters: Array  # int32, (9 * planes, filters up to a multiple of HIGH)
    filter_bias: Array  # int32
    shape: Array  # int64: rows, columns, planes
    weights: Array  # int16
    bias: Array  # int32
    sizes: Array  # int64, (layers, 2): inputs and outputs
    shifts: Array  # int64
    limits: Array  # int64
    tables: Array  # int32, (layers, 1024)
    has_table: Array  # bool
    counts: Array  # int64
    chance_shift: int
    chances: Array  # int64
    levels: Array  # int64, (4, fields): multiplier, offset, low, high
    level_shift: int


def thread_network(network: IntegerNetwork) -> ThreadNetwork:
    """Return a network as threads take it."""
    inputs, filters = network.inputs, np.zeros((0, 0), np.int32)
    if isinstance(inputs, Patches):
        filters = inputs.weights.reshape(len(inputs.bias), -1).T
        filters = np.pad(filters, ((0, 0), (0, -len(inputs.bias) % HIGH)))
    weights, bias, tables = [], [], np.zeros((len(network.layers), ENTRIES), np.int32)
    sizes = np.zeros((len(network.layers), 2), np.int64)
    for k, layer in enumerate(network.layers):
        outputs, width = layer.weights.shape
        sizes[k] = width, -(-outputs // HIGH) * HIGH
        empty = int(sizes[k, 1]) - outputs
        weights.append(np.pad(layer.weights, ((0, empty), (0, 0))).ravel())
        bias.append(np.pad(layer.bias, (0, empty)))
        if len(layer.activation):
            tables[k] = layer.activation
    return ThreadNetwork(
        filters=np.ascontiguousarray(filters, np.int32),
        weights=np.concatenate(weights).astype(np.int16),
        bias=np.concatenate(bias).astype(np.int32),
        sizes=sizes,
        shifts=np.array([layer.shift for layer in network.layers], np.int64),
        limits=np.array([layer.limit for layer in network.layers], np.int64),
        tables=tables,
        has_table=np.array([len(layer.activation) > 0 for layer in network.layers]),
        **loop_parts(network),
    )


class ThreadArrays(NamedTuple):
    """Numbers of threads on their way through the layers. A thread has a column, beside its neighbour's."""

    inputs: Array  # int16, (2, inputs, threads): those of a layer, and those of the next one
    sums: Array  # int32, (outputs, threads): the last layer's


def room_sizes(net: ThreadNetwork) -> tuple[int, int]:
    """Return how many inputs and outputs a layer has at most, and how many sums the last one."""
    return max(1, int(net.sizes.max())), int(net.sizes[-1, 1])


def layers(net: ThreadNetwork, room: ThreadArrays, elements: Array, at: int, agent: int, me: int) -> None:
    """Compute the last sums of an agent, whose elements lie from ``at`` on, in column ``me``."""
    inputs, sums = room.inputs, room.sums
    if len(net.multiplier):
        for k in range(len(net.offset)):
            value = (np.int64(elements[at + k]) - net.offset[k]) * net.multiplier[k] >> net.input_shift[k]
            inputs[0, k, me] = min(max(value, -net.input_limit), net.input_limit)
    elif len(net.filter_bias):
        rows, columns, planes = net.shape[0], net.shape[1], net.shape[2]
        filters = len(net.filter_bias)
        for row in range(rows - SIDE + 1):
            for column in range(columns - SIDE + 1):
                k = (row * (columns - SIDE + 1) + column) * filters
                for first in range(0, filters, HIGH):
                    s0 = s1 = s2 = s3 = np.int32(0)
                    for i in range(SIDE):
                        for j in range(SIDE):
                            cell = at + ((row + i) * columns + column + j) * planes
                            patch = (SIDE * i + j) * planes
                            for plane in range(planes):
                                x = np.int32(np.int64(elements[cell + plane]) >> net.input_shift[1])
                                if x:
                                    s0 = np.int32(s0 + net.filters[patch + plane, first] * x)
                                    s1 = np.int32(s1 + net.filters[patch + plane, first + 1] * x)
                                    s2 = np.int32(s2 + net.filters[patch + plane, first + 2] * x)
                                    s3 = np.int32(s3 + net.filters[patch + plane, first + 3] * x)
                    for f in range(first, min(first + HIGH, filters)):
                        total = s0 if f == first else s1 if f == first + 1 else s2 if f == first + 2 else s3
                        shifted = np.int64(total + net.filter_bias[f]) >> net.input_shift[0]
                        inputs[0, k + f, me] = min(max(shifted, 0), net.input_limit)
    count, weight, bias = len(net.sizes), 0, 0
    for layer in range(count):
        width, outputs = net.sizes[layer, 0], net.sizes[layer, 1]
        here, there = layer & 1, ~layer & 1
        for first in range(0, outputs, HIGH):
            s0, s1 = net.bias[bias + first], net.bias[bias + first + 1]
            s2, s3 = net.bias[bias + first + 2], net.bias[bias + first + 3]
            row = weight + first * width
            for k in range(width):  # cut to 32 bits, in which no sum overflows, lest it be added in 64
                x = np.int32(inputs[here, k, me])
                s0 = np.int32(s0 + np.int32(net.weights[row + k]) * x)
                s1 = np.int32(s1 + np.int32(net.weights[row + width + k]) * x)
                s2 = np.int32(s2 + np.int32(net.weights[row + 2 * width + k]) * x)
                s3 = np.int32(s3 + np.int32(net.weights[row + 3 * width + k]) * x)
            for k in range(HIGH):
                total = np.int32(s0 if k == 0 else s1 if k == 1 else s2 if k == 2 else s3)
                j = first + k
                if layer == 0:
                    if j < net.table.shape[1]:
                        for choice in range(len(net.offset)):
                            chosen = net.offset[choice]
                            for e in range(net.factors.shape[1]):
                                chosen += net.factors[choice, e] * np.int64(elements[at + e])
                            total += net.table[chosen, j]
                    if len(net.indicator) and j < net.indicator.shape[1]:
                        total += net.indicator[agent, j]
                if layer + 1 == count:
                    sums[j, me] = total
                elif net.has_table[layer]:
                    entry = min(max(np.int64(total) >> net.shifts[layer], -HALF), HALF - 1) + HALF
                    inputs[there, j, me] = net.tables[layer, entry]
                else:
                    inputs[there, j, me] = min(
                        max(np.int64(total) >> net.shifts[layer], 0), net.limits[layer]
                    )
        weight += width * outputs
        bias += outputs


def act(
    net: ThreadNetwork,
    room: ThreadArrays,
    elements: Array,
    at: int,
    agent: int,
    masks: Array,
    masks_at: int,
    where: tuple[Any, Any, Any, Any],
    actions: Array,
    actions_at: int,
    me: int,
) -> None:
    """Write the words of an agent's action to ``actions`` from ``actions_at`` on.

    Its elements lie from ``at`` on, and its masks from ``masks_at`` on, which is -1 where there are none.
    ``where`` are slot, tick and the words of the seed.
    """
    layers(net, room, elements, at, agent, me)
    sums = room.sums
    if len(net.levels):
        for k in range(net.levels.shape[1]):
            word = (np.int64(sums[k, me]) * net.levels[0, k] + net.levels[1, k]) >> net.level_shift
            actions[actions_at + k] = min(max(word, net.levels[2, k]), net.levels[3, k])
        return
    slot, tick, seed_0, seed_1 = where
    start = 0
    for field in range(len(net.counts)):
        count = net.counts[field]
        best, greatest, found = 0, np.int64(0), False
        distance: Any
        for j in range(count):
            if (masks_at < 0 or masks[masks_at + j] != 0) and (not found or sums[start + j, me] > greatest):
                best, greatest, found = j, np.int64(sums[start + j, me]), True
        if len(net.chances) and found:
            total = np.int64(0)
            for j in range(count):
                if masks_at < 0 or masks[masks_at + j] != 0:
                    distance = (greatest - np.int64(sums[start + j, me])) >> net.chance_shift
                    total += net.chances[min(distance, ENTRIES - 1)]
            index = np.uint32(FIRST_DRAW + agent * len(net.counts) + field)
            key_a = key(np.uint32(CHAIN_A), seed_0, seed_1, tick, index)
            key_b = key(np.uint32(CHAIN_B), seed_0, seed_1, tick, index)
            number = np.int64((np.uint64(draw(slot, key_a, key_b)) * np.uint64(total)) >> np.uint64(32))
            for j in range(count):
                if number >= 0 and (masks_at < 0 or masks[masks_at + j] != 0):
                    distance = (greatest - np.int64(sums[start + j, me])) >> net.chance_shift
                    number -= net.chances[min(distance, ENTRIES - 1)]
                    if number < 0:
                        best = j
        actions[actions_at + field] = best
        start += count
