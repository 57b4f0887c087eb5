"""Bit packing: from arrays of integers to the bit streams of the Comm-BRAM and back.

A stream is a ``uint8`` array in which value ``i`` owns the ``bits`` bits from ``i * stride +
offset`` on, least significant first. A word of several fields is one :func:`pack` per field into
the same stream, each with its own offset. The length of a stream is a multiple of 8 bytes
(:func:`stream_bytes`), so that the kernels move whole 64-bit words.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.cache import compiled

Stream = npt.NDArray[np.uint8]


def stream_bytes(count: int, stride: int) -> int:
    """Return the bytes of a stream of ``count`` values, ``stride`` bits apart."""
    return -(-count * stride // 64) * 8


def pack(values: npt.NDArray[Any], bits: int, stream: Stream, stride: int, offset: int = 0) -> None:
    """Write the low ``bits`` bits of each value into its place in the stream; other bits stay.

    Parameters
    ----------
    values
        Integers of shape ``(n,)``; higher bits (as of negative numbers) are cut off.
    bits
        1 to 64, the width of a value.
    stream
        ``uint8``, at least :func:`stream_bytes` long.
    stride
        Distance of two neighbours in bits, at least ``offset + bits``.
    offset
        First bit of the value within its stride.
    """
    _check(len(values), bits, stream, stride, offset)
    if bits == stride and bits in (1, 2, 4):
        _narrow_kernels(bits)[0](values.astype(np.uint8, copy=False), stream)
    elif bits == stride and bits in (8, 16, 32, 64):
        stream[: len(values) * bits // 8] = np.ascontiguousarray(values, f"<u{bits // 8}").view(np.uint8)
    else:
        _pack_any(values, bits, stream.view(np.uint64), stride, offset)


def unpack(stream: Stream, bits: int, out: npt.NDArray[Any], stride: int, offset: int = 0) -> None:
    """Read a value from each place of the stream; the inverse of :func:`pack`.

    A signed ``out`` extends the sign of the ``bits``-wide value.
    """
    _check(len(out), bits, stream, stride, offset)
    signed = out.dtype.kind == "i"
    if bits == stride and bits in (1, 2, 4) and not signed:
        _narrow_kernels(bits)[1](stream, out)
    elif bits == stride and bits in (8, 16, 32, 64):
        out[:] = stream[: len(out) * bits // 8].view(f"<{out.dtype.kind}{bits // 8}")
    else:
        _unpack_any(stream.view(np.uint64), bits, out, stride, offset, signed)


def _check(count: int, bits: int, stream: Stream, stride: int, offset: int) -> None:
    if not 1 <= bits <= 64 or offset < 0 or offset + bits > stride:
        raise ValueError(f"{bits} bits at offset {offset} do not fit a stride of {stride}")
    if len(stream) % 8 or len(stream) < stream_bytes(count, stride):
        raise ValueError(f"a stream of {len(stream)} bytes does not hold {count} strides of {stride} bits")


@functools.cache
def _narrow_kernels(bits: int) -> tuple[Callable[..., None], Callable[..., None]]:
    # A constant width lets LLVM unroll the inner loop and turn the outer one into SIMD code, so
    # there is one pair of kernels for each of 1, 2 and 4 bits.
    per_byte = 8 // bits
    mask = np.uint8((1 << bits) - 1)

    @compiled
    def pack_narrow(values: Any, stream: Any) -> None:
        whole = len(values) // per_byte
        for i in range(whole):
            byte = np.uint8(0)
            for j in range(per_byte):
                byte |= np.uint8(np.uint8(values[i * per_byte + j] & mask) << np.uint8(j * bits))
            stream[i] = byte
        for i in range(whole * per_byte, len(values)):
            shift = np.uint8((i % per_byte) * bits)
            kept = np.uint8(stream[whole] & np.uint8(~np.uint8(mask << shift)))
            stream[whole] = np.uint8(kept | np.uint8(np.uint8(values[i] & mask) << shift))

    @compiled
    def unpack_narrow(stream: Any, out: Any) -> None:
        whole = len(out) // per_byte
        for i in range(whole):
            byte = stream[i]
            for j in range(per_byte):
                out[i * per_byte + j] = np.uint8(byte >> np.uint8(j * bits)) & mask
        for i in range(whole * per_byte, len(out)):
            out[i] = np.uint8(stream[whole] >> np.uint8((i % per_byte) * bits)) & mask

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
