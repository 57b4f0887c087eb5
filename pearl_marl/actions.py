"""Checking a batch of actions, and narrowing it to the device's width, in one pass."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Discrete

from pearl_marl.cache import compiled
from pearl_marl.errors import ActionError


def encode(actions: Any, space: Discrete, target: npt.NDArray[Any], first_slot: int = 0) -> npt.NDArray[Any]:
    """Return actions in the device's width; refuse them all if one is not in ``space``.

    Parameters
    ----------
    actions
        Integers of the shape of ``target``: an array, or what ``numpy.asarray`` makes one of.
    space
        A ``Discrete`` from 0.
    target
        Unsigned integers of shape ``(n,)``, wide enough for ``space``: where actions of another width
        go. After an error its content is of no meaning.
    first_slot
        The global number of the first slot, for the agents' names.

    Returns
    -------
    ``target``, or ``actions`` if they have its dtype already.

    Raises
    ------
    ActionError
        Names the first agent whose action is not in ``space``, and the action.
    """
    try:
        array = np.asarray(actions)
    except ValueError:  # a ragged list
        raise _refusal(actions, space, target, first_slot) from None
    if array.dtype is target.dtype and array.shape == target.shape and array.flags.carray:
        if _largest(array) >= space.n:
            raise _refusal(actions, space, target, first_slot)
        return array
    if not array.flags.behaved:  # read-only or unaligned: to Numba other types, and so another compilation
        array = array.copy()
    kind = array.dtype.kind
    if array.shape != target.shape or kind not in "iu":
        raise _refusal(actions, space, target, first_slot)
    if not array.dtype.isnative or not array.flags.c_contiguous:
        array = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    # Seen as unsigned, a negative number is a large one: one comparison does for both ends.
    unsigned = array.view(_UNSIGNED[array.itemsize]) if kind == "i" else array
    if _narrow(unsigned, target) >= space.n:
        raise _refusal(actions, space, target, first_slot)
    return target


def refuse_first(agents: Iterable[str], actions: Iterable[Any], space: Discrete) -> ActionError:
    """Return the error for actions that are not all in ``space``; it names the first that is not.

    Where all are, their dtype is what was wrong, and the first stands for it.
    """
    pairs = list(zip(agents, actions, strict=True))
    agent, action = next((pair for pair in pairs if why_not(pair[1], space)), pairs[0])
    why = why_not(action, space) or "is not of an integer dtype"
    return ActionError(f"{agent}: action {action!r} {why}; {_limits(space)}")


def why_not(action: Any, space: Discrete) -> str:
    """Return why one action is not in ``space``, in words; empty if it is."""
    if isinstance(action, (bool, np.bool_)) or not isinstance(action, (int, np.integer)):
        return "is no integer"
    return "" if 0 <= action < space.n else "is out of range"


def _limits(space: Discrete) -> str:
    return f"{space} takes integers from 0 to {space.n - 1}"


_UNSIGNED: dict[int, np.dtype[Any]] = {size: np.dtype(f"u{size}") for size in (1, 2, 4, 8)}


def _refusal(actions: Any, space: Discrete, target: npt.NDArray[Any], first_slot: int) -> ActionError:
    # What was given tells more than the array that NumPy made of it: [0, 1.5] becomes two floats.
    values = actions.tolist() if isinstance(actions, np.ndarray) else actions
    try:
        shape = np.shape(actions)
    except ValueError:  # a ragged list
        shape = (len(actions),)
    if shape != target.shape:
        wanted = f"{len(target)} agents take {target.shape}: {_limits(space)}"
        return ActionError(f"actions have shape {shape}; {wanted}")
    return refuse_first((f"agent_{first_slot + i}" for i in range(len(target))), values, space)


@compiled
def _largest(source: Any) -> Any:
    """Return the largest number."""
    largest = source.dtype.type(0)
    for i in range(source.size):
        largest = max(largest, source[i])
    return largest


@compiled
def _narrow(source: Any, target: Any) -> Any:
    """Copy into a narrower array; return the largest number seen."""
    largest = source.dtype.type(0)
    for i in range(source.size):
        largest = max(largest, source[i])
        target[i] = target.dtype.type(source[i])
    return np.uint64(largest)
