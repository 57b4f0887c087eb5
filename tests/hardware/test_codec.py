"""Packing and unpacking against a stream that is one Python integer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pearl_marl.hardware import codec

SIZES = (8, 16, 32, 64)


@dataclass
class Layout:
    """Where values lie in a stream."""

    bits: int
    stride: int
    offset: int
    count: int
    seed: int
    signed: bool = False

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(
            f"{'int' if self.signed else 'uint'}{next(size for size in SIZES if size >= self.bits)}"
        )

    def numbers(self) -> list[int]:
        """Return numbers of the layout's width, both ends of it included."""
        low, high = (-(1 << self.bits - 1), 1 << self.bits - 1) if self.signed else (0, 1 << self.bits)
        generator = np.random.default_rng(self.seed)
        words = generator.integers(2**64, size=self.count, dtype=np.uint64).tolist()
        return [low, high - 1, *(low + word % (high - low) for word in words)][: self.count]

    def noise(self) -> np.ndarray:
        """Return a stream that is full already, with room behind the last value."""
        length = codec.stream_bytes(self.count, self.stride) + 8 * (self.seed % 3)
        return np.random.default_rng(self.seed + 1).integers(256, size=length, dtype=np.uint8)


@st.composite
def layouts(draw: st.DrawFn) -> Layout:
    bits = draw(st.integers(1, 64))
    offset = draw(st.one_of(st.just(0), st.integers(0, 150)))
    gap = draw(st.one_of(st.just(0), st.integers(0, 150)))
    return Layout(
        bits,
        offset + bits + gap,
        offset,
        draw(st.integers(0, 40)),
        draw(st.integers(0, 999)),
        draw(st.booleans()),
    )


@settings(max_examples=400)
@given(layouts())
@example(Layout(1, 1, 0, 33, 1))
@example(Layout(2, 2, 0, 33, 1))
@example(Layout(4, 4, 0, 33, 1, signed=True))
@example(Layout(64, 64, 0, 5, 1, signed=True))
@example(Layout(64, 127, 63, 5, 1))
# Many narrow values, which have kernels of their own; the last of them have not.
@example(Layout(1, 1, 0, 1000, 1))
@example(Layout(2, 2, 0, codec.MANY, 1))
@example(Layout(3, 3, 0, 1001, 1))
@example(Layout(6, 6, 0, 999, 1))
@example(Layout(9, 9, 0, 640, 1))
@example(Layout(codec.NARROW_BITS, codec.NARROW_BITS, 0, 700, 2))
@example(Layout(5, 5, 0, 700, 1, signed=True))
# Places that are whole bytes.
@example(Layout(8, 24, 16, 9, 1))
@example(Layout(32, 128, 64, 9, 1, signed=True))
@example(Layout(16, 48, 8, 9, 1))
def test_against_one_large_integer(layout: Layout) -> None:
    values = np.array(layout.numbers(), layout.dtype)
    stream = layout.noise()
    model = int.from_bytes(stream.tobytes(), "little")
    codec.pack(values, layout.bits, stream, layout.stride, layout.offset)
    mask = (1 << layout.bits) - 1
    for i, value in enumerate(values.tolist()):
        position = i * layout.stride + layout.offset
        model = model & ~(mask << position) | (value & mask) << position
    assert int.from_bytes(stream.tobytes(), "little") == model, "a value is wrong, or a neighbour was touched"
    out = np.zeros(layout.count, layout.dtype)
    codec.unpack(stream, layout.bits, out, layout.stride, layout.offset)
    np.testing.assert_array_equal(out, values)


@settings(max_examples=100)
@given(layouts(), st.sampled_from(["uint8", "uint16", "int32", "int64", "uint64"]))
def test_higher_bits_are_cut_off(layout: Layout, dtype: str) -> None:
    """Whatever the dtype holds beyond the field's width must not reach the neighbours."""
    generator = np.random.default_rng(layout.seed)
    values = generator.integers(2**63, size=layout.count, dtype=np.int64).astype(dtype)
    stream = np.zeros(codec.stream_bytes(layout.count, layout.stride), np.uint8)
    codec.pack(values, layout.bits, stream, layout.stride, layout.offset)
    out = np.zeros(layout.count, np.uint64)
    codec.unpack(stream, layout.bits, out, layout.stride, layout.offset)
    assert out.tolist() == [v % 2**layout.bits for v in values.tolist()]


@settings(max_examples=100)
@given(st.lists(st.tuples(st.integers(1, 64), st.booleans()), min_size=1, max_size=6), st.integers(1, 30))
def test_a_word_of_several_fields(fields: list[tuple[int, bool]], count: int) -> None:
    stride = sum(bits for bits, _ in fields)
    stream = np.zeros(codec.stream_bytes(count, stride), np.uint8)
    written, offset = [], 0
    for k, (bits, signed) in enumerate(fields):
        layout = Layout(bits, stride, offset, count, seed=k, signed=signed)
        values = np.array(layout.numbers(), layout.dtype)
        codec.pack(values, bits, stream, stride, offset)
        written.append((layout, values))
        offset += bits
    for layout, values in written:
        out = np.empty(count, layout.dtype)
        codec.unpack(stream, layout.bits, out, stride, layout.offset)
        np.testing.assert_array_equal(out, values)


@pytest.mark.parametrize(
    ("count", "stride", "expected"), [(0, 7, 0), (1, 1, 8), (64, 1, 8), (65, 1, 16), (3, 43, 24)]
)
def test_stream_bytes(count: int, stride: int, expected: int) -> None:
    assert codec.stream_bytes(count, stride) == expected


@pytest.mark.parametrize(
    ("bits", "stride", "offset", "length", "complaint"),
    [
        (0, 8, 0, 64, "0 bits"),
        (65, 70, 0, 640, "65 bits"),
        (8, 8, 1, 64, "offset 1"),
        (8, 8, -1, 64, "offset -1"),
        (9, 8, 0, 64, "stride of 8"),
        (8, 8, 0, 0, "0 bytes"),
        (13, 13, 0, 8, "8 bytes does not hold 10 strides of 13"),
        (1, 1, 0, 9, "9 bytes"),
    ],
)
def test_refusals(bits: int, stride: int, offset: int, length: int, complaint: str) -> None:
    """A stream too short would be written past its end: the kernels check no index."""
    stream = np.zeros(length, np.uint8)
    with pytest.raises(ValueError, match=complaint):
        codec.pack(np.zeros(10, np.uint64), bits, stream, stride, offset)
    with pytest.raises(ValueError, match=complaint):
        codec.unpack(stream, bits, np.zeros(10, np.uint64), stride, offset)
    assert not stream.any()
