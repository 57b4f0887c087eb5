"""The arrays that a step's results are written into, in memory that is used again.

Fresh memory for 43,008 slots costs several times the step, because the system clears every page of it. So a
:class:`Recycler` uses memory again once nothing refers to an array in it, or to a view of one.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.slot_memory import ALIGNMENT, aligned_bytes, size
from pearl_marl.batch.step import BatchStep
from pearl_marl.errors import ArgumentError

MAX_BLOCKS = 12
"""How many blocks are kept. Where more results are held on to, fresh memory is taken."""

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
    """Makes arrays that are the user's to keep, out of memory that is no longer in use.

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


class ResultLayout:
    """Where the arrays of a step's results lie in one block of bytes, each from a cache line on.

    In NEXT_STEP mode the observation of an ending step is the final one, so those have no place of their own;
    but of an agent that ends before its world it is zeros.

    Attributes
    ----------
    shapes, dtypes
        Of each array, in the order of :attr:`BatchStep.arrays`.
    starts
        The first byte of each.
    size
        Bytes of them all, a multiple of :data:`ALIGNMENT`.
    """

    def __init__(self, config: BatchConfig) -> None:
        n, spec = config.n_agents, config.spec
        observation: tuple[tuple[int, ...], Any] = (n, *spec.observation_shape), spec.observation_dtype
        pieces = [observation, ((n,), np.float32), ((n,), np.bool_), ((n,), np.bool_), observation]
        self.masked = bool(spec.mask_fields)
        if self.masked:
            pieces.append(((n, len(spec.mask_fields)), np.int8))
        if spec.agents > 1:
            pieces.append(((n,), np.bool_))
        self.shapes = [shape for shape, _ in pieces]
        self.dtypes = [np.dtype(dtype) for _, dtype in pieces]
        self.starts, self.size = [0] * len(pieces), 0
        *before, final = (*range(4), *range(5, len(pieces)), 4)  # final observations come last
        shared = config.autoreset_mode is AutoresetMode.NEXT_STEP and spec.agents == 1
        for i in before if shared else (*before, final):
            self.starts[i] = self.size
            self.size += -(-math.prod(self.shapes[i]) * self.dtypes[i].itemsize // ALIGNMENT) * ALIGNMENT

    def pieces(self, memory: Any) -> list[Any]:
        """Return the part of a block, of whatever kind, that belongs to each array."""
        return [
            memory[start : start + math.prod(shape) * dtype.itemsize]
            for start, shape, dtype in zip(self.starts, self.shapes, self.dtypes, strict=True)
        ]

    def arrays(self, memory: Any, dtypes: Sequence[Any] | None = None) -> tuple[Any, ...]:
        """Return the arrays in a block of bytes: tensors, where ``dtypes`` are torch's."""
        parts = zip(self.pieces(memory), dtypes or self.dtypes, self.shapes, strict=True)
        arrays = [piece.view(dtype).reshape(shape) for piece, dtype, shape in parts]
        if self.starts[4] == self.starts[0]:
            arrays[4] = arrays[0]
        return tuple(arrays)

    def step(self, arrays: Sequence[Any]) -> BatchStep:
        """Return the results in such arrays."""
        return BatchStep(*arrays) if len(arrays) == 5 else BatchStep.of(arrays, self.masked)


def memory_of_machine() -> int:
    """Return how many bytes of memory this machine has."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def check_memory(config: BatchConfig, more: int = 0) -> None:
    """Refuse a batch that this machine has not the memory for, before any is taken.

    That is what its slots and results take, and ``more`` bytes for each agent that the caller takes besides.
    """
    n = config.n_agents
    needed = size(config.spec, config.n_envs) + ResultLayout(config).size + n * more
    there = memory_of_machine()
    if needed > there:
        raise ArgumentError(
            f"{n:,} agents of {config.spec.name} take at least {needed / 2**30:,.1f} GiB of memory, and this "
            f"machine has {there / 2**30:,.1f} GiB: {there * n // needed:,} agents at most"
        )


class ResultArrays:
    """Hands out arrays for results: new ones with ``config.copy``, else the same in every step.

    The array objects stay in every block of memory, so that a step makes no new views.
    """

    def __init__(self, config: BatchConfig) -> None:
        check_memory(config)
        self.layout = ResultLayout(config)
        self._new = Recycler(self.layout.arrays)
        # Without copies: the one block, and the arrays that every step writes over.
        self._block = None if config.copy else self._new.block(self.layout.size)
        self._same = None if self._block is None else self.layout.step(self._block.arrays)

    def take(self) -> BatchStep:
        """Return arrays to write the next results into; their content is of no meaning."""
        return self.take_block()[0]

    def take_block(self) -> tuple[BatchStep, Block]:
        """Do the same; return also the block that the :attr:`BatchStep.arrays` lie in."""
        block = self._block or self._new.block(self.layout.size)
        return self._same or self.layout.step(block.arrays), block
