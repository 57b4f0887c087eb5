"""Checking a batch of actions, and narrowing it to the device's width, in one pass."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Discrete
from numba import njit

from pearl_marl.errors import ActionError


def encode(actions: Any, space: Discrete, target: npt.NDArray[Any], first_slot: int = 0) -> None:
    """Write actions into ``target`` in the device's width; refuse them all if one is not in ``space``.

    Parameters
    ----------
    actions
        Integers of the shape of ``target``: an array, or what ``numpy.asarray`` makes one of.
    space
        A ``Discrete`` from 0.
    target
        Unsigned integers of shape ``(n,)``, wide enough for ``space``. After an error its
        content is of no meaning.
    first_slot
        The global number of the first slot, for the agents' names.

    Raises
    ------
    ActionError
        Names the first agent whose action is not in ``space``, and the action.
    """
    array = np.asarray(actions)
    kind = array.dtype.kind
    if array.shape != target.shape or kind not in "iu":
        raise _refusal(array, space, target, first_slot)
    if not array.dtype.isnative or not array.flags.c_contiguous:
        array = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    # Seen as unsigned, a negative number is a large one: one comparison does for both ends.
    unsigned = array.view(_UNSIGNED[array.itemsize]) if kind == "i" else array
    if _narrow(unsigned, target) >= space.n:
        raise _refusal(array, space, target, first_slot)


_UNSIGNED: dict[int, np.dtype[Any]] = {size: np.dtype(f"u{size}") for size in (1, 2, 4, 8)}


def _refusal(
    array: npt.NDArray[Any], space: Discrete, target: npt.NDArray[Any], first_slot: int
) -> ActionError:
    limits = f"{space} takes integers from 0 to {space.n - 1}"
    if array.shape != target.shape:
        return ActionError(
            f"actions have shape {array.shape}; {len(target)} agents take {target.shape}: {limits}"
        )
    if array.dtype.kind in "iu":
        first = int(np.flatnonzero((array < 0) | (array >= space.n))[0])
        return ActionError(f"agent_{first_slot + first}: action {array[first]} is out of range; {limits}")
    values = array.tolist()
    first = next((i for i, a in enumerate(values) if not isinstance(a, (int, np.integer))), 0)
    return ActionError(
        f"agent_{first_slot + first}: action {values[first]!r} is no integer (dtype {array.dtype}); {limits}"
    )


@njit(cache=True, nogil=True)
def _narrow(source: Any, target: Any) -> Any:
    """Copy into a narrower array; return the largest number seen."""
    largest = source.dtype.type(0)
    for i in range(source.size):
        largest = max(largest, source[i])
        target[i] = target.dtype.type(source[i])
    return np.uint64(largest)
