"""Lowered graphs: the same integers, of the multipliers and adders that a family has; and their stages."""

from __future__ import annotations

import random

import pytest

from pearl_marl.compiler.core_graph import Output
from pearl_marl.compiler.lowering import lowered
from pearl_marl.compiler.scheduling import scheduled
from pearl_marl.compiler.targets import Target
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node, in_order, values

XC7, ECP5 = Target("xc7", 150), Target("ecp5", 150)


def made(graph: Graph, node: Node, bits: int, target: Target) -> Node:
    """Return what becomes of a node, and hold it against the node in random cases."""
    (output,) = lowered(graph, [Output("obs_o", "word", bits, node)], target)
    chance = random.Random(bits)
    for _ in range(200):
        inputs = {
            n.imm: chance.choice((n.low, n.high, chance.randint(n.low, n.high)))
            for n in in_order([node])
            if n.op == "input"
        }
        due, found = values([node], inputs)[node], values([output.node], inputs)[output.node]
        assert (due - found) % (1 << bits) == 0, inputs
    return output.node


def count(node: Node, op: str) -> int:
    return sum(n.op == op for n in in_order([node]))


@pytest.mark.parametrize("target", [XC7, ECP5], ids=str)
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("factor", [None, 5, 13, -38523, 0x33333333, 0xCCCCCCC, 0x48ABCDE1, -0x4CCCCCCD])
@pytest.mark.parametrize("rounding", [0, 1 << 29, (1 << 29) - (7 << 40), (1 << 29) + (0x2A5F << 37)])
def test_rounded_products(target: Target, signed: bool, factor: int | None, rounding: int) -> None:
    graph = Graph()
    a, y = graph.input("a", 32, signed), graph.input("y", 32, True)
    b = graph.input("b", 31, signed) if factor is None else graph.constant(factor)
    product = graph.right(graph.add(graph.mul(a, b), graph.constant(rounding)), 30)
    made(graph, graph.wrap(product, 32, True), 32, target)
    made(graph, graph.wrap(graph.add(product, y), 32, True), 32, target)


def test_a_multiplier_adds_what_comes_from_the_one_before() -> None:
    graph = Graph()
    product = graph.mul(graph.input("a", 32), graph.input("b", 32))
    node = made(graph, graph.right(graph.add(product, graph.constant(1 << 29)), 30), 32, XC7)
    sums = [n for n in in_order([node]) if n.op == "sum"]
    assert count(node, "mul") == len(sums) == 4
    assert all(XC7.accumulates(n, 48) for n in sums)


def test_two_digits_of_a_draw_come_from_one_product() -> None:
    graph = Graph()
    first = graph.mul(graph.input("draw", 32), graph.constant(5))
    second = graph.mul(graph.wrap(first, 32, False), graph.constant(7))
    digits = graph.add(graph.left(graph.right(first, 32), 3), graph.right(second, 32))
    # 35 times 24 bits, and 35 times the 8 bits above them.
    assert count(made(graph, digits, 6, XC7), "mul") == 2


def test_short_products_are_sums() -> None:
    graph = Graph()
    product = graph.mul(graph.input("a", 6), graph.constant(13))
    assert count(made(graph, product, 10, XC7), "mul") == 0


def test_a_bit_of_a_tables_row_is_a_table() -> None:
    graph = Graph()
    row = graph.table([3, 9, 12, 5], graph.input("row", 2))
    bit = graph.wrap(graph.right_by(row, graph.input("column", 3)), 1, False)
    node = made(graph, bit, 1, XC7)
    assert count(node, "right_by") == 0
    assert count(node, "table") == 1


@pytest.mark.parametrize("limit", [5, 0xAAAAAAAB, 0xAAAAAA80])
@pytest.mark.parametrize("signed", [False, True])
def test_long_comparisons_with_a_constant(limit: int, signed: bool) -> None:
    graph = Graph()
    a, b = graph.input("a", 32, signed), graph.constant(limit - (signed << 31))
    # Two bits beside five places of six; if they are 0 in the constant, nothing enters the chain.
    for node, bound in ((graph.less(a, b), limit), (graph.less(b, a), limit + 1)):
        assert made(graph, node, 1, XC7).imm == (2 if bound % 4 else None)
        assert made(graph, node, 1, ECP5).imm is None


@pytest.mark.parametrize("target", [XC7, Target("ecp5", 300)], ids=str)
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("bits", [(2, 3), (7, 3), (12, 12), (5, 17), (40, 32)], ids=str)
def test_divisions_by_words(target: Target, signed: bool, bits: tuple[int, int]) -> None:
    graph = Graph()
    a, b = graph.input("a", bits[0], signed), graph.input("b", bits[1])
    for by in (graph.maximum(b, graph.constant(1)), graph.add(b, graph.constant(1 << bits[1]))):
        quotient, rest = graph.floor_divide(a, by), graph.modulo(a, by)
        for node in (quotient, rest):
            made(graph, node, node.bits, target)
        made(graph, quotient, (quotient.bits + 1) // 2, target)


def test_quotient_and_remainder_share_a_divider() -> None:
    graph = Graph()
    a, by = graph.input("a", 16), graph.maximum(graph.input("b", 8), graph.constant(1))
    quotient, rest = graph.floor_divide(a, by), graph.modulo(a, by)
    alone = count(made(graph, quotient, 16, XC7), "sum")
    assert count(made(graph, graph.xor(quotient, rest), 16, XC7), "sum") == alone


def test_a_word_is_narrowed_down_by_a_cut() -> None:
    graph = Graph()
    a = graph.input("a", 5, signed=True)
    known = graph.and_(graph.less(graph.constant(-12), a), graph.less(a, graph.constant(-2)))
    inside = graph.narrow(graph.add(a, graph.constant(8)), -3, 5)
    entry = graph.table(range(100, 1000, 100), graph.add(inside, graph.constant(3)))
    for node in (graph.mul(inside, inside), entry):
        made(graph, graph.choose(known, node, graph.constant(7)), 10, XC7)


@pytest.mark.parametrize(("target", "delayed"), [(XC7, 1), (ECP5, 2)])
def test_one_long_delay_is_better_than_two_where_there_are_shift_registers(
    target: Target, delayed: int
) -> None:
    graph = Graph()
    numbers = [graph.input("draw", 32)]
    for _ in range(6):
        numbers.append(graph.wrap(graph.mul(numbers[-1], numbers[-1]), 32, False))
    flag = graph.less(numbers[3], graph.constant(12345))
    # Once the flag is known the sum is a bit less to keep than what it is made of.
    word = graph.wrap(graph.add(graph.input("word", 30), flag), 30, False)
    outputs = [Output("obs_o", "word", 30, word), Output("state_o", "last", 32, numbers[-1])]
    schedule = scheduled(lowered(graph, outputs, target), target)
    long = [n for n in schedule.order if schedule.last[n] - schedule.stage[n] > 2]
    assert sum(schedule.used[n].bit_count() == 30 for n in long) == delayed
