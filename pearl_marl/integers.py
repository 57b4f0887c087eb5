"""Integers that never overflow, one or an array of them: what the reference runs golden functions on.

They share nothing with the compiler's graph, which is tested against them. Beside an array stand bounds of
its elements, and the array is of the narrowest type that holds those: where they leave 64 bits, of Python's
own integers.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from pearl_marl.remaking import Vocabulary

_LIMITS = [
    (np.dtype(t), int(np.iinfo(t).min), int(np.iinfo(t).max))
    for t in (np.int16, np.int32, np.int64, np.uint64)
]
_OBJECTS = np.dtype(object)
_UFUNCS: dict[np.ufunc, Callable[[Any, Any], Integers]] = {}
"""What NumPy's functions do where an argument is of integers."""

Bounds = tuple[int, int]


@functools.lru_cache(1 << 12)
def _dtype(low: int, high: int) -> np.dtype[Any]:
    for dtype, least, most in _LIMITS:
        if least <= low and high <= most:
            return dtype
    return _OBJECTS


def _operation(ufunc: np.ufunc, bounds: Callable[[Integers, Integers], Bounds]) -> tuple[Any, Any]:
    """Return the method that does what a function of NumPy's does, and the one with arguments swapped."""

    def method(self: Any, other: Any) -> Integers:
        a, b = Integers.of(self), Integers.of(other)
        low, high = bounds(a, b)
        dtype = _dtype(min(low, a.low, b.low), max(high, a.high, b.high))
        if dtype is _OBJECTS:  # perhaps by bounds that are too wide
            low, high = bounds(a.tighten(), b.tighten())
            dtype = _dtype(min(low, a.low, b.low), max(high, a.high, b.high))
        return Integers(ufunc(a.as_(dtype), b.as_(dtype)), low, high)

    _UFUNCS[ufunc] = method
    return method, lambda self, other: method(other, self)


def _corners(function: Callable[[int, int], int]) -> Callable[[Integers, Integers], Bounds]:
    def bounds(a: Integers, b: Integers) -> Bounds:
        ends = [function(x, y) for x in (a.low, a.high) for y in (b.low, b.high)]
        return min(ends), max(ends)

    return bounds


def _logic(a: Integers, b: Integers) -> Bounds:
    every = (1 << max(n.bit_length() for n in (a.low, a.high, b.low, b.high))) - 1
    return (0 if a.low >= 0 and b.low >= 0 else ~every), every


def _and(a: Integers, b: Integers) -> Bounds:
    positive = [x.high for x in (a, b) if x.low >= 0]
    return (0, min(positive)) if positive else _logic(a, b)


def _left(a: Integers, by: Integers) -> Bounds:
    if by.low < 0 or by.high > 63:
        by.tighten()
        if by.low < 0 or by.high > 63:
            raise ValueError(f"a shift by {by.low} to {by.high}; possible are 0 to 63")
    return _corners(operator.lshift)(a, by)


def _right(a: Integers, by: Integers) -> Bounds:
    if by.low < 0:
        by.tighten()  # which a negative shift still fails by
    return _corners(operator.rshift)(a, by)


def _flag(*_: Integers) -> Bounds:
    return 0, 1


def _quotient(a: Integers, by: Integers) -> Bounds:
    if by.low < 1:
        by.tighten()
        if by.low < 1:
            raise ValueError(f"a divisor is {by.low} to {by.high}; possible is 1 or more")
    return _corners(operator.floordiv)(a, by)


class Integers:
    """A word of one slot or of many."""

    __slots__ = ("high", "low", "values")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, values: Any, low: int, high: int) -> None:
        self.low, self.high = low, high
        self.values: npt.NDArray[Any] = np.asarray(values, _dtype(low, high))

    @staticmethod
    def of(value: Any) -> Integers:
        """Return what an author's function has at hand as integers."""
        if type(value) is Integers:
            return value
        if type(value) is int:
            return _constant(value)
        array = np.asarray(value)
        if array.dtype == np.bool_:
            return Integers(array, 0, 1)
        if array.dtype == _OBJECTS:
            return Integers(array, int(array.min()), int(array.max()))
        limits = np.iinfo(array.dtype)  # of floats there are none
        return Integers(array, int(limits.min), int(limits.max))

    def as_(self, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
        """Return the array in a type that holds it."""
        return self.values if self.values.dtype is dtype else self.values.astype(dtype)

    def tighten(self) -> Integers:
        """Take the least and the greatest element for bounds."""
        if self.values.size:
            self.low, self.high = int(self.values.min()), int(self.values.max())
            self.values = self.as_(_dtype(self.low, self.high))
        return self

    def wide(self) -> Any:
        """Return an array of NumPy's, or a number; of 64 bits, so that whoever goes on computing has room."""
        dtype = self.values.dtype
        return self.values.astype(np.int64 if dtype.itemsize < 8 else dtype, copy=False)[()]

    __add__, __radd__ = _operation(np.add, lambda a, b: (a.low + b.low, a.high + b.high))
    __sub__, __rsub__ = _operation(np.subtract, lambda a, b: (a.low - b.high, a.high - b.low))
    __mul__, __rmul__ = _operation(np.multiply, _corners(operator.mul))
    __floordiv__, __rfloordiv__ = _operation(np.floor_divide, _quotient)
    __mod__, __rmod__ = _operation(np.remainder, lambda a, by: (0, max(_quotient(by, by)[0], by.high) - 1))
    __and__, __rand__ = _operation(np.bitwise_and, _and)
    __or__, __ror__ = _operation(np.bitwise_or, _logic)
    __xor__, __rxor__ = _operation(np.bitwise_xor, _logic)
    __lshift__, __rlshift__ = _operation(np.left_shift, _left)
    __rshift__, __rrshift__ = _operation(np.right_shift, _right)
    __eq__, _ = _operation(np.equal, _flag)
    __ne__, _ = _operation(np.not_equal, _flag)
    __lt__, _ = _operation(np.less, _flag)
    __le__, _ = _operation(np.less_equal, _flag)
    __gt__, _ = _operation(np.greater, _flag)
    __ge__, _ = _operation(np.greater_equal, _flag)

    def __neg__(self) -> Any:
        return 0 - self

    def __invert__(self) -> Any:
        return -1 - self

    def __pos__(self) -> Integers:
        return self

    def __abs__(self) -> Integers:
        return _chosen(self < 0, -self, self)

    def __pow__(self, exponent: int) -> Integers:
        result = Integers.of(1)
        for _ in range(exponent):
            result = result * self
        return result

    def __bool__(self) -> NoReturn:
        raise TypeError("a word decides what Python does next; golden functions choose by np.where")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **_: Any) -> Any:
        return _UFUNCS[ufunc](*inputs) if method == "__call__" and ufunc in _UFUNCS else NotImplemented

    def __array_function__(self, function: Any, types_: Any, args: Any, keywords: Any) -> Any:
        return _FUNCTIONS[function](*args) if function in _FUNCTIONS and not keywords else NotImplemented


@functools.lru_cache(1 << 12)
def _constant(value: int) -> Integers:
    return Integers(value, value, value)


def _chosen(flag: Any, a: Any, b: Any) -> Integers:
    flag, a, b = (Integers.of(x) for x in (flag, a, b))
    low, high = min(a.low, b.low), max(a.high, b.high)
    dtype = _dtype(low, high)
    return Integers(np.where(flag.values != 0, a.as_(dtype), b.as_(dtype)), low, high)


_minimum, _ = _operation(np.minimum, lambda a, b: (min(a.low, b.low), min(a.high, b.high)))
_maximum, _ = _operation(np.maximum, lambda a, b: (max(a.low, b.low), max(a.high, b.high)))
_FUNCTIONS: dict[Any, Callable[..., Integers]] = {
    np.where: _chosen,
    np.clip: lambda x, low, high: _minimum(_maximum(x, low), high),
}


class _Cast:
    """A type of NumPy's, called: what fits it stays, anything else wraps modulo ``2**bits``."""

    def __init__(self, dtype: type[np.integer[Any]]) -> None:
        limits = np.iinfo(dtype)
        self.dtype, self.low, self.high = dtype, int(limits.min), int(limits.max)

    def __call__(self, value: Any = 0) -> Any:
        if type(value) is int:
            return (value - self.low) % (self.high - self.low + 1) + self.low
        word = Integers.of(value)
        if self.low <= word.low and word.high <= self.high:
            return word
        values = word.values
        if values.dtype == _OBJECTS:
            values = np.asarray(values & np.iinfo(np.uint64).max).astype(np.uint64)
        return Integers(values.astype(self.dtype), self.low, self.high)


class _Table(tuple[Any, ...]):
    """A constant table, which a word may index."""

    __slots__ = ()

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, tuple):
            first, *rest = index
            return self[first][tuple(rest)] if rest else self[first]
        if not isinstance(index, Integers):
            found = super().__getitem__(index)
            return _Table(found) if isinstance(index, slice) else found
        index.tighten()
        if index.low < 0 or index.high >= len(self):
            raise IndexError(
                f"an index is {index.low} to {index.high}, and the table has {len(self)} entries"
            )
        return _entry(self, index)


def _entry(entries: Iterable[Any], index: Integers) -> Any:
    entries = list(entries)
    if all(isinstance(entry, _Table) for entry in entries):
        return _Table(_entry(column, index) for column in zip(*entries, strict=True))
    words = [Integers.of(entry) for entry in entries]
    if not any(word.values.ndim for word in words):
        numbers = [int(word.values) for word in words]
        low, high = min(numbers), max(numbers)
        return Integers(np.array(numbers, _dtype(low, high))[index.values], low, high)
    result = words[-1]
    for k, word in enumerate(words[:-1]):
        result = _chosen(index == k, word, result)
    return result


def _table(values: Iterable[Any]) -> _Table:
    return _Table(_table(v) if isinstance(v, (list, tuple)) else v for v in values)


VOCABULARY = Vocabulary(_Cast, _table)
"""What golden functions name, on these integers."""
