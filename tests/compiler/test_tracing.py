"""What a golden function may do, and the sentence that its author gets for what it may not."""

from __future__ import annotations

import gc
import random
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.golden.tracing import rewriting
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import arrays, values
from pearl_marl.golden.tracing.trace import trace

TABLE = np.array([5, 7, 11, 13])
GRID = [[1, 2, 3, 4], [5, 6, 7, 8]]


def run(function: Callable[..., Any], *arguments: int) -> list[int]:
    """Trace a function of words of two bits and a flag, and return its results for these."""
    graph = Graph()
    names = [f"x{k}" for k in range(len(arguments))]
    nodes = [graph.input(name, 2) for name in names]
    results = trace(graph, function, nodes)
    found = values(results, dict(zip(names, arguments, strict=True)))
    return [found[node] for node in results]


def test_loops_helpers_tables_and_tuples_unroll() -> None:
    def helper(x: Any, k: int) -> Any:
        return x * k

    def step(a: Any, b: Any) -> Any:
        total = sum(helper(a, k) for k in range(4))
        low, high = (a, b) if TABLE[0] == 5 else (b, a)
        return total, TABLE[a], GRID[1][b], min(max(low - high, -1), 1), abs(a - b), a**2, (a + 7) // 3 % 2

    for a in range(4):
        for b in range(4):
            wanted = [
                6 * a,
                TABLE[a],
                GRID[1][b],
                min(max(a - b, -1), 1),
                abs(a - b),
                a * a,
                (a + 7) // 3 % 2,
            ]
            assert run(step, a, b) == wanted


def test_a_table_of_tables_takes_two_words() -> None:
    grid = np.array([[1, 2, 3, 4], [5, 6, 7, 8], [9, 8, 7, 6], [4, 3, 2, 1]])

    def step(a: Any, b: Any) -> Any:
        return grid[a, b], grid[a][b]

    assert all(run(step, a, b) == [grid[a, b]] * 2 for a in range(4) for b in range(4))


def test_a_row_that_a_word_chose_is_a_table_itself() -> None:
    cube = [[[8 * i + 3 * j + k for k in range(4)] for j in range(4)] for i in range(4)]

    def step(a: Any, b: Any) -> Any:
        return cube[a][b][a], cube[a][1:4][2][b], cube[1][a][b]

    for a in range(4):
        for b in range(4):
            assert run(step, a, b) == [cube[a][b][a], cube[a][3][b], cube[1][a][b]]


HALF = np.uint8(200)


def test_numbers_of_numpys_are_integers() -> None:
    def step(a: Any) -> Any:
        return HALF + HALF + a

    assert run(step, 3) == [403]


def wide(function: Callable[..., Any]) -> list[tuple[int, int]]:
    """Return the ranges of what a function makes of a signed word of 20 bits and another one of 12."""
    graph = Graph()
    nodes = trace(graph, function, [graph.input("a", 20, signed=True), graph.input("b", 12)])
    cases = [(a, b) for a in (-(1 << 19), -1, 0, 1, 99, (1 << 19) - 1) for b in (0, 4, 5, 6, 99, 100, 4095)]
    for a, b in cases:
        found = values(nodes, {"a": a, "b": b})
        assert all(node.low <= found[node] <= node.high for node in nodes)
    return [(node.low, node.high) for node in nodes]


def test_a_choice_by_a_comparison_narrows_a_range_down() -> None:
    def step(a: Any, b: Any) -> Any:
        return (
            min(a, b),
            max(a, b),
            min(max(a, -3), b),
            (9 if b == 0 else b) - 1,
            0 if b == 4095 else b,
            b if b < 100 else 7,
            7 if b > 100 else b,
            50 if b < 5 else b,
            b if b > 5 else 50,
            b if a > b else a,
            b if a >= 0 else 4095 + a,
            max(b - 1, 0),
        )

    least, most = -(1 << 19), (1 << 19) - 1
    assert wide(step) == [
        (least, 4095),
        (0, most),
        (-3, 4095),
        (0, 4094),
        (0, 4094),
        (0, 99),
        (0, 100),
        (5, 4095),
        (6, 4095),
        (least, 4095),
        (4095 + least, 4095),
        (0, 4094),
    ]


def power(x: Any, n: int) -> Any:
    return x * power(x, n - 1) if n else 1


def test_a_limit_under_a_condition_is_one_choice_by_two_flags() -> None:
    graph = Graph()
    word, zero = graph.input("word", 16, signed=True), graph.constant(0)
    flag, sign = graph.input("flag", 1), graph.less(word, zero)
    for extreme, chosen in ((graph.maximum, sign), (graph.minimum, graph.logical_not(sign))):
        for there in (flag, graph.logical_not(flag)):
            by_both = graph.and_(there, chosen)
            limited = graph.choose(there, extreme(word, zero), word)
            reset = graph.choose(there, extreme(word, zero), zero)
            for node, wanted in (
                (limited, graph.choose(by_both, zero, word)),
                (reset, graph.choose(graph.and_(there, graph.logical_not(chosen)), word, zero)),
            ):
                assert node is wanted
            assert (reset.low, reset.high) == ((0, 2**15 - 1) if chosen is sign else (-(2**15), 0))


def test_a_helper_may_call_itself() -> None:
    def step(a: Any) -> Any:
        return power(a, 3)

    assert [run(step, a) for a in range(4)] == [[0], [1], [8], [27]]


def doubled(x: Any) -> Any:
    return [doubled(part) for part in x] if isinstance(x, list) else 2 * x


def test_a_helper_may_call_itself_in_a_list() -> None:
    def step(a: Any) -> Any:
        (b,), c = doubled([[a], a + 1])
        return b, c

    assert run(step, 3) == [6, 8]


def test_a_word_that_ends_at_a_power_of_two_has_the_bits_below_it() -> None:
    graph = Graph()
    word = graph.input("x", 4, False, 0, 8)
    results = trace(graph, lambda x: (x + 1, x & 7, x | 1), [word])
    for x in range(9):
        found = values(results, {"x": x})
        assert [found[node] for node in results] == [x + 1, x & 7, x | 1]


def test_a_remainder_is_below_its_divisor() -> None:
    def step(a: Any, b: Any) -> Any:
        return TABLE[:3][(a * 5 - b * 7) % 3]

    assert all(run(step, a, b) == [TABLE[(a * 5 - b * 7) % 3]] for a in range(4) for b in range(4))


def half(a: Any) -> Any:
    return a / 2


def floats(a: Any) -> Any:
    return a + 0.5


def returned_float(a: Any) -> Any:
    return 1.5


def sine(a: Any) -> Any:
    return np.sin(a)


def divided(a: Any) -> Any:
    return 7 // (a - 1)


def beyond(a: Any) -> Any:
    return TABLE[a + 1]


def drawn(a: Any) -> Any:
    return a + random.randint(0, 3)


def unknown(a: Any) -> Any:
    return a + heights  # type: ignore[name-defined]  # noqa: F821


def counted(a: Any) -> Any:
    return [k for k in range(a)]  # noqa: C416


def back(a: Any) -> Any:
    return a << (1 - a)


def endless(a: Any) -> Any:
    return endless(a + 1)


def two(a: Any, b: Any) -> Any:
    return a


REFUSED = {
    half: "`/` makes a float; golden functions divide by `//`",
    floats: "0.5 is a float; golden functions work on integers",
    returned_float: r"returned_float\(\) returns 1.5 is a float",
    sine: "golden functions of integers have no np.sin",
    divided: r"a divisor can be -1 to 2, and `//` and `%` take one from 1; `max\(n, 1\)` keeps it in",
    beyond: "an index can be 1 to 4, and there are 4 elements; `min`, `max` or an `if` keeps it in",
    drawn: "golden functions cannot use random.randint; ask `draws` for random numbers",
    unknown: "NameError: name 'heights' is not defined",
    counted: r"range\(\) of a word; go over all rounds that there can be",
    back: "a shift can be by -2 to 1; possible are 0 to 63",
    endless: "a function calls itself without end: nothing that is known of words stops it",
    two: r"two\(\) is called with 1 words: missing a required argument: 'b'",
}


@pytest.mark.parametrize("function", REFUSED, ids=lambda function: function.__name__)
def test_what_no_hardware_can_is_refused_where_it_stands(function: Callable[..., Any]) -> None:
    first = function.__code__.co_firstlineno
    with pytest.raises(ArgumentError, match=REFUSED[function]) as found:
        run(function, 1)
    where = str(found.value).partition(": ")[0]
    line = first if function in (two, returned_float) else first + 1
    assert where == f"compiler/test_tracing.py, line {line}"


def test_nodes_have_the_names_and_lines_of_their_author() -> None:
    graph = Graph()

    def step(a: Any, b: Any) -> Any:
        total = a + b
        return total + 1

    first = step.__code__.co_firstlineno
    (result,) = trace(graph, step, [graph.input("a", 2), graph.input("b", 2)])
    (total, _) = result.args
    assert (total.name, total.line, result.line) == ("total", first + 1, first + 2)


def test_graphs_of_arrays_are_exact_beyond_64_bits() -> None:
    graph = Graph()
    word = graph.input("word", 60)
    nodes = trace(graph, lambda word: (word * 13 >> 60, word * 13 & 255), [word])
    given = [0, 1, (1 << 60) - 1, 987654321987654321]
    found = arrays(nodes, {"word": np.array(given)})
    assert [a.tolist() for a in found] == [[x * 13 >> 60 for x in given], [x * 13 & 255 for x in given]]


def test_threads_trace_at_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where another one goes on while a file is parsed, as it may when garbage is collected."""

    class Garbage:
        def __init__(self) -> None:
            self.itself = self

        def __del__(self) -> None:
            sum(range(300))

    def rewrite(name: str) -> None:
        for _ in range(50):
            Garbage()
        rewriting.rewritten.__wrapped__(get_spec(name).golden.step.__code__)

    monkeypatch.setattr(rewriting, "_definitions", rewriting._definitions.__wrapped__)

    threshold, interval = gc.get_threshold(), sys.getswitchinterval()
    try:
        gc.set_threshold(20)
        sys.setswitchinterval(1e-6)
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(rewrite, ["CartPole", "Taxi", "LevelBasedForaging", "Acrobot"] * 10))
    finally:
        gc.set_threshold(*threshold)
        sys.setswitchinterval(interval)
