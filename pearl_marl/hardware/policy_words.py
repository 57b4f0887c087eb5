"""From a policy in integers to the words of a policy engine; what does not fit is refused."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.errors import ArgumentError
from pearl_marl.memory_map import Engine, Section
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.policies.golden_policy import GoldenPolicy
from pearl_marl.policies.integer_network import (
    AgentNetworks,
    Dense,
    IntegerNetwork,
    Levels,
    Patches,
    Rows,
    Scaling,
)
from pearl_marl.spec import EnvSpec
from pearl_marl.spec.elements import bounds

Words = npt.NDArray[np.uint32]

MULTIPLIER_BITS = 16
RETURN_BITS = 48
QUANTUM_BITS = 40
"""Widths of the engine's multipliers of inputs, of an episode's return, and of what a reward counts as."""


def check_engine(spec: EnvSpec, engine: Engine) -> None:
    """Refuse an environment whose observations or actions an engine does not take."""
    if spec.unpack is not None and engine.kind != "planes":
        raise ArgumentError(
            f"a policy engine for a {engine.kind} takes observations as their words are, and the host "
            f"unpacks those of {spec.id}; take Engine('planes'), or roll out on another device"
        )
    if len(spec.action_counts) != 1:
        raise ArgumentError(
            f"a policy engine chooses one of so many actions, and {spec.id} has {spec.action_space}; "
            "roll out on another device"
        )


def policy_words(policy: DevicePolicy, engine: Engine) -> dict[Section, Words]:
    """Return what each section of the policy region begins with.

    Raises
    ------
    ArgumentError
        The policy is none that an engine takes, or larger than this one.
    """
    if engine.kind == "golden":
        _check_function(policy, engine)
        return {}  # which is a part of the design
    if isinstance(policy, AgentNetworks):
        raise ArgumentError(
            "no policy engine takes a network for each agent of a world: train with sharing all or "
            "indicator, or take a device without an engine"
        )
    spec = policy.spec
    check_engine(spec, engine)
    if not isinstance(policy, IntegerNetwork):
        raise _refusal(f"takes {engine.kind}s of integers, and this policy is {_named(policy)}")
    head, inputs = policy.head, policy.inputs
    assert not isinstance(head, Levels)  # there are none for a single action of so many
    if len(head.weights) and not engine.drawn:
        raise _refusal("takes the best action, and this policy draws its actions")
    words = _table(policy, inputs, engine) if isinstance(inputs, Rows) else _network(policy, inputs, engine)
    words[Section.SETTINGS][0] = head.shift | (32 if len(head.weights) else 0)
    if len(head.weights):
        words[Section.CHANCES] = _unsigned(head.weights)
    return words


def _check_function(policy: DevicePolicy, engine: Engine) -> None:
    """Refuse another policy than the golden function that an engine is built of."""
    if not isinstance(policy, GoldenPolicy):
        raise _refusal(f"computes a golden function, and this policy is {_named(policy)}")
    if policy.number != engine.number:
        raise _refusal(f"computes the golden function {engine.number:#x}, and this is {policy.number:#x}")


def _table(policy: IntegerNetwork, inputs: Rows, engine: Engine) -> dict[Section, Words]:
    if engine.kind != "table":
        raise _refusal(f"takes {_TAKES[engine.kind]}, and this policy is a table")
    if len(inputs.first) != 1 or len(policy.layers) != 1:
        raise _refusal("takes one table of logits, and this policy has several, or layers behind it")
    if len(policy.indicator):
        raise _refusal("does not tell the agents of a world apart, and this policy does")
    rows = len(inputs.table)
    if rows > engine.table_rows:
        raise _refusal(f"has room for {engine.table_rows:,} rows, and this table has {rows:,}")
    logits = inputs.table.astype(np.int64) + policy.layers[0].bias
    _fit(logits, engine.logit_bits, "logits")
    actions = logits.shape[1]
    padded = np.zeros((rows, 1 << (actions - 1).bit_length()), np.int64)
    padded[:, :actions] = logits
    return {
        Section.SETTINGS: _unsigned([0, 0, inputs.first[0], 0]),
        Section.SCALINGS: _unsigned(inputs.factors[0]),
        Section.WEIGHTS: _unsigned(padded.ravel()),
    }


_TAKES = {"table": "tables", "network": "networks", "planes": "networks on planes"}


def _network(policy: IntegerNetwork, inputs: Scaling | Patches, engine: Engine) -> dict[Section, Words]:
    layers = policy.layers
    kind, place = ("planes", " on planes") if isinstance(inputs, Patches) else ("network", "")
    if engine.kind != kind:
        raise _refusal(f"takes {_TAKES[engine.kind]}, and this policy is a network{place}")
    if len(policy.indicator):
        raise _refusal("does not tell the agents of a world apart, and this policy does")
    if len(layers) > engine.layers:
        raise _refusal(f"has {engine.layers} layers, and this policy {len(layers)}")
    for layer in layers[:-1]:
        if len(layer.bias) > engine.hidden:
            raise _refusal(f"has layers of {engine.hidden} units, and this policy one of {len(layer.bias)}")
    _fit(np.array([inputs.limit]), engine.value_bits, "inputs")
    if isinstance(inputs, Patches):
        filters, shift = filter_words(policy.spec, inputs, engine), inputs.shift
        layers = (_padded(layers[0], inputs, engine), *layers[1:])
    else:
        filters, shift = _checked_scaling(inputs, engine), 0
    tables = {layer.activation.tobytes(): layer.activation for layer in layers[:-1] if len(layer.activation)}
    if len(tables) > 1:
        raise _refusal("has one table of activations, and the layers of this policy have several")
    settings = [0, len(layers) - 1, inputs.limit, shift]
    for layer in layers:
        _fit(layer.weights, engine.weight_bits, "weights")
        outputs, width = layer.weights.shape
        shift = limit = 0
        if layer is not layers[-1]:
            shift, limit = layer.shift, layer.limit
            _fit(layer.activation if len(layer.activation) else np.array([limit]), engine.value_bits, "units")
        settings.append(-(-width // engine.products) | outputs << 16)
        settings.append(limit | shift << 26 | bool(len(layer.activation)) << 31)
    words = {
        Section.SETTINGS: _unsigned(settings),
        Section.SCALINGS: filters,
        Section.BIASES: _unsigned(np.concatenate([layer.bias for layer in layers])),
        Section.WEIGHTS: np.concatenate([_weights(layer, engine) for layer in layers]),
    }
    for table in tables.values():
        words[Section.ACTIVATION] = _unsigned(table)
    return words


def _checked_scaling(inputs: Scaling, engine: Engine) -> Words:
    if np.max(inputs.multiplier) >= 1 << MULTIPLIER_BITS:
        raise _refusal(
            f"has multipliers of {MULTIPLIER_BITS} bits, and this policy has {np.max(inputs.multiplier)}"
        )
    _fit(inputs.offset, 32, "offsets")
    return scaling_words(inputs, engine.products)


def filter_words(spec: EnvSpec, inputs: Patches, engine: Engine) -> Words:
    """Return the words of filters: of each its weights, a word each, and its bias.

    A filter begins at a multiple of a power of two, and so do each ``products`` filters. Those that a policy
    does not have are 0.
    """
    count, greatest = len(inputs.bias), int(bounds(spec.observation_space)[1].max())
    if spec.observation_dtype.kind == "f":
        raise _refusal(f"takes planes of 0 and 1, and observations of {spec.id} are {spec.observation_dtype}")
    if greatest > 1:
        raise _refusal(f"takes planes of 0 and 1, and observations of {spec.id} reach {greatest}")
    if count > engine.filters:
        raise _refusal(f"has {engine.filters} filters, and this policy {count}")
    _fit(inputs.weights, engine.weight_bits, "weights")
    numbers = np.concatenate([inputs.weights.reshape(count, -1), inputs.bias[:, None]], 1)
    return _by_products(numbers, engine.products, engine.filters)


def _padded(layer: Dense, inputs: Patches, engine: Engine) -> Dense:
    """Return the first layer behind filters that fill whole words of products."""
    outputs, count = len(layer.bias), len(inputs.bias)
    filters = -(-engine.filters // engine.products) * engine.products
    weights = np.zeros((outputs, layer.weights.shape[1] // count, filters), np.int16)
    weights[:, :, :count] = layer.weights.reshape(outputs, -1, count)
    return layer._replace(weights=weights.reshape(outputs, -1))


def scaling_words(inputs: Scaling, products: int) -> Words:
    """Return two words of each element; each ``products`` elements begin at a multiple of a power of two."""
    numbers = np.stack([inputs.offset, inputs.multiplier | inputs.shift << MULTIPLIER_BITS], 1)
    return _by_products(numbers, products, len(numbers))


def _by_products(numbers: npt.NDArray[np.integer], products: int, count: int) -> Words:
    """Return the words of rows of numbers, padded as above, with room for ``count`` rows."""
    width = numbers.shape[1]
    room = -(-count // products), 1 << (products - 1).bit_length(), 1 << (width - 1).bit_length()
    words = np.zeros(room, np.int64)
    chunk, column = np.divmod(np.arange(len(numbers)), products)
    words[chunk, column, :width] = numbers
    return _unsigned(words.ravel())


def _weights(layer: Dense, engine: Engine) -> Words:
    """Return the words of a layer's weights: each of ``products``, in a power of two of 32 bits."""
    outputs, width = layer.weights.shape
    chunks = -(-width // engine.products)
    padded = np.zeros((outputs, chunks * engine.products), np.int64)
    padded[:, :width] = layer.weights
    bits = (padded.reshape(-1, engine.products, 1) >> np.arange(engine.weight_bits)) & 1
    columns = -(-engine.products * engine.weight_bits // 32)
    filled = np.zeros((outputs * chunks, 32 << (columns - 1).bit_length()), np.uint8)
    filled[:, : engine.products * engine.weight_bits] = bits.reshape(outputs * chunks, -1)
    return np.packbits(filled.ravel(), bitorder="little").view("<u4")


class Quanta(NamedTuple):
    """Rewards as whole numbers."""

    numbers: Words
    """Of each category, in two halves; empty where rewards are no categories."""
    quantum: float
    """What one of them is worth."""


def quanta(spec: EnvSpec, rewards: npt.NDArray[np.float32], steps: int) -> Quanta:
    """Return rewards as whole numbers of which an episode of so many steps can be added up exactly.

    ``rewards`` are those of the categories.
    """
    if not spec.rewards:
        most, quantum = 1 << spec.reward.bits, Fraction(1, 1 << spec.reward.fraction)
        numbers = []
    else:
        exact = [Fraction(float(reward)) for reward in rewards]
        quantum = Fraction(1, math.lcm(*(reward.denominator for reward in exact)))
        whole = [int(reward / quantum) for reward in exact]
        quantum *= math.gcd(*whole) or 1
        numbers = [int(reward / quantum) for reward in exact]
        most = max(map(abs, numbers))
    if (spec.rewards and most >= 1 << QUANTUM_BITS - 1) or most * steps >= 1 << RETURN_BITS - 1:
        raise ArgumentError(
            f"rewards as whole numbers reach {most:,}, too much to add up {steps:,} of them in the policy "
            "engine; take fewer steps, or rewards that are rounder"
        )
    halves = [half for number in numbers for half in (number, number >> 32)]
    return Quanta(_unsigned(halves), float(quantum))


def _fit(numbers: npt.NDArray[np.integer], bits: int, what: str) -> None:
    low, high = -(1 << bits - 1), (1 << bits - 1) - 1
    if numbers.size and (numbers.min() < low or numbers.max() > high):
        raise _refusal(f"has {what} of {bits} bits, and this policy has {numbers.min()} to {numbers.max()}")


def _unsigned(numbers: npt.ArrayLike) -> Words:
    return (np.asarray(numbers, np.int64) & 0xFFFFFFFF).astype(np.uint32)


def _named(policy: DevicePolicy) -> str:
    return "a golden function" if isinstance(policy, GoldenPolicy) else f"a {type(policy).__name__}"


def _refusal(what: str) -> ArgumentError:
    return ArgumentError(f"the policy engine {what}; take another policy, or a build with another engine")
