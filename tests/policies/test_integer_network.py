"""Networks in integers: compiled they do as the same arithmetic in NumPy; impossible ones are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.compiler.addresses import in_memory
from pearl_marl.errors import ArgumentError
from pearl_marl.policies import integer_network
from pearl_marl.policies.device_policy import Array
from pearl_marl.policies.integer_loops import TILE, compiled_act, prepared
from pearl_marl.policies.integer_network import Dense, Head, IntegerNetwork, Patches, Scaling
from pearl_marl.spec import EnvSpec
from pearl_marl.spec.elements import bounds

from .networks import TANH, random_network

N = 2 * TILE + 11


def some_elements(spec: EnvSpec, rng: np.random.Generator) -> Array:
    """Return elements all over their ranges, the ends among them."""
    seen = spec.in_elements
    ends = bounds(seen.observation_space)
    if len(spec.observation_shape) == 3:  # of floats, elements do not say how far they reach
        ends = tuple(
            end.astype(np.float64) * 2.0 ** spec.element_fractions[0]
            for end in bounds(spec.observation_space)
        )
    low, high = (end.ravel().astype(np.int64) for end in ends)
    rows = rng.integers(low, high, (N, len(low)), endpoint=True)
    rows[0], rows[1] = low, high
    dtype = np.dtype(np.uint8) if seen.observation_dtype == np.bool_ else seen.observation_dtype
    return rows.astype(dtype)


CASES = [
    *(("CartPole", widths, drawn) for widths in ((9, 6), (1,), (), (33, 5, 2)) for drawn in (False, True)),
    *(
        (name, (9, 6), True)
        for name in (
            *("Taxi", "Blackjack", "ConnectFour", "LevelBasedForaging", "Pendulum", "Seaquest"),
            *("Overcooked", "Snake"),
        )
    ),
]


@pytest.mark.parametrize(("name", "widths", "drawn"), CASES)
def test_compiled_as_in_numpy(name: str, widths: tuple[int, ...], drawn: bool) -> None:
    check_compiled(random_network(pearl_marl.get_spec(name), 5, widths, drawn))


def wide_weights(network: IntegerNetwork) -> IntegerNetwork:
    """Return a network one of whose weights has 9 bits."""
    *others, last = network.layers
    weights = last.weights.copy()
    weights[0, 0] = 128
    return replace(network, layers=(*others, last._replace(weights=weights)))


def activated(network: IntegerNetwork, *ends: Array | int) -> IntegerNetwork:
    """Return a network with a table, or a limit, after each layer but the last."""
    *hidden, last = network.layers
    layers = [
        layer._replace(activation=np.zeros(0, np.int16), limit=end)
        if isinstance(end, int)
        else layer._replace(activation=end)
        for layer, end in zip(hidden, ends, strict=True)
    ]
    return replace(network, layers=(*layers, last))


ENDS = TANH, *(np.roll(TANH, k) for k in (1, 3)), np.arange(-512, 512).astype(np.int16) // 4


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize(
    "ends",
    [(ENDS[0], ENDS[1]), (ENDS[2], 255), (ENDS[3], 256), (200, ENDS[0]), (127, 255), (ENDS[0] * 2, ENDS[1])],
    ids=["tables", "255", "256", "first cut", "cut", "9 bits"],
)
@pytest.mark.parametrize("name", ["CartPole", "Seaquest"])
def test_bytes_and_words_between_layers(name: str, ends: tuple[Array | int, ...], wide: bool) -> None:
    """Layers take four bytes at a time where all fits, and pairs of words where it does not."""
    network = activated(random_network(pearl_marl.get_spec(name), 5, (9, 6), drawn=False), *ends)
    check_compiled(wide_weights(network) if wide else network)


def check_compiled(network: IntegerNetwork) -> None:
    """Check that a network does compiled as in NumPy."""
    spec, rng = network.spec, np.random.default_rng(3)
    elements = some_elements(spec, rng)
    masks = rng.integers(0, 2, (N, len(spec.mask_fields))).astype(np.int8) if spec.mask_fields else None
    draws = rng.integers(0, 1 << 32, (N, network.draws), dtype=np.uint32)
    choice = network.choose(elements, np.arange(N) % spec.agents, masks, draws)
    words = np.zeros_like(choice.words)
    logits = np.zeros((0, 0) if choice.logits is None else choice.logits.shape, np.int32)
    no_masks = np.zeros((0, 0), np.int8)
    net, as_bytes = prepared(network, elements.dtype), elements.reshape(-1).view(np.uint8)
    at = in_memory(net)
    compiled_act()(at.ctypes.data, as_bytes, no_masks if masks is None else masks, draws, words, logits)
    assert np.array_equal(words, choice.words)
    assert choice.logits is None or np.array_equal(logits, choice.logits)
    assert len(np.unique(words)) > 1


@pytest.mark.parametrize("least", [100, 32000])
def test_patches_in_numpy_are_exact(least: int) -> None:
    """Sums of weights of 16 bits and elements up to 255 are more than a float of 32 bits holds."""
    rng = np.random.default_rng(2)
    weights = rng.integers(least, least + 28, (5, 3, 3, 3)).astype(np.int16)
    inputs = Patches((7, 7, 3), weights, rng.integers(-400, 400, 5).astype(np.int32), 0, 1)
    planes = rng.integers(200, 256, (50, 7, 7, 3))
    expected = np.zeros((50, 5, 5, 5), np.int64) + inputs.bias
    for i, j in np.ndindex(3, 3):
        expected += planes[:, i : i + 5, j : j + 5] @ weights[:, i, j].T.astype(np.int64)
    assert (expected.max() > 1 << 24) == (least > 100)
    assert np.array_equal(integer_network._patches(planes, inputs), expected.reshape(50, -1))


def test_chances_are_as_the_weights_say() -> None:
    """The probability of an action is its weight's share, to the 32 bits of a draw."""
    spec = pearl_marl.get_spec("CartPole")
    layer = Dense(np.zeros((2, 4), np.int16), np.array([0, 64], np.int32))
    weights = np.full(1024, 1, np.int32)
    weights[:2] = 60000, 20000
    inputs = Scaling(*(np.zeros(4, np.int64),) * 3, 1)
    network = IntegerNetwork(spec, inputs, np.zeros((0, 2), np.int32), (layer,), Head((2,), 6, weights))
    draws = np.arange(0, 1 << 32, 1 << 20, dtype=np.uint32)[:, None]
    words = network.choose(np.zeros((len(draws), 4), np.int32), np.zeros(len(draws), int), None, draws).words
    assert abs(words.mean() - 0.75) < 1e-3


def cart_pole() -> IntegerNetwork:
    return random_network(pearl_marl.get_spec("CartPole"), 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda n: {"layers": ()}, "has no layers"),
        (lambda n: {"layers": n.layers[:-1]}, "6 outputs for actions in Discrete"),
        (lambda n: {"layers": (n.layers[0], *n.layers)}, "layer 1 has weights of shape \\(9, 4\\)"),
        (lambda n: {"inputs": n.inputs._replace(offset=np.zeros(3, int))}, "offset has the shape \\(3,\\)"),
        (lambda n: {"inputs": n.inputs._replace(limit=1 << 15)}, "limit of inputs is 32768"),
        (lambda n: {"head": Head((3,))}, "2 outputs for actions in Discrete"),
        (
            lambda n: {
                "layers": (n.layers[0]._replace(bias=np.full(9, (1 << 31) - 5, np.int32)), *n.layers[1:])
            },
            "sums of layer 0 may reach 2,147",
        ),
    ],
)
def test_what_is_no_network_is_refused(change: Any, message: str) -> None:
    network = cart_pole()
    with pytest.raises(ArgumentError, match=message):
        replace(network, **change(network))
