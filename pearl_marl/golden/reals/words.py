"""Arithmetic that is the same on Python's integers and on words of a graph, to the bit.

Nothing here depends on the range of a word, but for how a result is computed: the number is the same.
"""

from __future__ import annotations

from typing import Any

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.tracing.operations import bits_of, wrapped
from pearl_marl.golden.tracing.words import Word, node_of

MOST_BITS = 64
"""The widest word that a graph may have: kernels compute in this many bits."""


class TooWideError(ArgumentError):
    """A word would need more than :data:`MOST_BITS`; it would be from ``low`` to ``high``."""

    def __init__(self, low: int, high: int) -> None:
        super().__init__(f"a word can be {low} to {high}, and {MOST_BITS} bits do not hold that")
        self.low, self.high = low, high


def limits(word: Any) -> tuple[int, int]:
    """Return the least and the greatest value of a word, which of an integer are itself."""
    return (word.node.low, word.node.high) if isinstance(word, Word) else (word, word)


def narrowed(word: Any) -> Any:
    """Return a word as what is known of it under the conditions that lead here."""
    return Word(word.graph, node_of(word.graph, word)) if isinstance(word, Word) else word


def fits(low: int, high: int) -> bool:
    """Return whether words hold a range."""
    return bits_of(low, high) <= MOST_BITS


def either(flag: Any, a: Any, b: Any) -> Any:
    """Return word ``a`` where the flag is set, else ``b``."""
    if not isinstance(flag, Word):
        return a if flag else b
    return Word(flag.graph, flag.graph.choose(flag.node, node_of(flag.graph, a), node_of(flag.graph, b)))


def least(a: Any, b: Any) -> Any:
    """Return the less of two words."""
    return _extreme(min, "minimum", a, b)


def greatest(a: Any, b: Any) -> Any:
    """Return the greater of two words."""
    return _extreme(max, "maximum", a, b)


def _extreme(of_integers: Any, name: str, a: Any, b: Any) -> Any:
    for word in (a, b):
        if isinstance(word, Word):
            graph = word.graph
            return Word(graph, getattr(graph, name)(node_of(graph, a), node_of(graph, b)))
    return of_integers(a, b)


def kept(word: Any, bits: int) -> Any:
    """Return a word that ``bits`` with a sign do hold, where its range does not tell."""
    if isinstance(word, Word):
        return Word(word.graph, word.graph.wrap(word.node, bits, True))
    return wrapped(word, bits, True)


def noted(word: Any, low: int, high: int) -> Any:
    """Return a word that is within a range for a reason that arithmetic on ranges does not see."""
    return Word(word.graph, word.graph.within(word.node, low, high)) if isinstance(word, Word) else word


def absolute(word: Any) -> Any:
    """Return a word without its sign."""
    low, high = limits(word)
    return noted(abs(word), max(low, -high, 0), max(-low, high))


def product(a: Any, b: Any, shift: int) -> Any:
    """Return ``(a * b + half) >> shift``: to nearest, halves upwards; ``shift`` from 0.

    A product of more than 64 bits is made of two or three that have fewer, by splitting the factors; the
    result is the same.

    Raises
    ------
    TooWideError
        The result has more than 64 bits.
    """
    return _sum_shifted(a, b, 1 << shift >> 1, shift)


def _sum_shifted(a: Any, b: Any, addend: int, shift: int) -> Any:
    """Return ``(a * b + addend) >> shift``, rounded down."""
    if not isinstance(a, Word) and not isinstance(b, Word):
        return (a * b + addend) >> shift
    low, high = _limits_of_product(a, b)
    if fits(low, high + addend):
        return (a * b + addend) >> shift
    narrow, wide = sorted((a, b), key=lambda word: bits_of(*limits(word)))
    # As much as possible is cut off such that one product more will do, or else all that is shifted away.
    cut = min(shift, MOST_BITS - 2 - bits_of(*limits(narrow)))
    if cut < 1 or not fits(*_limits_of_product(wide >> cut, narrow)):
        cut = shift
    if bits_of(*limits(wide)) <= cut:
        raise TooWideError(low >> shift, high >> shift)
    carried = _sum_shifted(wide & ((1 << cut) - 1), narrow, addend, cut)
    whole = _limits_of_product(wide >> cut, narrow)
    if not fits(whole[0] + limits(carried)[0], whole[1] + limits(carried)[1]):
        raise TooWideError(low >> shift, high >> shift)
    return noted(
        ((wide >> cut) * narrow + carried) >> (shift - cut), (low + addend) >> shift, (high + addend) >> shift
    )


def _limits_of_product(a: Any, b: Any) -> tuple[int, int]:
    ends = [x * y for x in limits(a) for y in limits(b)]
    same = isinstance(a, Word) and isinstance(b, Word) and a.node is b.node
    return (0 if same and min(ends) < 0 else min(ends)), max(ends)


def shifted_product(a: Any, b: Any, shift: Any) -> Any:
    """Return the same as :func:`product`, by a shift that may be a word: from 1.

    Raises
    ------
    TooWideError
        As :func:`product` does.
    """
    fixed = limits(shift)[0] - 1
    return rounded(_sum_shifted(a, b, 0, fixed), shift - fixed)


def rounded(word: Any, shift: Any) -> Any:
    """Return ``word / 2**shift`` to nearest, halves upwards, by a shift from 1 that may be a word."""
    return ((word >> (shift - 1)) + 1) >> 1


def scaled(word: Any, shift: Any) -> Any:
    """Return ``word * 2**-shift`` to nearest, halves upwards; the shift may be a word, and negative.

    ``word`` is below ``2**31`` and not negative.

    Raises
    ------
    TooWideError
        The result has more than 64 bits.
    """
    more = max(0, 1 - limits(shift)[0])
    if isinstance(shift, Word) and not fits(0, limits(word)[1] << more):
        raise TooWideError(0, limits(word)[1] << more)
    return rounded(word << more, least(shift, 33) + more)
