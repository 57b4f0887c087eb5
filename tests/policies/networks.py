"""Integer networks with random weights, of every kind of inputs, activations and heads."""

from __future__ import annotations

import numpy as np

from pearl_marl.policies.device_policy import Array
from pearl_marl.policies.integer_network import (
    ENTRIES,
    Dense,
    Head,
    IntegerNetwork,
    Levels,
    Patches,
    Rows,
    Scaling,
)
from pearl_marl.spec import EnvSpec
from pearl_marl.spec.elements import bounds

TANH = np.round(127 * np.tanh((np.arange(ENTRIES) - ENTRIES / 2 + 0.5) / 100)).astype(np.int16)
CHANCES = np.round(65535 * np.exp(-np.arange(ENTRIES) / 90)).astype(np.int32)
NO_TABLE = np.zeros(0, np.int16)


def random_network(
    spec: EnvSpec, seed: int, widths: tuple[int, ...] = (9, 6), drawn: bool = True, tables: bool = True
) -> IntegerNetwork:
    """Return a network for an environment; without ``widths`` a table, of observations that are numbers."""
    rng = np.random.default_rng(seed)
    seen = spec.in_elements
    size = seen.observation_size
    low, high = (end.ravel().astype(np.float64) for end in bounds(seen.observation_space))
    inputs: Scaling | Rows | Patches
    width = size
    first = widths[0] if widths else sum(spec.action_counts)
    if spec.observation_dtype == np.int64:
        rows = (high - low + 1).astype(np.int64)
        starts = np.cumsum([0, *rows[:-1]]) - low.astype(np.int64)
        table = rng.integers(-400, 400, (int(rows.sum()), first)).astype(np.int32)
        inputs, width = Rows(starts, np.eye(size, dtype=np.int64), table), 0
    elif len(seen.observation_shape) == 3:
        filters = rng.integers(-127, 128, (5, 3, 3, seen.observation_shape[2])).astype(np.int16)
        bias = rng.integers(-200, 200, 5).astype(np.int32)
        fraction = max(spec.element_fractions)
        inputs = Patches(seen.observation_shape, filters, bias, 2, 127, max(0, fraction - 3))
        width = 5 * (seen.observation_shape[0] - 2) * (seen.observation_shape[1] - 2)
    else:
        spread = np.maximum(high - low, 1)
        shift = np.clip(np.ceil(np.log2(spread)), 0, 40).astype(np.int64)
        inputs = Scaling(np.rint((low + high) / 2).astype(np.int64), np.full(size, 900), shift, 500)
    layers = []
    for outputs in widths:
        weights = rng.integers(-127, 128, (outputs, width)).astype(np.int16)
        bias = rng.integers(-400, 400, outputs).astype(np.int32)
        table_of = TANH if tables and rng.random() < 0.7 else NO_TABLE
        layers.append(Dense(weights, bias, 5, table_of, 127))
        width = outputs
    outputs = sum(spec.action_counts) or len(spec.action_fields)
    last = rng.integers(-127, 128, (outputs, width)).astype(np.int16)
    layers.append(Dense(last, rng.integers(-500, 500, outputs).astype(np.int32)))
    if spec.action_counts:
        head: Head | Levels = Head(spec.action_counts, 3, CHANCES if drawn else CHANCES[:0])
    else:
        ends = bounds(spec.action_space)
        words = [
            np.array(
                [round(float(x) * 2.0**f.fraction) for x, f in zip(end, spec.action_fields, strict=True)]
            )
            for end in ends
        ]
        head = Levels(np.full(outputs, 12345), np.full(outputs, -777), 2, *words)
    indicator: Array = np.zeros((0, first), np.int32)
    if spec.agents > 1:
        indicator = rng.integers(-300, 300, (spec.agents, first)).astype(np.int32)
    return IntegerNetwork(spec, inputs, indicator, tuple(layers), head)
