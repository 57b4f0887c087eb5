"""Where the slots of a batch live on the host: one byte array, each field a column of it.

A saved state holds these bytes as they are, so this layout lets one device continue where another stopped.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.base.arrays import Array
from pearl_marl.spec import MAX_CYCLES, EnvSpec, Field

Bytes = npt.NDArray[np.uint8]

ALIGNMENT = 64
"""Bytes of a cache line. Slots are padded to a multiple, so that every column starts on one."""


class Column(NamedTuple):
    """One column: its name and dtype, and the bytes a slot has in the columns before it."""

    name: str
    dtype: np.dtype[Any]
    bytes_before: int


def columns(spec: EnvSpec) -> tuple[Column, ...]:
    """Return the columns of a slot: its state fields, its elapsed steps, and whether it ended.

    ``elapsed`` counts the steps of the episode, and stays 0 where there is no time limit.
    ``ended`` is 1 for a slot that will spend its next step resetting (NEXT_STEP mode only). In a world of
    several agents, bit ``1 + k`` is set where agent ``k`` has ended and the world goes on.
    """
    names = [(f.name, f.dtype) for f in spec.state]
    names += [("elapsed", np.dtype(np.uint32)), ("ended", Field("ended", spec.agents + 1).dtype)]
    result, offset = [], 0
    for name, dtype in names:
        result.append(Column(name, dtype, offset))
        offset += dtype.itemsize
    return tuple(result)


def padded(n: int) -> int:
    """Return how many slots a column has room for, where ``n`` are used."""
    return -(-n // ALIGNMENT) * ALIGNMENT


def size(spec: EnvSpec, n: int) -> int:
    """Return the bytes that ``n`` slots take."""
    last = columns(spec)[-1]
    return padded(n) * (last.bytes_before + last.dtype.itemsize)


def aligned_bytes(count: int) -> Bytes:
    """Return zeroed bytes that begin on a cache line: stores that straddle two cost a kernel 15 %."""
    whole = np.zeros(count + ALIGNMENT, np.uint8)
    start = -whole.ctypes.data % ALIGNMENT
    return whole[start : start + count]


def counter_dtype(most: int) -> np.dtype[Any]:
    """Return the narrowest dtype that counts to ``most``, for a device whose steps go through all of them."""
    return np.min_scalar_type(min(most, MAX_CYCLES))


def state_dtype(spec: EnvSpec) -> np.dtype[Any]:
    """Return the dtype in which all of a slot's state fields can be shown as values."""
    if any(f.fraction for f in spec.state):
        return np.dtype(np.float64)
    return np.result_type(*(f.dtype for f in spec.state))


class SlotMemory:
    """The slots of a batch: ``bytes`` holds all columns, one after the other.

    They are those of ``data``, which are shared, or new ones, all zero.
    """

    def __init__(self, spec: EnvSpec, n: int, data: Bytes | None = None) -> None:
        self.spec, self.n = spec, n
        self.bytes = aligned_bytes(size(spec, n)) if data is None else data

    @cached_property
    def columns(self) -> dict[str, Array]:
        """Every column by its name, as an array of shape ``(n,)`` that shares the bytes."""
        p = padded(self.n)
        return {
            name: self.bytes[p * before : p * (before + dtype.itemsize)].view(dtype)[: self.n]
            for name, dtype, before in columns(self.spec)
        }

    @property
    def state(self) -> list[Array]:
        """The columns of the state fields, in the order of the spec."""
        return list(self.columns.values())[: len(self.spec.state)]

    @property
    def elapsed(self) -> Array:
        """The steps of each slot's episode so far."""
        return self.columns["elapsed"]

    @property
    def ended(self) -> Array:
        """Which slots spend their next step resetting, and which agents have ended: see :func:`columns`."""
        return self.columns["ended"]

    @property
    def ended_early(self) -> npt.NDArray[np.bool_]:
        """Which agents have ended before their world, shape ``(n, agents)``."""
        bits = np.arange(1, 1 + self.spec.agents, dtype=self.ended.dtype)
        ended: npt.NDArray[np.bool_] = (self.ended[:, None] >> bits & 1).astype(np.bool_)
        return ended

    def values(self) -> Array:
        """Return the values of the state fields, shape ``(n, fields)``, in :func:`state_dtype`."""
        values = np.empty((self.n, len(self.spec.state)), state_dtype(self.spec))
        for i, (f, column) in enumerate(zip(self.spec.state, self.state, strict=True)):
            values[:, i] = column
            if f.fraction:
                values[:, i] *= 2.0**-f.fraction
        return values
