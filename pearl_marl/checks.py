"""How arguments are checked: each message names the argument, its value and what is possible."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, TypeGuard, TypeVar

from pearl_marl.errors import ArgumentError, brief

T = TypeVar("T")

MANY = 10**12
"""The limit of counts that have no other one: more would never end."""


def is_number(value: object, infinite: bool = False) -> TypeGuard[float]:
    """Return whether a value is a real number that a float holds; with ``infinite``, also an infinite one."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        number = float(value)
    except OverflowError:
        return False
    return math.isfinite(number) or (infinite and math.isinf(number))


@dataclass(frozen=True, kw_only=True)
class NumberRange:
    """A range of finite numbers, or of integers if ``whole``; ``value in range`` tells and ``str()`` says it.

    ``least`` and ``most`` belong to it themselves, ``above`` and ``below`` do not.
    """

    least: float = -math.inf
    most: float = math.inf
    above: float = -math.inf
    below: float = math.inf
    whole: bool = False

    def __contains__(self, value: object) -> bool:
        if self.whole:
            right = isinstance(value, Integral) and not isinstance(value, bool)
        else:
            right = is_number(value)
        number: Any = value
        return right and self.least <= number <= self.most and self.above < number < self.below

    def __str__(self) -> str:
        kind = "an integer" if self.whole else "a number"
        if self.least == self.above == -math.inf and self.most == self.below == math.inf:
            return kind if self.whole else "a finite number"
        if self.most == self.below == math.inf:
            return (
                f"{kind} of at least {self.least:,}"
                if self.above < self.least
                else f"{kind} above {self.above:,}"
            )
        low = f"from {self.least:,}" if self.above < self.least else f"above {self.above:,}"
        high = f"to {self.most:,}" if self.most < self.below else f"to below {self.below:,}"
        return f"{kind} {low} {high}"


def checked_integer(name: str, value: Any, least: int = 1, most: float = math.inf, note: str = "") -> int:
    """Return an argument that has to be an integer of a range, of Python or NumPy, as an ``int``.

    ``note`` goes on after what is possible, as ``" or None"`` or ``"; 0 is no limit"`` do.
    """
    return int(_inside(NumberRange(least=least, most=most, whole=True), name, value, note))


def checked_count_or_none(name: str, value: Any) -> int | None:
    """Return an argument that has to be a positive integer or ``None``."""
    return None if value is None else checked_integer(name, value, note=" or None")


def checked_number(
    name: str,
    value: Any,
    least: float = -math.inf,
    most: float = math.inf,
    *,
    above: float = -math.inf,
    below: float = math.inf,
) -> float:
    """Return an argument that has to be a finite number of a range as a ``float``."""
    return float(_inside(NumberRange(least=least, most=most, above=above, below=below), name, value))


def _inside(possible: NumberRange, name: str, value: Any, note: str = "") -> Any:
    if value not in possible:
        raise ArgumentError(f"{name} is {brief(value)}; it must be {possible}{note}")
    return value


def checked_choice(name: str, value: T, choices: Collection[T], note: str = "") -> T:
    """Return an argument that has to be one of some values."""
    for one in choices:  # an array would compare element by element, and True equals 1
        if isinstance(value, type(one)) and isinstance(value, bool) is isinstance(one, bool) and value == one:
            return value
    *others, last = map(repr, choices)
    listed = f"{', '.join(others)} and {last}" if others else last
    raise ArgumentError(f"{name} is {brief(value)}; possible are {listed}{note}")


def checked_flag(name: str, value: Any) -> bool:
    """Return an argument that has to be ``True`` or ``False``."""
    if not isinstance(value, bool):
        raise ArgumentError(f"{name} is {brief(value)}; it must be True or False")
    return value


def checked_function(name: str, value: T) -> T:
    """Return an argument that has to be a function; a wrong one would fail late, at the first call."""
    if not callable(value):
        raise ArgumentError(f"{name} is {brief(value)}; it must be a function")
    return value
