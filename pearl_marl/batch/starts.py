"""Fields of states that a reset is given, rather than draws: parameters of slots, or any others."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, Field


def checked_start(spec: EnvSpec, state: object, n: int) -> dict[str, npt.NDArray[Any]]:
    """Return the words of some fields, by name, each an array of shape ``(n,)`` in its field's dtype.

    Parameters
    ----------
    state
        A number for all slots or an array of shape ``(n,)``, by the names of fields. They are values: in a
        field with a fraction, ``word * 2**-fraction``, rounded to the nearest.

    Raises
    ------
    ArgumentError
        Names the field, the value and what is possible.
    """
    if not isinstance(state, Mapping):
        raise ArgumentError(f"state is {state!r}; it must be a dict of fields and their values")
    fields = {field.name: field for field in spec.state}
    for name in state:
        if name not in fields:
            near = difflib.get_close_matches(str(name), fields, n=1)
            hint = f", did you mean {near[0]!r}?" if near else ""
            raise ArgumentError(f"the state of {spec.name} has no {name!r}{hint} It has {', '.join(fields)}")
    return {name: _words(fields[name], values, n) for name, values in state.items()}


def _words(field: Field, values: Any, n: int) -> npt.NDArray[Any]:
    try:
        array = np.asarray(values)
        numbers = np.broadcast_to(array, (n,)) if array.dtype.kind in "biuf" else None
    except (TypeError, ValueError):
        numbers = None
    if numbers is None:
        raise ArgumentError(f"{field.name} is {values!r}; it must be a number, or {n:,} of them")
    if numbers.dtype.kind == "f" or field.fraction:
        numbers = np.rint(numbers.astype(np.float64) * 2.0**field.fraction)
    low, high = field.range
    wrong = ~((numbers >= low) & (numbers <= high))
    if wrong.any():
        at = int(wrong.argmax())
        value = np.broadcast_to(array, (n,))[at]
        raise ArgumentError(f"{field.name} of slot {at} is {value}; possible are {field.low} to {field.high}")
    if not field.fraction and array.dtype.kind == "f" and (numbers != array).any():
        raise ArgumentError(f"{field.name} is {values!r}; it takes integers")
    return numbers.astype(field.dtype)
