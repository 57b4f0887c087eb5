"""What the operations of a graph mean: of integers, of ranges of them, and of arrays of few of them.

A node is a mathematical integer, which never overflows; ``wrap`` is where a word does. ``imm`` is what an
operation has besides its arguments: a constant's value, a shift, ``(bits, signed)`` of a wrap, the entries of
a table, the range of a ``narrow``.

Two operations have a meaning even where their result is not used, so that a graph can be run as a whole: a
divisor below 1 counts as 1, and a word beyond the range of a ``narrow`` is its nearest end. A compiler may
make anything of it.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

Range = tuple[int, int]


class Operation(Protocol):
    """What a range is made of."""

    op: str
    args: tuple[Any, ...]
    low: int
    high: int


def word_range(bits: int, signed: bool) -> Range:
    """Return the least and the greatest value of a word."""
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)


def bits_of(low: int, high: int) -> int:
    """Return the width that holds a range, with a sign's bit if it begins below 0."""
    if low >= 0:
        return max(1, high.bit_length())
    return max((-low - 1).bit_length(), max(high, 0).bit_length()) + 1


def wrapped(value: int, bits: int, signed: bool) -> int:
    """Return a value modulo ``2**bits``."""
    low, _ = word_range(bits, signed)
    return (value - low) % (1 << bits) + low


def _product(_: Any, a: Operation, b: Operation) -> Range:
    ends = [x * y for x in (a.low, a.high) for y in (b.low, b.high)]
    if a is b:
        return (0 if a.low <= 0 <= a.high else min(ends[0], ends[3])), max(ends)
    return min(ends), max(ends)


def _logic(op: str) -> Callable[..., Range]:
    def result(_: Any, a: Operation, b: Operation) -> Range:
        if op == "and" and (a.low >= 0 or b.low >= 0):
            return 0, min(x.high for x in (a, b) if x.low >= 0)
        ones = (1 << max(bits_of(min(x.low, 0), max(x.high, ~x.low)) - (x.low < 0) for x in (a, b))) - 1
        if a.low >= 0 and b.low >= 0:
            return (max(a.low, b.low) if op == "or" else 0), ones
        return ~ones, ones

    return result


def _sum(imm: Any, *args: Operation) -> Range:
    constant, weights = imm
    low = sum(
        (x.low if sign > 0 else -x.high) << shift for (sign, shift), x in zip(weights, args, strict=True)
    )
    high = sum(
        (x.high if sign > 0 else -x.low) << shift for (sign, shift), x in zip(weights, args, strict=True)
    )
    return low + constant, high + constant


def _shift(shift: Callable[[int, int], int]) -> Callable[..., Range]:
    def result(_: Any, a: Operation, by: Operation) -> Range:
        lows, highs = ([shift(end, count) for count in (by.low, by.high)] for end in (a.low, a.high))
        return min(lows), max(highs)

    return result


def _quotient(_: Any, a: Operation, by: Operation) -> Range:
    if a is by:
        return min(1, a.low), 1
    ends = [x // max(1, y) for x in (a.low, a.high) for y in (by.low, by.high)]
    return min(ends), max(ends)


def _remainder(_: Any, a: Operation, by: Operation) -> Range:
    most = max(1, by.high) - 1
    return 0, min(most, a.high) if a.low >= 0 else most


def _choose(_: Any, flag: Operation, a: Operation, b: Operation) -> Range:
    """Return the range of a choice; if the flag compares what it chooses, that narrows it down."""
    if flag.op == "less":
        p, q = flag.args
        lows = max(a.low, p.low + 1) if a is q else a.low, max(b.low, q.low) if b is p else b.low
        highs = min(a.high, q.high - 1) if a is p else a.high, min(b.high, p.high) if b is q else b.high
    elif flag.op == "equal" and b is flag.args[0]:
        p, q = flag.args
        lows = a.low, b.low + (q.low == q.high == b.low)
        highs = a.high, b.high - (q.low == q.high == b.high)
    else:
        lows, highs = (a.low, b.low), (a.high, b.high)
    return min(lows), max(highs)


RANGES: dict[str, Callable[..., Range]] = {
    "add": lambda _, a, b: (a.low + b.low, a.high + b.high),
    "sub": lambda _, a, b: (a.low - b.high, a.high - b.low),
    "mul": _product,
    "divide": lambda by, a: (a.low // by, a.high // by),
    "modulo": lambda by, a: (0, by - 1),
    "divide_by": _quotient,
    "modulo_by": _remainder,
    "and": _logic("and"),
    "or": _logic("or"),
    "xor": _logic("xor"),
    "invert": lambda _, a: (~a.high, ~a.low),
    "not": lambda _, a: (0, 1),
    "mask": lambda _, a: (-1, 0),
    "left": lambda by, a: (a.low << by, a.high << by),
    "right": lambda by, a: (a.low >> by, a.high >> by),
    "left_by": _shift(operator.lshift),
    "right_by": _shift(operator.rshift),
    "equal": lambda _, a, b: (0, 1),
    "less": lambda _, a, b: (0, 1),
    "choose": _choose,
    "table": lambda entries, i: (min(entries), max(entries)),
    "wrap": lambda imm, a: word_range(*imm),
    "narrow": lambda imm, a: imm,
    # What lowering makes of the above.
    "sum": _sum,
    "join": lambda bits, a, b: (a.low << bits, (a.high << bits) + (1 << bits) - 1),
    "word": lambda _, a: (a.low, a.high),
}
"""The range of a result, of ``imm`` and the arguments."""


def _wrap(imm: Any, a: Any) -> Any:
    bits, signed = imm
    low, _ = word_range(bits, signed)
    return ((a - low) & ((1 << bits) - 1)) + low


def _divisor(by: Any) -> Any:
    return np.maximum(by, 1) if isinstance(by, np.ndarray) else max(by, 1)


def _entry(entries: Sequence[int], index: Any) -> Any:
    if not isinstance(index, np.ndarray):
        return entries[index]
    # Values that a word cannot have may be beyond the table: not all that is known of it is in its function.
    return np.array(entries)[np.clip(index, 0, len(entries) - 1)]


VALUES: dict[str, Callable[..., Any]] = {
    "add": lambda _, a, b: a + b,
    "sub": lambda _, a, b: a - b,
    "mul": lambda _, a, b: a * b,
    "divide": lambda by, a: a // by,
    "modulo": lambda by, a: a % by,
    "divide_by": lambda _, a, by: a // _divisor(by),
    "modulo_by": lambda _, a, by: a % _divisor(by),
    "and": lambda _, a, b: a & b,
    "or": lambda _, a, b: a | b,
    "xor": lambda _, a, b: a ^ b,
    "invert": lambda _, a: ~a,
    "not": lambda _, a: 1 - a,
    "mask": lambda _, a: -a,
    "left": lambda by, a: a << by,
    "right": lambda by, a: a >> by,
    "left_by": lambda _, a, by: a << by,
    "right_by": lambda _, a, by: a >> by,
    "equal": lambda _, a, b: 1 * (a == b),
    "less": lambda _, a, b: 1 * (a < b),
    "choose": lambda _, c, a, b: np.where(c == 1, a, b) if isinstance(c, np.ndarray) else (a if c else b),
    "table": _entry,
    "wrap": _wrap,
    "narrow": lambda imm, a: np.minimum(np.maximum(a, imm[0]), imm[1]),
    "sum": lambda imm, *args: sum(
        (s * (x << k) for (s, k), x in zip(imm[1], args, strict=True)), start=imm[0]
    ),
    "join": lambda bits, a, b: (a << bits) + (b & ((1 << bits) - 1)),
    "word": lambda _, a: a,
}
"""The result itself, of Python integers or of arrays of ``int64`` that are small enough."""
