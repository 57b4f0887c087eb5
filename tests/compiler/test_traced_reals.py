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
from pearl_marl.golden.reals import Real, admitted
from pearl_marl.golden.reals.choices import Choice, select, stored
from pearl_marl.golden.reals.names import FUNCTIONS
from pearl_marl.golden.reals.numbers import constant
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import in_order, values
from pearl_marl.golden.tracing.trace import trace
from pearl_marl.golden.tracing.words import Word

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
        self.roots = [
            word.node if isinstance(word, Word) else self.graph.constant(word) for word in self.words
        ]

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

    def agrees_at_random(self, trials: int = 60) -> None:
        generator = random.Random(0)
        for trial in range(trials):
            words = [generator.choice(ends) if trial < 8 else _spread(generator, *ends) for ends in self.ends]
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


@settings(max_examples=400)
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


def test_reals_have_the_names_of_the_authors_variables() -> None:
    def step(a: Any) -> Any:
        x = Real(a, FRACTION)
        pushed = x * 0.02
        turned = pushed.sin()
        return turned.word

    graph = Graph()
    nodes = in_order(trace(graph, step, [graph.input("a", 32, signed=True)]))
    assert {node.name for node in nodes} == {None, "pushed", "turned"}


NARROW = [(0.3, 8.0), (1.2, 1.3), (-8.0, -0.1), (5 * 2.0**-27, 8.0), (0.0, 0.001), (-0.5, 0.5)]
WIDE = (20.0, 900.0)


@pytest.mark.parametrize("divisor", [WIDE, *(ends for ends in NARROW if ends[0] * ends[1] > 0)])
@pytest.mark.parametrize("numerator", [(-8.0, 8.0), (0.0, 8.0), (-30.0, 30.0)])
def test_quotients_of_ranges(numerator: tuple[float, float], divisor: tuple[float, float]) -> None:
    traced = Traced(lambda a, b, n, f: (a / b, 1 / b, a / (b + n * (b > 0))), numerator, divisor)
    traced.agrees_at_random()
    for a in traced.ends[0]:
        for b in traced.ends[1]:
            traced.agrees(a, b)


@pytest.mark.parametrize("least", [3, 5, 7, 11, 13])
def test_large_quotients_are_within_their_range(least: int) -> None:
    traced = Traced(lambda a, b, n, f: a / b, (1.0, 8.0), (least * 2.0**-FRACTION, 8.0))
    traced.agrees(traced.ends[0][1], least)


def test_a_divisor_of_a_narrow_range_is_not_normalised() -> None:
    def shifts(divisor: tuple[float, float]) -> int:
        traced = Traced(lambda a, b, n, f: a / b, b=divisor)
        return sum(node.op == "choose" for node in in_order(traced.roots))

    assert shifts((1.2, 1.3)) == 0
    assert shifts((1.2, 2.3)) > 0


@pytest.mark.parametrize("fraction", [20, 24, 30])
@pytest.mark.parametrize("a", NARROW)
def test_functions_of_ranges(a: tuple[float, float], fraction: int) -> None:
    def function(a: Any, b: Any, n: Any, f: Any) -> tuple[Any, ...]:
        angle = np.sin(a), np.cos(a + 100), np.tanh(a), np.exp(of(np.maximum)(-a, -1.0) / 8)
        whole = math.floor(a), math.ceil(a), round(a), of(int)(a), np.rint(a)
        return *angle, *whole, abs(a) ** 0.5, np.hypot(a, 1.0), a % 0.3, (a + 100) % 1.0, a % 5

    Traced(function, a, fraction=fraction).agrees_at_random()


def test_a_remainder_of_few_turns_takes_no_division() -> None:
    order = in_order(Traced(lambda a, b, n, f: (a + math.pi) % (2 * math.pi)).roots)
    assert "modulo" not in {node.op for node in order}


def test_square_roots_of_wide_words() -> None:
    Traced(
        lambda a, b, n, f: ((a * a) ** 0.5, ((a * b) ** 2) ** 0.5), (-900.0, 900.0), (-60.0, 60.0)
    ).agrees_at_random()


def test_a_product_beyond_64_bits_is_split_and_the_same() -> None:
    traced = Traced(lambda a, b, n, f: (a * b, a * a, a * 0.3, a / 7.7), (-900.0, 900.0), (-800.0, 500.0))
    whole = [node for node in in_order(traced.roots) if node.op == "mul"]
    assert len(whole) > 4
    traced.agrees_at_random()


def test_a_constant_that_a_word_chooses_takes_one_multiplication() -> None:
    def multiplications(function: Callable[..., Any]) -> int:
        return sum(node.op == "mul" for node in in_order(Traced(function).roots))

    assert multiplications(lambda a, b, n, f: a * (n * 0.1)) == 1
    assert multiplications(lambda a, b, n, f: a * select(f, 0.1, 0.9)) == 1
    assert multiplications(lambda a, b, n, f: a * 0.25) == 0
    # And of two branches that are real, or one of them, a function is made once.
    assert multiplications(lambda a, b, n, f: select(f, a, b) * 0.3) == 1
    assert multiplications(lambda a, b, n, f: select(n == 1, a, select(n == 2, b, 0.7)) * 0.3) == 1


def test_floats_of_branches_stay_floats_until_reals_come() -> None:
    """A real of 1/3 times 3 is not 1; a float is."""

    def function(a: Any, b: Any, n: Any, f: Any) -> tuple[Any, ...]:
        third = select(f, 1 / 3, 0.1)
        ninth = third * third
        angle = select(n < 2, 0.3, a)
        return (
            *(
                third * 3 == 1,
                ninth > 0.1,
                a + ninth,
                7 / third,
                n * 0.1 + 0.2,
                select(n == 0, third, ninth) - b,
            ),
            *(
                of(math.sin)(angle),
                of(math.sqrt)(n),
                of(round)(10 * third),
                of(int)(n / 2),
                of(max)(n, 1.5) * b,
            ),
            *(
                angle**2,
                -angle,
                abs(angle),
                angle % 0.7,
                1.0 - angle,
                b / (third + 1),
                of(np.clip)(angle, 0, 0.2),
            ),
            *(
                +third,
                of(float)(n) / 3,
                of(float)(angle),
                of(math.floor)(third * 9),
                of(math.ceil)(angle),
                of(math.trunc)(angle),
                angle > 2.0,
            ),
        )

    Traced(function).agrees_at_random()
    flag = Word(graph := admitted(Graph()), graph.input("f", 1))
    assert isinstance(select(flag, 0.5, 1) * 3, Choice)
    assert isinstance(select(flag, 0.5, 1) < 0.7, Word)


def test_numpys_numbers_meet_words() -> None:
    Traced(
        lambda a, b, n, f: (
            np.float64(0.1) * n + a,
            n * np.float64(0.1),
            a - np.float64(2),
            np.float64(2) > a,
        )
    ).agrees_at_random()


def positive(a: Any, b: Any, n: Any, f: Any) -> Any:
    return 1 if a else 0


REFUSED: list[tuple[Callable[..., Any], str]] = [
    (
        lambda a, b, n, f: a / b,
        "a divisor can be -8 to 8, which has 0 in it; max(x, 0.001) or np.clip keeps it away",
    ),
    (lambda a, b, n, f: 1 / n, "ZeroDivisionError"),
    (lambda a, b, n, f: a / n, "a divisor can be 0 to 3, which has 0 in it"),
    (lambda a, b, n, f: a / (a**6 + 2**33), "a divisor can be 8.59046e+09, which is too much; clip it"),
    (lambda a, b, n, f: a**0.5, "a square root is taken of -8 to 8; max(x, 0.0) keeps it from below 0"),
    (
        lambda a, b, n, f: a**12,
        "this can be 0 to 6.872e+10, and reals end at 6.872e+10 here, as they have 27",
    ),
    (lambda a, b, n, f: (a * 2.0**33) + (b * 2.0**33), "np.clip what it is made of"),
    (lambda a, b, n, f: np.exp(4 * a), "and reals end at 6.872e+10 here"),
    (lambda a, b, n, f: float(a), "float() of a real; it has no value before hardware runs"),
    (lambda a, b, n, f: float(n * 0.5), "float() of a number that a word chooses"),
    (lambda a, b, n, f: int(a), "Python needs a number here"),
    (lambda a, b, n, f: a % b, "`%` of a real takes a constant above 0"),
    (lambda a, b, n, f: math.floor(a * 100) * 0.1, "an integer that can be -800 to 800 meets a float"),
    (
        lambda a, b, n, f: select(f, math.floor(a * 100), 0.5),
        "an integer that can be -800 to 800 meets a float",
    ),
    (positive, "a word decides what Python does next"),
    (lambda a, b, n, f: 1 if n * 0.5 else 0, "a word decides what Python does next"),
    (lambda a, b, n, f: hash(n * 0.5), "unhashable"),
]


@pytest.mark.parametrize(("function", "sentence"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_refused(function: Callable[..., Any], sentence: str) -> None:
    with pytest.raises((ArgumentError, ZeroDivisionError, TypeError)) as caught:
        Traced(function)
    assert sentence in f"{type(caught.value).__name__}: {caught.value}"


def test_too_many_cases_are_refused() -> None:
    graph = admitted(Graph())
    words = [Word(graph, graph.input(f"w{k}", 5)) * 0.1 for k in range(2)]
    with pytest.raises(ArgumentError, match="depends on words of 1024 values together, and up to 256"):
        words[0] + words[1]


def test_without_reals_words_meet_no_floats() -> None:
    word = Word(graph := Graph(), graph.input("n", 2))
    with pytest.raises(ArgumentError, match=r"0\.5 is a float; golden functions work on integers"):
        word * 0.5
