"""Which functions take reals, and what they are replaced by in an author's scope and in NumPy's dispatch.

A replacement does to reals what it is for; of integers and floats alone it is the function itself, which
then computes constants.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pearl_marl.golden.reals.choices import Choice, applied, choice_of, select
from pearl_marl.golden.reals.numbers import NUMPY, Real
from pearl_marl.golden.reals.words import greatest, least
from pearl_marl.golden.rebinding import TypeLike
from pearl_marl.golden.tracing.words import OPERATORS, Word

FUNCTIONS: dict[Any, Callable[..., Any]] = {}
"""What takes the place of Python's and NumPy's functions where a golden function names them."""


def _replaced(original: Any, method: Callable[..., Any], of_integers: str = "float") -> None:
    """Let a function do what a method does, where a real is among its arguments.

    Of integers alone it makes floats, it is "itself" on words too, or they "stay".
    """

    @functools.wraps(original)
    def replacement(*arguments: Any, **keywords: Any) -> Any:
        values = _with_floats(arguments) if of_integers == "float" else arguments
        if any(isinstance(x, Choice) for x in values):
            return applied(replacement, *values)
        fractions = [x.fraction for x in values if isinstance(x, Real)]
        if fractions:
            return method(Real.of(values[0], fractions[0]), *values[1:], **keywords)
        if of_integers == "stay" and len(values) == 1 and isinstance(values[0], Word):
            return values[0]
        # Of a flag of Python's, NumPy makes a float of 16 bits.
        return original(*(int(x) if isinstance(x, bool) else x for x in arguments), **keywords)

    _register(original, replacement)


def _register(original: Any, replacement: Callable[..., Any]) -> None:
    FUNCTIONS[original] = replacement
    if getattr(original, "__module__", None) == "numpy" or isinstance(original, np.ufunc):
        NUMPY[original] = replacement


def _with_floats(values: Sequence[Any]) -> list[Any]:
    """Return integer words as all that they can be: where the reference has them, they become floats."""
    return [choice_of(x) if isinstance(x, Word) and x.graph.floats is not None else x for x in values]


def _extreme(original: Any, method: Callable[[Real, Any], Real], of_words: Callable[[Any, Any], Any]) -> None:
    """Let the least or greatest of numbers be that of reals, or of words, where one is among them."""

    @functools.wraps(original)
    def replacement(*arguments: Any, **keywords: Any) -> Any:
        alone = len(arguments) == 1 and isinstance(arguments[0], (list, tuple))
        values = arguments[0] if alone else arguments
        if keywords or not any(isinstance(x, (Real, Choice, Word)) for x in values):
            return original(*arguments, **keywords)
        return functools.reduce(one, values)

    def one(a: Any, b: Any) -> Any:
        fractions = [x.fraction for x in (a, b) if isinstance(x, Real)]
        if not fractions and any(isinstance(x, float) for x in (a, b)):
            a, b = _with_floats([a, b])
        if isinstance(a, Choice) or isinstance(b, Choice):
            return applied(one, a, b)
        if fractions:
            return method(Real.of(a, fractions[0]), b)
        return of_words(a, b) if isinstance(a, Word) or isinstance(b, Word) else original(a, b)

    _register(original, replacement)


def clip(value: Any, low: Any, high: Any) -> Any:
    """Return the nearest number from ``low`` to ``high``."""
    return FUNCTIONS[min](FUNCTIONS[max](value, low), high)


def _whole(function: Callable[[Real], Any]) -> Callable[[Real], Real]:
    """Return a function to integers as one to reals, which NumPy's are."""
    return lambda x: Real.of(function(x), x.fraction)


_FLOATS: dict[tuple[Any, ...], Callable[..., Any]] = {
    (math.sin, np.sin): Real.sin,
    (math.cos, np.cos): Real.cos,
    (math.sqrt, np.sqrt): Real.sqrt,
    (math.exp, np.exp): Real.exp,
    (math.tanh, np.tanh): Real.tanh,
    (math.hypot, np.hypot): lambda x, y: (x * x + y * y) ** 0.5,
    (math.fabs, np.fabs): abs,
    (float,): operator.pos,
    (math.pow,): operator.pow,
    (np.floor,): _whole(math.floor),
    (np.ceil,): _whole(math.ceil),
    (np.trunc,): _whole(math.trunc),
    (np.rint,): _whole(round),
}
for _names, _method in _FLOATS.items():
    for _name in _names:
        _replaced(_name, _method)
_replaced(np.abs, abs, "itself")
_replaced(np.power, operator.pow, "itself")
_replaced(np.square, lambda x: x * x, "itself")
_replaced(math.floor, math.floor, "stay")
_replaced(math.ceil, math.ceil, "stay")
_replaced(math.trunc, math.trunc, "stay")
_replaced(int, math.trunc, "stay")
_replaced(round, round, "stay")
_extreme(min, Real.minimum, least)
_extreme(np.minimum, Real.minimum, least)
_extreme(max, Real.maximum, greatest)
_extreme(np.maximum, Real.maximum, greatest)
_register(np.clip, clip)
_register(np.where, select)
NUMPY.update({getattr(np, name): function for name, function in OPERATORS.items()})
NUMPY.update({np.true_divide: operator.truediv, np.negative: operator.neg, np.positive: operator.pos})

BUILTINS: dict[str, Any] = {
    **{function.__name__: FUNCTIONS[function] for function in (min, max, round)},
    "int": TypeLike(int, FUNCTIONS[int]),
}
"""Of the functions, those that golden functions name without an import."""
