"""Words that are narrowed down to what a branch knows of them, and choices of what else is known there."""

from __future__ import annotations

import itertools

import pytest

from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node, values


def test_a_word_is_narrowed_down_to_what_it_can_be() -> None:
    graph = Graph()
    x = graph.input("x", 8)
    inner = graph.narrow(x, -3, 200)
    assert (inner.low, inner.high) == (0, 200)
    assert graph.narrow(x, 0, 300) is x
    assert graph.narrow(inner, 7, 900) is graph.narrow(x, 7, 200)
    assert graph.narrow(x, 3, 3) is graph.constant(3)
    assert graph.narrow(inner, 201, 300) is graph.constant(201)  # in a branch that is never taken
    assert graph.less(inner, graph.constant(201)).is_constant(1)


def test_what_is_made_of_it_is_loose() -> None:
    graph = Graph()
    x, y = graph.input("x", 3), graph.input("y", 3)
    narrowed = graph.narrow(x, 2, 5)
    assert narrowed.loose
    assert graph.add(y, graph.mul(narrowed, y)).loose
    assert not graph.add(x, y).loose
    result = graph.choose(graph.equal(y, x), narrowed, y)
    result.loose = False
    assert not graph.add(result, x).loose
    assert not graph.again(result, [result.args[0], graph.add(narrowed, y), x]).loose


def test_it_is_no_function_of_the_word() -> None:
    graph = Graph()
    x = graph.input("x", 3)
    graph.narrow(x, 2, 5)
    clipped = graph.minimum(graph.maximum(x, graph.constant(2)), graph.constant(5))
    assert not clipped.loose
    assert not graph.less(graph.narrow(x, 2, 5), x).is_constant()


def test_a_function_that_was_found_in_a_branch_is_made_anew_behind_it() -> None:
    graph = Graph()
    x, y = graph.narrow(graph.input("x", 8), 1, 5), graph.input("y", 3)
    first = graph.table((0, 7, -100, 70, 1, 12), x)
    second = graph.table((7, -100, 70, 1, 12), graph.sub(x, graph.constant(1)))
    inside = graph.add(graph.sub(y, first), graph.add(second, graph.constant(9)))
    behind = graph.add(y, graph.constant(9))
    assert inside.function is not None
    assert behind.function is not None
    assert inside.function.values.tolist() == behind.function.values.tolist()
    assert inside.loose
    assert not behind.loose


@pytest.mark.parametrize("op", ["and_", "or_"])
@pytest.mark.parametrize("first", [False, True])
def test_choices_among_what_is_known(op: str, first: bool) -> None:
    graph = Graph()
    words = [graph.input(name, 20) for name in "abc"]
    # Of so many values that nobody finds out by trying.
    f, g = (graph.less(graph.input(name, 20), graph.constant(3)) for name in "fg")
    a, b, c = words
    inner = graph.choose(getattr(graph, op)(*((f, g) if first else (g, f))), a, b)
    made = {
        "holds": graph.choose(f, inner, c),
        "does not": graph.choose(f, c, inner),
        "itself": graph.choose(f, graph.add(f, a), f),
        "both": graph.choose(f, f, g),
        "either": graph.choose(f, g, f),
    }
    expected = {
        "holds": graph.choose(f, graph.choose(g, a, b) if op == "and_" else a, c),
        "does not": graph.choose(f, c, b if op == "and_" else graph.choose(g, a, b)),
        "itself": graph.choose(f, graph.add(f, a), graph.constant(0)),
        "both": graph.or_(f, g),
        "either": graph.and_(f, g),
    }
    assert made == expected


def test_a_flag_that_takes_one_bit_of_a_word() -> None:
    """Of ``f & word`` no choice can be made by the word."""
    graph = Graph()
    word, a, b, c = (graph.input(name, 20) for name in ("word", "a", "b", "c"))
    f = graph.less(a, b)
    node = graph.choose(f, graph.choose(graph.and_(f, graph.wrap(word, 1, False)), a, b), c)
    for inputs in itertools.product((1, 2), (5, 6), (4, 7), (9,)):
        given = dict(zip(("word", "a", "b", "c"), inputs, strict=True))
        w, x, y, z = inputs
        assert values([node], given)[node] == ((x if w & 1 else y) if x < y else z)


def quotients(graph: Graph, a: Node, b: Node) -> tuple[Node, Node]:
    return graph.floor_divide(a, b), graph.modulo(a, b)


def test_divisions_that_are_none() -> None:
    graph = Graph()
    x, small = graph.input("x", 20), graph.input("small", 4)
    big = graph.add(x, graph.constant(16))
    one = graph.maximum(x, graph.constant(1))
    assert quotients(graph, small, big) == (graph.constant(0), small)
    assert quotients(graph, graph.constant(0), one) == (graph.constant(0), graph.constant(0))
    assert graph.floor_divide(one, one).is_constant(1)
    assert graph.floor_divide(graph.constant(100), one).high == 100
    assert graph.modulo(small, one).high == 15
    assert graph.floor_divide(graph.input("y", 8, signed=True), one).low == -128
