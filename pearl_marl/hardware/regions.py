"""Whole regions of the Comm-BRAM: from a column of values a field to the bytes of a region, and back.

For regions that are moved now and then. The regions of every step are packed in place, by
:mod:`pearl_marl.hardware.codec` alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.hardware.codec import Stream, pack, stream_bytes, unpack
from pearl_marl.memory_map import MemoryMap, Region
from pearl_marl.spec import Field

Columns = Sequence[npt.NDArray[Any]]


def pack_region(layout: MemoryMap, region: Region, fields: Sequence[Field], columns: Columns) -> Stream:
    """Return the bytes of a region whose slots hold ``columns``, one for each field."""
    data = np.zeros(layout.size(region.name), np.uint8)
    for slots, row, stream in _rows(layout, region, data):
        offset = 0
        for field, column in zip(fields, columns, strict=True):
            pack(column[slots], field.bits, stream, region.slot_bits, offset)
            offset += field.bits
        row[:] = stream[: row.size]
    return data


def unpack_region(
    layout: MemoryMap, region: Region, data: Stream, fields: Sequence[Field], columns: Columns
) -> None:
    """Fill ``columns``, each in its field's dtype; the inverse of :func:`pack_region`."""
    for slots, row, stream in _rows(layout, region, data):
        stream[: row.size] = row
        offset = 0
        for field, column in zip(fields, columns, strict=True):
            unpack(stream, field.bits, column[slots], region.slot_bits, offset)
            offset += field.bits


def _rows(layout: MemoryMap, region: Region, data: Stream) -> Iterator[tuple[slice, Stream, Stream]]:
    """Yield the slots of each row, its bytes in ``data``, and a stream with room for both."""
    rows, slots = region.rows, region.row_slots
    row_bytes = region.row_words * layout.data_wl // 8
    if slots * region.slot_bits == 8 * row_bytes:  # no padding between rows: they are one
        rows, slots, row_bytes = 1, rows * slots, rows * row_bytes
    for row in range(rows):
        start = row * slots
        stop = min(start + slots, layout.n_envs)
        stream = np.zeros(max(stream_bytes(slots, region.slot_bits), row_bytes + -row_bytes % 8), np.uint8)
        yield slice(start, stop), data[row * row_bytes : (row + 1) * row_bytes], stream
