"""The arrays that a step's results are written into."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from pearl_marl.devices.batch import BatchConfig, BatchStep
from pearl_marl.slot_memory import ALIGNMENT, aligned_bytes

MAX_SETS = 8
"""How many sets are kept for use again. Whoever holds on to more gets fresh memory for them."""


class _Set:
    """One allocation and the five arrays in it; knows whether anybody else refers to them."""

    def __init__(self, config: BatchConfig) -> None:
        n, spec = config.n_envs, config.spec
        observation: tuple[tuple[int, ...], Any] = (n, *spec.observation_shape), spec.observation_dtype
        pieces = [observation, ((n,), np.float32), ((n,), np.bool_), ((n,), np.bool_), observation]
        lengths = [int(np.prod(shape)) * np.dtype(dtype).itemsize for shape, dtype in pieces]
        starts = np.cumsum([0] + [-(-length // ALIGNMENT) * ALIGNMENT for length in lengths])
        memory = aligned_bytes(int(starts[-1]))
        arrays = [
            memory[start : start + length].view(dtype).reshape(shape)
            for (shape, dtype), start, length in zip(pieces, starts.tolist(), lengths, strict=False)
        ]
        if config.autoreset_mode is AutoresetMode.NEXT_STEP:
            arrays[4] = arrays[0]  # the observation of an ending step is the final one
        self.arrays = BatchStep(*arrays)
        # NumPy lets a view of a view refer to what owns the memory, so the owner tells of all of them.
        self._owner = memory.base
        del memory, arrays
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
        self._config = config
        self._sets = [_Set(config)]

    def take(self) -> BatchStep:
        """Return arrays to write the next results into; their content is of no meaning."""
        if not self._config.copy:
            return self._sets[0].arrays
        for results in self._sets:
            if not results.shared():
                break
        else:
            results = _Set(self._config)
            if len(self._sets) < MAX_SETS:
                self._sets.append(results)
        return BatchStep(*results.arrays)
