"""Memory for results that is used again once nobody refers to what was in it."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import numpy.typing as npt

MAX_BLOCKS = 12
"""How many blocks are kept. Whoever holds on to more results gets fresh memory for them."""


class _Block:
    def __init__(self, size: int) -> None:
        self.memory = np.empty(size, np.uint8)
        self._references_unshared = sys.getrefcount(self.memory)

    def shared(self) -> bool:
        """Return whether anybody refers to a view of the memory, or to a view of a view."""
        return sys.getrefcount(self.memory) != self._references_unshared


class Recycler:
    """Makes arrays that are the user's to keep, out of memory that nobody keeps.

    As :class:`pearl_marl.batch.results.ResultArrays`, for arrays of a few large shapes: the system clears
    every page of fresh memory, which for a step's observations takes longer than to compute them.
    """

    def __init__(self) -> None:
        self._blocks: list[_Block] = []

    def empty(self, shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        """Return an array as ``numpy.empty`` does."""
        dtype = np.dtype(dtype)
        size = math.prod(shape) * dtype.itemsize
        for block in self._blocks:
            if block.memory.size == size and not block.shared():
                break
        else:
            block = _Block(size)
            self._blocks = [*self._blocks[1 - MAX_BLOCKS :], block]
        return block.memory.view(dtype).reshape(shape)

    def copy(self, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return a copy of an array."""
        out = self.empty(array.shape, array.dtype)
        out[...] = array
        return out

    def __reduce__(self) -> tuple[Any, ...]:
        return Recycler, ()
