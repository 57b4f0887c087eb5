"""Where the slots of a batch live on the host: one byte array, each field a column of it.

A saved state holds these bytes as they are, whatever device made them, so this layout is also
what lets one device continue where another stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.spec import EnvSpec

ALIGNMENT = 64
"""Bytes of a cache line. Slots are padded to a multiple, so that every column starts on one."""


class Column(NamedTuple):
    """One column: its name and dtype, and the bytes a slot has in the columns before it."""

    name: str
    dtype: np.dtype[Any]
    bytes_before: int


def columns(spec: EnvSpec) -> tuple[Column, ...]:
    """Return the columns of a slot: its state fields by their names, its elapsed steps, whether it ended.

    ``elapsed`` counts the steps of the episode, and stays 0 where there is no time limit.
    ``ended`` is 1 for a slot that will spend its next step resetting (NEXT_STEP mode only).
    """
    names = [(f.name, f.dtype) for f in spec.state]
    names += [("elapsed", np.dtype(np.uint32)), ("ended", np.dtype(np.uint8))]
    result, offset = [], 0
    for name, dtype in names:
        result.append(Column(name, dtype, offset))
        offset += dtype.itemsize
    return tuple(result)


def allocate(spec: EnvSpec, n: int) -> npt.NDArray[np.uint8]:
    """Return zeroed memory for ``n`` slots, aligned."""
    return aligned_bytes(size(spec, n))


def size(spec: EnvSpec, n: int) -> int:
    """Return the bytes that ``n`` slots take."""
    last = columns(spec)[-1]
    padded = -(-n // ALIGNMENT) * ALIGNMENT
    return padded * (last.bytes_before + last.dtype.itemsize)


def aligned_bytes(count: int) -> npt.NDArray[np.uint8]:
    """Return zeroed bytes that begin on a cache line: stores that straddle two cost a kernel 15 %."""
    whole = np.zeros(count + ALIGNMENT, np.uint8)
    start = -whole.ctypes.data % ALIGNMENT
    return whole[start : start + count]


def views(spec: EnvSpec, n: int, memory: npt.NDArray[np.uint8]) -> dict[str, npt.NDArray[Any]]:
    """Return each column of ``memory`` as an array of shape ``(n,)`` that shares its bytes."""
    padded = -(-n // ALIGNMENT) * ALIGNMENT
    return {
        c.name: memory[padded * c.bytes_before : padded * (c.bytes_before + c.dtype.itemsize)].view(c.dtype)[
            :n
        ]
        for c in columns(spec)
    }


def state_dtype(spec: EnvSpec) -> np.dtype[Any]:
    """Return the dtype in which all of a slot's state fields can be shown as values."""
    if any(f.fraction for f in spec.state):
        return np.dtype(np.float64)
    return np.result_type(*(f.dtype for f in spec.state))


def state_values(spec: EnvSpec, n: int, memory: npt.NDArray[np.uint8]) -> npt.NDArray[Any]:
    """Return the values of the slots' state fields, shape ``(n, fields)``, in :func:`state_dtype`."""
    columns_by_name = views(spec, n, memory)
    values = np.empty((n, len(spec.state)), state_dtype(spec))
    for i, f in enumerate(spec.state):
        values[:, i] = columns_by_name[f.name]
        if f.fraction:
            values[:, i] *= 2.0**-f.fraction
    return values


def join(
    spec: EnvSpec, shares: Sequence[npt.NDArray[np.uint8]], sizes: Sequence[int]
) -> npt.NDArray[np.uint8]:
    """Return one memory of the slots of all shares, in their order; an empty one of empty ones."""
    if not shares[0].size:
        return shares[0]
    n = sum(sizes)
    memory = allocate(spec, n)
    whole, first = views(spec, n, memory), 0
    for share, count in zip(shares, sizes, strict=True):
        for name, values in views(spec, count, share).items():
            whole[name][first : first + count] = values
        first += count
    return memory


def cut(spec: EnvSpec, n: int, memory: npt.NDArray[np.uint8], slots: slice) -> npt.NDArray[np.uint8]:
    """Return the memory of some of the ``n`` slots; an empty one of an empty one."""
    if not memory.size:
        return memory
    size = slots.stop - slots.start
    share = allocate(spec, size)
    whole = views(spec, n, memory)
    for name, values in views(spec, size, share).items():
        values[:] = whole[name][slots]
    return share
