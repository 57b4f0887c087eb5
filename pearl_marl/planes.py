"""Boards of bits shown as planes of bytes, for an environment's ``unpack``."""

from __future__ import annotations

from typing import Any

from pearl_marl.golden import Word


def interleave(first: Word, second: Word, count: int, row: Any) -> None:
    """Write the bits of two boards into a row by turns.

    Parameters
    ----------
    first, second
        Words, of which bit ``k`` becomes ``row[2 * k]`` and ``row[2 * k + 1]``.
    count
        How many bits of each, 1 to 64; a constant.
    row
        A flat array of bytes, 0 or 1 each. CPU kernels write 16 to 64 of them at a time.
    """
    for bit in range(count):
        row[2 * bit] = int(first) >> bit & 1
        row[2 * bit + 1] = int(second) >> bit & 1
