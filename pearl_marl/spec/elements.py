"""What the elements of a space can be: those of an action, and of an observation that is made of numbers."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete, Space, Tuple

ActionSpace: TypeAlias = Discrete | MultiDiscrete | MultiBinary | Box
"""What the action of an agent may be in."""


def action_counts(space: Space[Any]) -> tuple[int, ...]:
    """Return how many values each element of an action has, from 0; nothing of a space of other actions.

    Of one dimension at most, they are those of a ``Discrete``, ``MultiDiscrete`` or ``MultiBinary``.
    """
    if not isinstance(space, (Discrete, MultiDiscrete, MultiBinary)):
        return ()
    low, high = bounds(space)
    return () if low.ndim > 1 or low.any() else tuple((high + 1).ravel().tolist())


def bounds(space: Space[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the least and the greatest value of each element of a space, as arrays of its shape.

    That of a ``Tuple`` of ``Discrete`` spaces is ``(parts,)``. A TypeError says that a space has no such.
    """
    if isinstance(space, Box):
        return space.low, space.high
    if isinstance(space, MultiBinary):
        return np.zeros(space.shape, space.dtype), np.ones(space.shape, space.dtype)
    if isinstance(space, MultiDiscrete):
        return space.start, space.start + space.nvec - 1
    if isinstance(space, Discrete):
        return np.array(space.start), np.array(space.start + space.n - 1)
    if isinstance(space, Tuple):
        low, high = zip(*map(bounds, space.spaces), strict=True)
        return np.stack(low), np.stack(high)
    raise TypeError(f"{space} has no numbers for elements")


def are_numbers(space: Space[Any]) -> bool:
    """Return whether observations are numbers of which there are so many: their elements tell cases apart."""
    parts = space.spaces if isinstance(space, Tuple) else (space,)
    return isinstance(space, (MultiDiscrete, MultiBinary)) or all(isinstance(p, Discrete) for p in parts)
