"""Memory for results that is used again once nobody refers to an array in it, or to a view of one.

Fresh memory for 43,008 slots costs several times the step, because the system clears every page of it.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.batch.slot_memory import aligned_bytes

MAX_BLOCKS = 12
"""How many blocks are kept. Whoever holds on to more results gets fresh memory for them."""

Arrays = tuple[npt.NDArray[Any], ...]
Carve = Callable[[npt.NDArray[np.uint8]], Arrays]


class Block:
    """One allocation and the arrays that stay in it; knows whether anybody else refers to them.

    Attributes
    ----------
    memory
        Its bytes, from a cache line on.
    arrays
        What ``carve`` made of them. To hold on to one of them is to refer to it, not only to this tuple.
    addresses
        Of each array, ``int64``.
    """

    def __init__(self, size: int, carve: Carve | None) -> None:
        self.memory = aligned_bytes(size)
        self.arrays = carve(self.memory) if carve else ()
        self.addresses = np.array([array.ctypes.data for array in self.arrays], np.int64)
        # NumPy lets a view of a view refer to what owns the memory, so the owner tells of all of them.
        self._watched = [self.memory.base, *self.arrays]
        self._unshared = list(map(sys.getrefcount, self._watched))

    def shared(self) -> bool:
        """Return whether anybody outside refers to one of the arrays, or to a view of the memory."""
        return list(map(sys.getrefcount, self._watched)) != self._unshared


class Recycler:
    """Makes arrays that are the user's to keep, out of memory that nobody keeps.

    ``carve`` makes of a new block's bytes the arrays that are to stay in it, if any are. Copies and pickles
    are empty: no two of them ever hand out the same memory.
    """

    def __init__(self, carve: Carve | None = None) -> None:
        self._carve = carve
        self._blocks: list[Block] = []

    def block(self, size: int) -> Block:
        """Return a block of that many bytes; their content is of no meaning."""
        for block in self._blocks:
            if block.memory.size == size and not block.shared():
                return block
        block = Block(size, self._carve)
        self._blocks = [*self._blocks[1 - MAX_BLOCKS :], block]
        return block

    def empty(self, shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        """Return an array as ``numpy.empty`` does."""
        dtype = np.dtype(dtype)
        memory = self.block(math.prod(shape) * dtype.itemsize).memory
        return memory.view(dtype).reshape(shape)

    def copy(self, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return a copy of an array."""
        out = self.empty(array.shape, array.dtype)
        out[...] = array
        return out

    def __reduce__(self) -> tuple[Any, ...]:
        return Recycler, (self._carve,)
