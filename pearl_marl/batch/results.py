"""The arrays that a step's results are written into."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.slot_memory import ALIGNMENT, aligned_bytes
from pearl_marl.batch.step import BatchStep

MAX_SETS = 8
"""How many sets are kept for use again. Whoever holds on to more gets fresh memory for them."""


class Layout:
    """Where the five arrays of a step's results lie in one block of bytes, each from a cache line on.

    Parameters
    ----------
    config
        Says the shapes, and whether final observations have a place of their own: in NEXT_STEP mode the
        observation of an ending step is the final one.

    Attributes
    ----------
    shapes, dtypes
        Of each array, in the order of :class:`BatchStep`.
    starts
        The first byte of each.
    size
        Bytes of them all, a multiple of :data:`ALIGNMENT`.
    """

    def __init__(self, config: BatchConfig) -> None:
        n, spec = config.n_envs, config.spec
        observation: tuple[tuple[int, ...], Any] = (n, *spec.observation_shape), spec.observation_dtype
        pieces = [observation, ((n,), np.float32), ((n,), np.bool_), ((n,), np.bool_), observation]
        self.shapes = [shape for shape, _ in pieces]
        self.dtypes = [np.dtype(dtype) for _, dtype in pieces]
        self.starts, self.size = [], 0
        for shape, dtype in zip(self.shapes, self.dtypes, strict=True):
            self.starts.append(self.size)
            self.size += -(-math.prod(shape) * dtype.itemsize // ALIGNMENT) * ALIGNMENT
        if config.autoreset_mode is AutoresetMode.NEXT_STEP:
            self.starts[4], self.size = self.starts[0], self.starts[4]

    def pieces(self, memory: Any) -> list[Any]:
        """Return the part of a block, of whatever kind, that belongs to each array."""
        return [
            memory[start : start + math.prod(shape) * dtype.itemsize]
            for start, shape, dtype in zip(self.starts, self.shapes, self.dtypes, strict=True)
        ]


class _Set:
    """One allocation and the five arrays in it; knows whether anybody else refers to them."""

    def __init__(self, layout: Layout) -> None:
        self.memory = aligned_bytes(layout.size)
        parts = zip(layout.pieces(self.memory), layout.dtypes, layout.shapes, strict=True)
        arrays = [piece.view(dtype).reshape(shape) for piece, dtype, shape in parts]
        if layout.starts[4] == layout.starts[0]:
            arrays[4] = arrays[0]
        self.arrays = BatchStep(*arrays)
        # NumPy lets a view of a view refer to what owns the memory, so the owner tells of all of them.
        self._owner = self.memory.base
        del arrays, parts
        self._references_unshared = self._references()

    def _references(self) -> tuple[int, ...]:
        return (sys.getrefcount(self._owner), *map(sys.getrefcount, self.arrays))

    def shared(self) -> bool:
        """Return whether anybody outside refers to one of the arrays or to a view of one."""
        return self._references() != self._references_unshared


class ResultArrays:
    """Hands out arrays for results: the same ones every time, or ones that nobody else refers to.

    Fresh memory for 43,008 slots costs several times the step, because the system clears every
    page of it. So where results are the user's to keep, a set of arrays is used again, but only
    once neither the arrays nor any view of them is referred to outside.

    Parameters
    ----------
    config
        Says the shapes, and with ``copy`` which of the two it is.
    """

    def __init__(self, config: BatchConfig) -> None:
        self.layout = Layout(config)
        self._copy = config.copy
        self._sets = [_Set(self.layout)]

    def take(self) -> BatchStep:
        """Return arrays to write the next results into; their content is of no meaning."""
        results = self._next()
        return BatchStep(*results.arrays) if self._copy else results.arrays

    def take_block(self) -> tuple[npt.NDArray[np.uint8], BatchStep]:
        """Do the same; return also the bytes that the arrays lie in, as :attr:`layout` has them."""
        results = self._next()
        return results.memory, BatchStep(*results.arrays) if self._copy else results.arrays

    def _next(self) -> _Set:
        if not self._copy:
            return self._sets[0]
        for results in self._sets:
            if not results.shared():
                break
        else:
            results = _Set(self.layout)
            if len(self._sets) < MAX_SETS:
                self._sets.append(results)
        return results
