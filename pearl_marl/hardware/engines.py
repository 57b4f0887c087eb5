"""The policy engine for a policy: as large as it needs, and as fast as it may be."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pearl_marl.errors import ArgumentError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.policy_words import policy_words
from pearl_marl.memory_map import Engine, MemoryMap, memory_map
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.policies.golden_policy import GoldenPolicy
from pearl_marl.policies.integer_network import IntegerNetwork, Patches, Rows

PRODUCTS = 8
"""Of each agent in a cycle."""

ROUNDS = 4
"""Batches that a layer takes one after the other, so that the pauses between layers matter little."""


WEIGHT_BITS, VALUE_BITS, LOGIT_BITS = 8, 12, 8
"""The least widths that an engine gets: so another policy of the same shape fits it, too."""


def with_engine(build: Build, policy: DevicePolicy | None) -> Build:
    """Return a build with an engine for a policy; the build itself, if there is none.

    Raises
    ------
    ArgumentError
        No engine takes the policy.
    """
    if policy is None:
        return build
    spec, layout = build
    if policy.spec.id != spec.id or policy.spec.options != spec.options:
        raise ArgumentError(f"the policy is for {policy.spec.id}, and the build for {spec.id}")
    engine = _engine(policy, layout)
    return Build(spec, memory_map(spec, layout.n_envs, layout.pe_num, layout.data_wl, engine))


def _engine(policy: DevicePolicy, layout: MemoryMap) -> Engine:
    engine = Engine()
    if isinstance(policy, GoldenPolicy):
        engine = Engine("golden", function=policy)
    if isinstance(policy, IntegerNetwork):
        drawn = policy.draws > 0
        if isinstance(policy.inputs, Rows):
            rows = len(policy.inputs.table)
            logits = policy.inputs.table.astype(np.int64) + policy.layers[0].bias
            engine = Engine(
                "table",
                drawn,
                table_rows=1 << max(0, (rows - 1).bit_length()),
                logit_bits=max(LOGIT_BITS, -(-_bits(logits) // 4) * 4),
            )
        else:
            engine = _network(policy, drawn, layout)
    policy_words(policy, engine)  # refuses what no engine takes
    return engine


def _network(policy: IntegerNetwork, drawn: bool, layout: MemoryMap) -> Engine:
    inputs, layers = policy.inputs, policy.layers
    assert not isinstance(inputs, Rows)
    weights = [layer.weights for layer in layers]
    limits = np.array([inputs.limit, *(layer.limit for layer in layers[:-1])])
    values = [limits, *(layer.activation for layer in layers[:-1])]
    # Filters make the first layer so long that its pauses do not count.
    many = len(layers) > 1 and not isinstance(inputs, Patches)
    rounds = min(ROUNDS if many else 1, layout.groups)
    if isinstance(inputs, Patches):
        weights.append(inputs.weights)
    return Engine(
        "planes" if isinstance(inputs, Patches) else "network",
        drawn,
        products=PRODUCTS,
        rounds=rounds,
        hidden=max([1, *(len(layer.bias) for layer in layers[:-1])]),
        layers=len(layers),
        weight_bits=max([WEIGHT_BITS, *map(_bits, weights)]),
        value_bits=max([VALUE_BITS, *map(_bits, values)]),
        filters=len(inputs.bias) if isinstance(inputs, Patches) else 1,
    )


def _bits(numbers: npt.NDArray[np.integer]) -> int:
    """Return the width of integers, sign included."""
    low, high = (int(numbers.min()), int(numbers.max())) if numbers.size else (0, 0)
    return max(high.bit_length(), (~low if low < 0 else low).bit_length()) + 1
