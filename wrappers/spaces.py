"""What wrappers ask of spaces."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space

from pearl_marl.errors import ArgumentError


def box(space: Space[Any], name: str) -> Box:
    """Return a space that has to be a ``Box``, or refuse it for the wrapper called ``name``."""
    if not isinstance(space, Box):
        raise ArgumentError(f"{name} takes observations in a Box, not {space}")
    return space


def with_zeros(space: Space[Any]) -> Space[Any]:
    """Return the space itself, or if zeros are beyond its bounds, one that they are within."""
    if not isinstance(space, Box) or ((space.low <= 0) & (space.high >= 0)).all():
        return space
    return Box(np.minimum(space.low, 0), np.maximum(space.high, 0), dtype=space.dtype.type)
