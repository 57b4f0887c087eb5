"""Numbers that a word of few values chooses, of which some are still Python's floats.

``force = 10.0 if action == 1 else -10.0`` is a float where the reference runs it, and so are ``force / 1.1``
and ``math.sin(force)``. Traced, it is a choice: what the reference would do to one float is done to each of
them, so that both get the same bits, until reals come in.
"""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable, Hashable, Sequence
from typing import Any

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.reals.numbers import Number, Real, constant, factor, integer
from pearl_marl.golden.reals.words import either, greatest, least, limits
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.golden.tracing.words import Word

MOST_CASES = 256
"""Values that a word which chooses among numbers can have."""


def _operation(name: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    function = getattr(operator, name)
    return lambda self, other: applied(function, self, other), lambda self, other: applied(
        function, other, self
    )


def _each(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda self: applied(function, self)


class Choice(Number):
    """One of several numbers: ``cases[index]``, of which one is a float at least.

    Cases are Python's numbers, and reals.
    """

    __slots__ = ("cases", "index")

    def __init__(self, index: Word, cases: Sequence[Any]) -> None:
        self.index, self.cases = index, tuple(cases)

    __add__, __radd__ = _operation("add")
    __sub__, __rsub__ = _operation("sub")
    __truediv__, __rtruediv__ = _operation("truediv")
    __floordiv__, __rfloordiv__ = _operation("floordiv")
    __mod__, __rmod__ = _operation("mod")
    __pow__, __rpow__ = _operation("pow")
    __lt__, _ = _operation("lt")
    __le__, _ = _operation("le")
    __gt__, _ = _operation("gt")
    __ge__, _ = _operation("ge")
    __eq__, _ = _operation("eq")
    __ne__, _ = _operation("ne")

    def __mul__(self, other: object) -> Any:
        if isinstance(other, Real) and not any(isinstance(case, Real) for case in self.cases):
            return self._times(other)
        return applied(operator.mul, self, other)

    __rmul__ = __mul__

    def _times(self, real: Real) -> Real:
        """Return the product with a real, by one multiplication: as of each case, by its factor and shift."""
        factors = [factor(x) if isinstance(x, float) else (int(x), 0) for x in self.cases]
        shift = max(0, *(shift for _, shift in factors))
        wholes = [whole << shift - own for whole, own in factors]
        return real.times(_looked_up(self.index, wholes), shift)

    def __repr__(self) -> str:
        return "a number that a word chooses"

    __neg__ = _each(operator.neg)
    __abs__ = _each(abs)
    __floor__ = _each(math.floor)
    __ceil__ = _each(math.ceil)
    __trunc__ = _each(math.trunc)

    def __pos__(self) -> Choice:
        return self

    def __round__(self, digits: int | None = None) -> Any:
        return applied(lambda case: round(case, digits), self)

    def __bool__(self) -> bool:
        return bool(self != 0)

    def __float__(self) -> float:
        raise ArgumentError("float() of a number that a word chooses; it has no value before hardware runs")


def choice_of(word: Word) -> Choice:
    """Return all that an integer can be, to meet floats: where the reference has it, that makes a float.

    Raises
    ------
    ArgumentError
        The word can have more than 256 values.
    """
    low, high = limits(word)
    if high - low >= MOST_CASES:
        raise ArgumentError(
            f"an integer that can be {low} to {high} meets a float, which is possible up to {MOST_CASES} "
            "values; multiply or add a real first, as in `x * n * 0.1`, or keep it as a real"
        )
    return Choice(word - low, range(low, high + 1))


def applied(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function makes of every case of its arguments, as a choice, real or word.

    Raises
    ------
    ArgumentError
        The cases are too many.
    """
    choices = [x if isinstance(x, Choice) else _cases_of(x) for x in arguments]
    index, sizes = _joint(choices)
    done: dict[Hashable, Any] = {}
    results = []
    for places in itertools.product(*map(range, sizes.values())):
        at = dict(zip(sizes, places, strict=True))
        case = [c.cases[at[c.index.node]] if isinstance(c, Choice) else c for c in choices]
        key = tuple(map(_identity, case))
        if key not in done:
            done[key] = function(*case)
        results.append(done[key])
    return joined(index, results)


def _cases_of(argument: Any) -> Any:
    """Return an integer word as the integers that it can be."""
    return choice_of(argument) if isinstance(argument, Word) else argument


def _identity(value: Any) -> Hashable:
    # 0.0 and -0.0 are equal, and so are 1 and 1.0.
    return repr(value) if isinstance(value, (int, float)) else id(value)


def _joint(choices: Sequence[Any]) -> tuple[Word, dict[Node, int]]:
    """Return the word that numbers all combinations of cases, and how many every index has, in order."""
    sizes: dict[Node, int] = {}
    index: Word | None = None
    for choice in choices:
        if isinstance(choice, Choice) and choice.index.node not in sizes:
            size = sizes[choice.index.node] = len(choice.cases)
            index = choice.index if index is None else index * size + choice.index
    assert index is not None
    cases = math.prod(sizes.values())
    if cases > MOST_CASES:
        raise ArgumentError(
            f"a number depends on words of {cases} values together, and up to {MOST_CASES} are possible for "
            "floats; add 0 times a real to one of them, to make it a real"
        )
    return index, sizes


def joined(index: Word, cases: Sequence[Any]) -> Any:
    """Return one number of those that an index chooses: the number itself, a word, a real, or a choice."""
    if len({_identity(case) for case in cases}) == 1:
        return cases[0]
    whole = [integer(case) for case in cases]
    if all(case is not None for case in whole):
        return _looked_up(index, whole)
    reals = [case for case in cases if isinstance(case, Real)]
    if len(reals) < len(cases):
        return Choice(index, _with_one_real(index, cases))
    return Real(_looked_up(index, [case.word for case in reals]), reals[0].fraction)


def _with_one_real(index: Word, cases: Sequence[Any]) -> list[Any]:
    """Return the cases with all reals replaced by their choice, so that a function of them is made once."""
    if any(isinstance(case, Word) for case in cases):
        raise ArgumentError("a number is an integer on one branch and a float on another; make both floats")
    reals = [case for case in cases if isinstance(case, Real)]
    if len({id(real) for real in reals}) < 2:
        return list(cases)
    words = [case.word if isinstance(case, Real) else reals[0].word for case in cases]
    one = Real(_looked_up(index, words), reals[0].fraction)
    return [one if isinstance(case, Real) else case for case in cases]


def _looked_up(index: Word, words: Sequence[Any]) -> Any:
    """Return the word that an index chooses."""
    graph = index.graph
    if not any(isinstance(word, Word) for word in words):
        return Word(graph, graph.table(words, index.node))
    found = words[-1]
    for place in reversed(range(len(words) - 1)):
        if words[place] is not words[place + 1] or found is not words[-1]:
            found = either(index == place, words[place], found)
    return found


def select(flag: Any, a: Any, b: Any) -> Any:
    """Return number ``a`` where a flag is set, else ``b``: words, reals, or floats."""
    if not isinstance(flag, Word):
        return a if flag else b
    if integer(a) is not None and integer(b) is not None:
        return either(flag, a, b)
    if isinstance(a, Real) and isinstance(b, Real):
        return Real(either(flag, a.word, b.word), a.fraction)
    if flag.node.is_constant():
        return a if flag.node.imm else b
    return applied(lambda chosen, x, y: x if chosen else y, Choice(flag, (False, True)), a, b)


def stored(value: object, low: float, high: float, fraction: int) -> Any:
    """Return the word of a state's field: the nearest number from ``low`` to ``high``, which saturates.

    Raises
    ------
    ArgumentError
        The value is no number.
    """
    if isinstance(value, Choice):
        return applied(lambda case: stored(case, low, high, fraction), value)
    word = Real.of(value, fraction).word
    return greatest(least(word, constant(high, fraction)), constant(low, fraction))
