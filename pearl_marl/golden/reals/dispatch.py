"""What NumPy's functions do where an argument is a number of golden functions that is no integer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.tracing.words import Beyond

NUMPY: dict[Any, Callable[..., Any]] = {}
"""What takes the place of a function of NumPy's; :mod:`pearl_marl.golden.reals.names` fills it."""


class Number(Beyond):
    """A number that NumPy's functions take."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]
    __array_priority__ = 2000

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **keywords: Any) -> Any:
        if method != "__call__":
            raise ArgumentError(f"golden functions have no np.{ufunc.__name__}.{method}")
        return _called(ufunc, inputs, keywords)

    def __array_function__(self, function: Any, types: Any, args: Any, keywords: Any) -> Any:
        return _called(function, args, keywords)


def _called(function: Any, arguments: Any, keywords: Any) -> Any:
    if function not in NUMPY or keywords:
        raise ArgumentError(f"golden functions have no np.{function.__name__} of reals")
    # The operators of NumPy's numbers would come back here.
    return NUMPY[function](*(x.item() if isinstance(x, (np.generic, np.ndarray)) else x for x in arguments))
