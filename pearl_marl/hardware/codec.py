"""Bit packing: from arrays of integers to the bit streams of the Comm-BRAM and back.

A stream is a ``uint8`` array in which value ``i`` owns the ``bits`` bits from ``i * stride +
offset`` on, least significant first. A word of several fields is one :func:`pack` per field into
the same stream, each with its own offset. The length of a stream is a multiple of 8 bytes
(:func:`stream_bytes`), so that the kernels move whole 64-bit words.

The regions of every step are packed in place; :func:`pack_region` makes whole ones, moved now and then.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.base.machine_code import compiled
from pearl_marl.memory_map import MemoryMap, Region
from pearl_marl.spec import Field

Stream = npt.NDArray[np.uint8]
Columns = Sequence[npt.NDArray[Any]]


def stream_bytes(count: int, stride: int) -> int:
    """Return the bytes of a stream of ``count`` values, ``stride`` bits apart."""
    return -(-count * stride // 64) * 8


def pack(values: npt.NDArray[Any], bits: int, stream: Stream, stride: int, offset: int = 0) -> None:
    """Write the low ``bits`` bits of each value into its place in the stream; other bits stay.

    ``values`` are integers of shape ``(n,)``, whose higher bits (as of negative numbers) are cut off. They
    are ``bits`` wide, 1 to 64, from bit ``offset`` of each ``stride`` on. ``stream`` is at least
    :func:`stream_bytes` long.
    """
    _check(len(values), bits, stream, stride, offset)
    done = _fast_part(len(values), bits, stride)
    if done:
        _narrow_kernels(bits)[0](np.asarray(values[:done], np.uint16 if bits > 8 else np.uint8), stream)
    if bits in (8, 16, 32, 64) and stride % bits == 0 and offset % bits == 0:
        _places(stream, f"<u{bits // 8}", stride, offset)[: len(values)] = values
    elif done < len(values):
        words = stream.view(np.uint64)[done * stride // 64 :]
        _pack_any(values[done:], bits, words, stride, offset)


def unpack(stream: Stream, bits: int, out: npt.NDArray[Any], stride: int, offset: int = 0) -> None:
    """Read a value from each place of the stream; the inverse of :func:`pack`.

    A signed ``out`` extends the sign of the ``bits``-wide value.
    """
    _check(len(out), bits, stream, stride, offset)
    signed = out.dtype.kind == "i"
    done = 0 if signed else _fast_part(len(out), bits, stride)
    if done:
        _narrow_kernels(bits)[1](stream, out[:done])
    if bits in (8, 16, 32, 64) and stride % bits == 0 and offset % bits == 0:
        out[:] = _places(stream, f"<{out.dtype.kind}{bits // 8}", stride, offset)[: len(out)]
    elif done < len(out):
        words = stream.view(np.uint64)[done * stride // 64 :]
        _unpack_any(words, bits, out[done:], stride, offset, signed)


def _check(count: int, bits: int, stream: Stream, stride: int, offset: int) -> None:
    if not 1 <= bits <= 64 or offset < 0 or offset + bits > stride:
        raise ValueError(f"{bits} bits at offset {offset} do not fit a stride of {stride}")
    if len(stream) % 8 or len(stream) < stream_bytes(count, stride):
        raise ValueError(f"a stream of {len(stream)} bytes does not hold {count} strides of {stride} bits")


def _places(stream: Stream, dtype: str, stride: int, offset: int) -> npt.NDArray[Any]:
    """Return the stream's places as an array, where each is a whole number of bytes."""
    bits = 8 * np.dtype(dtype).itemsize
    return stream.view(dtype)[offset // bits :: stride // bits]


NARROW_BITS = 15
"""Up to this width, values without gaps have kernels of their own,"""

MANY = 512
"""from so many values on: a kernel takes half a second to compile, once."""


def _fast_part(count: int, bits: int, stride: int) -> int:
    """Return how many of the values go through :func:`_narrow_kernels`: whole 64-bit words of them."""
    return count // 64 * 64 if count >= MANY and bits == stride != 8 and bits <= NARROW_BITS else 0


@functools.cache
def _narrow_kernels(bits: int) -> tuple[Callable[..., None], Callable[..., None]]:
    # Eight values are `bits` bytes. As that is a constant, LLVM unrolls the inner loops, drops every
    # `if` in them, and turns the outer one into SIMD code: fifteen times as fast as _unpack_any.
    mask = np.uint32((1 << bits) - 1)

    @compiled
    def pack_narrow(values: Any, stream: Any) -> None:
        for i in range(len(values) // 8):
            for k in range(bits):
                byte = np.uint32(0)
                for j in range(8):
                    shift = j * bits - k * 8
                    if -bits < shift < 8:
                        value = np.uint32(values[i * 8 + j]) & mask
                        byte |= value << np.uint32(shift) if shift >= 0 else value >> np.uint32(-shift)
                stream[i * bits + k] = np.uint8(byte)

    @compiled
    def unpack_narrow(stream: Any, out: Any) -> None:
        for i in range(len(out) // 8):
            for j in range(8):
                k, shift = j * bits >> 3, j * bits & 7
                value = np.uint32(stream[i * bits + k]) >> np.uint32(shift)
                if shift + bits > 8:
                    value |= np.uint32(stream[i * bits + k + 1]) << np.uint32(8 - shift)
                if shift + bits > 16:
                    value |= np.uint32(stream[i * bits + k + 2]) << np.uint32(16 - shift)
                out[i * 8 + j] = value & mask

    return pack_narrow, unpack_narrow


@compiled
def _pack_any(values: Any, bits: int, words: Any, stride: int, offset: int) -> None:
    mask = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - bits)
    for i in range(len(values)):
        position = i * stride + offset
        word, shift = position >> 6, np.uint64(position & 63)
        value = np.uint64(values[i]) & mask
        words[word] = (words[word] & ~(mask << shift)) | (value << shift)
        if shift + np.uint64(bits) > np.uint64(64):
            back = np.uint64(64) - shift
            words[word + 1] = (words[word + 1] & ~(mask >> back)) | (value >> back)


@compiled
def _unpack_any(words: Any, bits: int, out: Any, stride: int, offset: int, signed: bool) -> None:
    mask = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - bits)
    sign = np.uint64(1) << np.uint64(bits - 1)
    for i in range(len(out)):
        position = i * stride + offset
        word, shift = position >> 6, np.uint64(position & 63)
        value = words[word] >> shift
        if shift + np.uint64(bits) > np.uint64(64):
            value |= words[word + 1] << (np.uint64(64) - shift)
        value &= mask
        if signed and value & sign:
            value |= ~mask
        out[i] = value


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
