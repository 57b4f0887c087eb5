"""Random policies for tests of the policy engine."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np

from pearl_marl.policies.integer_network import ENTRIES, Dense, Head, IntegerNetwork, Patches, Rows, Scaling
from pearl_marl.spec import EnvSpec

Random = np.random.Generator


def random_layers(
    random: Random, sizes: list[int], weight_bits: int = 8, value_bits: int = 12
) -> tuple[Dense, ...]:
    """Return layers from so many numbers to so many, some with a table, which is the same for all of them."""
    most, limit = (1 << weight_bits - 1) - 1, (1 << value_bits - 1) - 1
    table = random.integers(-limit - 1, limit + 1, ENTRIES).astype(np.int16)
    layers = []
    for k, (width, outputs) in enumerate(pairwise(sizes)):
        weights = random.integers(-most - 1, most + 1, (outputs, width)).astype(np.int16)
        bias = random.integers(-(1 << 20), 1 << 20, outputs).astype(np.int32)
        # What is usual for a sum should lie within the table, and beyond it at times.
        shift = max(0, weight_bits + value_bits + width.bit_length() // 2 - 12)
        if k == len(sizes) - 2:
            layers.append(Dense(weights, bias))
        elif random.integers(2):
            layers.append(Dense(weights, bias, shift, table))
        else:
            layers.append(Dense(weights, bias, max(0, shift + 10 - value_bits), limit=limit))
    return tuple(layers)


def random_head(random: Random, spec: EnvSpec, drawn: bool) -> Head:
    """Return a head that takes the greatest logit, or draws one."""
    if not drawn:
        return Head(spec.action_counts)
    chances = np.rint(65535 * np.exp(-np.arange(ENTRIES) / random.integers(20, 400)))
    return Head(spec.action_counts, int(random.integers(0, 8)), chances.astype(np.int32))


def random_network(random: Random, spec: EnvSpec, hidden: list[int], drawn: bool) -> IntegerNetwork:
    """Return a network for an environment; its inputs are within their limit for some observations only."""
    count, limit = len(spec.observation), 1280
    reach = np.array([max(map(abs, field.range)) for field in spec.observation])
    multiplier = np.clip(8 * limit * 2.0**20 / np.maximum(reach, 1), 1, (1 << 16) - 1).astype(np.int64)
    inputs = Scaling(random.integers(-5, 5, count), multiplier, np.full(count, 20), limit)
    layers = random_layers(random, [count, *hidden, sum(spec.action_counts)])
    head = random_head(random, spec, drawn)
    return IntegerNetwork(spec, inputs, np.zeros((0, len(layers[0].bias)), np.int32), layers, head)


def random_planes(
    random: Random, spec: EnvSpec, filters: int, hidden: list[int], drawn: bool
) -> IntegerNetwork:
    """Return a network for an environment with planes of 0 and 1; some of its inputs are cut at both ends."""
    rows, columns, planes = spec.observation_shape
    weights = random.integers(-128, 128, (filters, 3, 3, planes)).astype(np.int16)
    bias = random.integers(-200, 200, filters).astype(np.int32)
    inputs = Patches(spec.observation_shape, weights, bias, 1, 60)
    sizes = [filters * (rows - 2) * (columns - 2), *hidden, sum(spec.action_counts)]
    layers = random_layers(random, sizes)
    head = random_head(random, spec, drawn)
    return IntegerNetwork(spec, inputs, np.zeros((0, len(layers[0].bias)), np.int32), layers, head)


def random_table(random: Random, spec: EnvSpec, bits: int, drawn: bool) -> IntegerNetwork:
    """Return a table of logits for an environment whose observation is a few numbers, none below 0."""
    actions = sum(spec.action_counts)
    sizes = [int(field.range[1]) + 1 for field in spec.observation]
    table = random.integers(-(1 << bits - 1), 1 << bits - 1, (math.prod(sizes), actions)).astype(np.int32)
    factors = np.array([[math.prod(sizes[k + 1 :]) for k in range(len(sizes))]])
    rows_of = Rows(np.zeros(1, np.int64), factors, table)
    layer = Dense(np.zeros((actions, 0), np.int16), np.zeros(actions, np.int32))
    none = np.zeros((0, actions), np.int32)
    return IntegerNetwork(spec, rows_of, none, (layer,), random_head(random, spec, drawn))


def as_greatest(policy: IntegerNetwork) -> IntegerNetwork:
    """Return the same policy, which takes the greatest logit."""
    return dataclasses.replace(policy, head=Head(policy.head.counts))
