"""Reals traced to a graph give the same words as on Python's integers, and refuse what no hardware can do."""

from __future__ import annotations

import math
import operator
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from pearl_marl.errors import ArgumentError
from pearl_marl.reals import FUNCTIONS, Choice, Real, admitted, select, stored
from pearl_marl.reals.numbers import constant
from pearl_marl.tracing.graph import Graph
from pearl_marl.tracing.nodes import in_order, values
from pearl_marl.tracing.words import Word

FRACTION = 27
MOST_BITS = 64


class Traced:
    """A function of real fields ``a`` and ``b``, an integer ``n`` of 0 to 3 and a flag ``f``, traced once."""

    def __init__(
        self,
        function: Callable[..., Any],
        a: tuple[float, float] = (-8.0, 8.0),
        b: tuple[float, float] = (-8.0, 8.0),
        fraction: int = FRACTION,
    ) -> None:
        self.function, self.fraction = function, fraction
        self.ends = [tuple(constant(end, fraction) for end in ends) for ends in (a, b)]
        self.graph = admitted(Graph())
        nodes = [self.graph.input(name, 40, signed=True) for name in "ab"]
        for node, (low, high) in zip(nodes, self.ends, strict=True):
            self.graph.within(node, low, high)
        reals = [Real(Word(self.graph, node), fraction) for node in nodes]
        n, f = (Word(self.graph, self.graph.input(name, bits)) for name, bits in (("n", 2), ("f", 1)))
        self.words = self.kept(function(*reals, n, f))
        self.roots = [word.node if isinstance(word, Word) else self.graph.constant(word) for word in self.words]

    def kept(self, result: Any) -> list[Any]:
        """The words of numbers, of integers and flags too."""
        results = result if isinstance(result, tuple) else (result,)
        return [stored(x, -(2.0**33), 2.0**33, self.fraction) for x in results]

    def agrees(self, a: int, b: int, n: int = 0, f: int = 0) -> None:
        """Compare with Python's integers, and every node with what the graph knows of it."""
        found = values(self.roots, {"a": a, "b": b, "n": n, "f": f})
        for node, value in found.items():
            assert node.low <= value <= node.high, node
            assert node.bits <= MOST_BITS, node
        truth = self.kept(self.function(Real(a, self.fraction), Real(b, self.fraction), n, bool(f)))
        assert [found[root] for root in self.roots] == [int(word) for word in truth]

    def agrees_at_random(self, trials: int = 200) -> None:
        generator = random.Random(0)
        for trial in range(trials):
            words = [
                generator.choice(ends) if trial < 8 else _spread(generator, *ends) for ends in self.ends
            ]
            self.agrees(*words, generator.randrange(4), generator.randrange(2))


def _spread(generator: random.Random, low: int, high: int) -> int:
    """A number of a range, of any size."""
    small = generator.choice((-1, 1)) * generator.randint(0, 1 << generator.randint(1, 33))
    return min(max(small, low), high) if generator.random() < 0.7 else generator.randint(low, high)


def of(name: Any) -> Callable[..., Any]:
    return FUNCTIONS[name]


UNARY: dict[str, Callable[[Any], Any]] = {
    "negative": operator.neg,
    "absolute": abs,
    "sine": of(np.sin),
    "cosine": of(math.cos),
    "tangent": of(np.tanh),
    "root": lambda x: of(np.sqrt)(abs(x)),
    "exponential": lambda x: of(np.exp)(of(np.clip)(x, -30, 3.5)),
    "square": lambda x: of(np.clip)(x, -10.0, 10.0) ** 2,
    "inverse": lambda x: 1 / (0.25 + abs(x)),
    "floor": of(math.floor),
    "rounded": of(round),
    "whole": of(int),
    "scaled": lambda x: x * 0.02,
    "parted": lambda x: x / 1.1,
    "turned": lambda x: (x + math.pi) % (2 * math.pi) - math.pi,
    "positive": lambda x: x > 0,
}
BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "sum": operator.add,
    "difference": operator.sub,
    "product": lambda x, y: of(np.clip)(x, -20, 20.0) * y,
    "quotient": lambda x, y: x / of(max)(y, 0.1),
    "quotient of negatives": lambda x, y: x / of(np.minimum)(y, -0.003),
    "less": operator.lt,
    "least": of(min),
    "greatest": of(np.maximum),
}
LEAVES: dict[str, Callable[..., Any]] = {
    "a": lambda a, b, n, f: a,
    "b": lambda a, b, n, f: b,
    "n": lambda a, b, n, f: n,
    "third": lambda a, b, n, f: 1 / 3,
    "two": lambda a, b, n, f: 2,
    "force": lambda a, b, n, f: select(f, 10.0, -10.0),
    "steps": lambda a, b, n, f: (n - 1) * 0.001,
    "stopped": lambda a, b, n, f: select(a < b, 0.0, b),
    "either": lambda a, b, n, f: select(n == 2, a, b),
    "halved": lambda a, b, n, f: n / 2,
}


def depth(*trees: Any) -> int:
    return max(1 if isinstance(tree, str) else 1 + depth(*tree[1:]) for tree in trees)


TREES = st.recursive(
    st.sampled_from(sorted(LEAVES)),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(sorted(UNARY)), inner),
        st.tuples(st.sampled_from(sorted(BINARY)), inner, inner),
        st.tuples(st.just("select"), inner, inner),
    ),
    max_leaves=6,
)


def computed(tree: Any, *arguments: Any) -> Any:
    """What an expression is of these arguments."""
    if isinstance(tree, str):
        return LEAVES[tree](*arguments)
    name, *inner = tree
    operands = [computed(x, *arguments) for x in inner]
    if name == "select":
        return select(arguments[3], *operands)
    return (UNARY if len(operands) == 1 else BINARY)[name](*operands)


@settings(deadline=None, max_examples=6000)
@given(TREES, st.randoms(use_true_random=False))
@example(("scaled", ("parted", "force")), random.Random(0))
@example(("sine", "stopped"), random.Random(0))
@example(("product", "a", "steps"), random.Random(0))
@example(("quotient", "a", ("select", "n", "third")), random.Random(0))
def test_any_expression_is_the_same_traced(tree: Any, generator: random.Random) -> None:
    try:
        traced = Traced(lambda *arguments: computed(tree, *arguments))
    except ArgumentError as error:
        assume("this can be" not in str(error) and "floats" not in str(error) and "integer" not in str(error))
        raise
    for _ in range(20):
        words = [_spread(generator, *ends) for ends in traced.ends]
        traced.agrees(*words, generator.randrange(4), generator.randrange(2))
