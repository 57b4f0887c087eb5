"""What a class of named words looks like in hardware: its fields in order, and back.

An author declares the state of an environment, and what an agent sees, as a class::

    class Robot(NamedTuple):
        row: Range[0, 9]
        carries: Bits[1]

    class State(NamedTuple):
        robots: Array[Robot, 4]
        time: Bits[10]

Hardware, saved states and kernels know words in the order in which they stand there.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Annotated, Any, SupportsInt

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.reals.choices import stored
from pearl_marl.golden.reals.numbers import Real as Number
from pearl_marl.golden.reals.numbers import constant, fraction_for
from pearl_marl.golden.tracing.operations import bits_of, word_range


@dataclasses.dataclass(frozen=True, slots=True)
class Field:
    """One named piece of a hardware word.

    Parameters
    ----------
    name
        As it appears in reports, waveforms, memory and generated code: ASCII letters, digits and underscores.
    bits
        Width in hardware, 1 to 64. On the host it lives in the narrowest integer that holds it.
    signed
        Whether it is two's complement.
    fraction
        Binary fraction bits: the value delivered is ``word * 2**-fraction``.
    least, most
        The range of its words, where that is not all that the bits hold.
    """

    name: str
    bits: int
    signed: bool = False
    fraction: int = 0
    least: int | None = None
    most: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.bits, int) or not 1 <= self.bits <= 64:
            raise ArgumentError(f"field {self.name!r} has {self.bits!r} bits; possible are 1 to 64")
        if not isinstance(self.fraction, int) or self.fraction < 0:
            raise ArgumentError(f"field {self.name!r} has {self.fraction!r} fraction bits; 0 is the least")

    @property
    def dtype(self) -> np.dtype[Any]:
        """The narrowest NumPy integer that holds the field."""
        width = max(8, 1 << (self.bits - 1).bit_length())
        return np.dtype(f"{'int' if self.signed else 'uint'}{width}")

    def value(self, word: SupportsInt) -> float:
        """Return what a word stands for; an ``int`` where there is no fraction."""
        return int(word) * 2.0**-self.fraction if self.fraction else int(word)

    @property
    def range(self) -> tuple[int, int]:
        """The least and the greatest word."""
        low, high = word_range(self.bits, self.signed)
        return low if self.least is None else self.least, high if self.most is None else self.most

    @property
    def low(self) -> float:
        """The least value; an ``int`` where there is no fraction."""
        return self.value(self.range[0])

    @property
    def high(self) -> float:
        """The greatest value; an ``int`` where there is no fraction."""
        return self.value(self.range[1])


def word_bits(fields: Sequence[Field]) -> int:
    """Return the width in bits of the word made of ``fields`` side by side."""
    return sum(f.bits for f in fields)


@dataclasses.dataclass(frozen=True)
class Scalar:
    """The format of one word."""

    bits: int
    signed: bool = False
    fraction: int = 0
    least: int | None = None
    most: int | None = None


@dataclasses.dataclass(frozen=True)
class Interval:
    """The range of a real number."""

    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class Several:
    """An array."""

    of: Any
    count: int


class _Word:
    def __init__(self, signed: bool) -> None:
        self.signed = signed

    def __getitem__(self, sizes: int | tuple[int, int]) -> Any:
        bits, fraction = sizes if isinstance(sizes, tuple) else (sizes, 0)
        return Annotated[int, Scalar(bits, self.signed, fraction)]


class _Range:
    """``Range[low, high]``: a word from low to high, both included, of as many bits as that takes."""

    def __getitem__(self, ends: tuple[int, int]) -> Any:
        if not isinstance(ends, tuple) or len(ends) != 2 or not all(type(end) is int for end in ends):
            raise ArgumentError(f"Range[{ends!r}]: give two integers, Range[0, 9]")
        low, high = ends
        if low > high:
            raise ArgumentError(f"Range[{low}, {high}]: the first is the least")
        signed = low < 0
        bits = max(1, high.bit_length() + signed, (~low).bit_length() + 1 if signed else 0)
        return Annotated[int, Scalar(bits, signed, 0, low, high)]


class _Real:
    """``Real[low, high]``: a real number in fixed point; what is stored beyond the range becomes its end."""

    def __getitem__(self, ends: tuple[float, float]) -> Any:
        if not isinstance(ends, tuple) or len(ends) != 2 or not all(map(_is_finite, ends)):
            raise ArgumentError(f"Real[{ends!r}]: give two finite numbers, Real[-2.4, 2.4]")
        if ends[0] >= ends[1]:
            raise ArgumentError(f"Real[{ends[0]}, {ends[1]}]: the first is the least")
        return Annotated[Any, Interval(float(ends[0]), float(ends[1]))]


def _is_finite(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


class _Array:
    """``Array[kind, n]``: n of a kind, a list; ``Array[kind, n, m]`` is a list of n lists of m."""

    def __getitem__(self, parts: tuple[Any, ...]) -> Any:
        kind, *counts = parts
        for count in reversed(counts):
            if type(count) is not int or count < 1:
                raise ArgumentError(f"Array[..., {count!r}]: a length is an integer from 1")
            kind = Annotated[list[Any], Several(kind, count)]
        return kind


Bits: Any = _Word(signed=False)
"""``Bits[n]``: a word of n bits, from 0. ``Bits[n, f]`` has f of them behind the binary point.

``Bits[0]``, where an option makes a word needless, keeps nothing: it is 0 when it is read.
"""
Signed: Any = _Word(signed=True)
"""``Signed[n]``: a word of n bits, two's complement. ``Signed[n, f]`` has f of them behind the point."""
Range: Any = _Range()
Real: Any = _Real()
Array: Any = _Array()
Flag: Any = Bits[1]
"""One bit, 0 or 1."""


class Layout:
    """The words of a class: ``fields``, :meth:`built` of words, and :meth:`flat` again.

    Parameters
    ----------
    cls
        The class.
    fraction
        The fraction bits of reals; ``None`` lets those of the class decide.

    Raises
    ------
    ArgumentError
        A field of the class has no width; names it.
    """

    def __init__(self, cls: type, fraction: int | None = None) -> None:
        if not isinstance(cls, type) or not getattr(cls, "__annotations__", None):
            raise ArgumentError(f"{cls!r} is no class with annotated fields, such as `row: Bits[2]`")
        self.cls = cls
        self._tree = _Group(cls)
        reals = [part for part in _inside(self._tree) if isinstance(part, _RealLeaf)]
        if fraction is None and reals:
            fraction = fraction_for(real.ends for real in reals)
        self.fraction = fraction if reals else None
        """The fraction bits of reals; ``None`` where there are none."""
        for real in reals:
            real.fraction = fraction or 0
        self.fields = tuple(self._tree.fields(""))

    @property
    def classes(self) -> tuple[type, ...]:
        """The class, and those of the objects in it."""
        return tuple(part.cls for part in _inside(self._tree) if isinstance(part, _Group))

    @cached_property
    def built(self) -> Callable[[Iterable[Any]], Any]:
        """A function of as many words or values as there are fields; it returns an object of the class.

        Arrays are lists. A word of a real is made one; a float stays what it is.
        """
        code = _LayoutCode()
        names = [f"word_{k}" for k in range(len(self.fields))]
        made = self._tree.made(iter(names), code)
        # As text, since the reference calls it for every slot.
        return code.function(  # type: ignore[no-any-return]
            "built", "words", [f"({''.join(f'{name}, ' for name in names)}) = words"], made
        )

    def flat(self, value: Any) -> Sequence[Any]:
        """Return the words of an object of the class.

        Raises
        ------
        ArgumentError
            It is none, or an array has another length: names which.
        """
        # An integer in a field of reals is no word yet.
        words = self._integers(value) if self.fraction is None else None
        if words is not None and {*map(type, words)} <= _INTEGERS:
            return words
        if not isinstance(value, self.cls):
            raise ArgumentError(f"a {self.cls.__name__} is due, and {_described(value)} is returned")
        result: list[Any] = []
        self._tree.flatten(value, self.cls.__name__, result)
        return result

    @cached_property
    def _integers(self) -> Callable[[Any], tuple[Any, ...] | None]:
        """:meth:`flat` of plain objects of integers; of others ``None``, or words that are none."""
        code = _LayoutCode()
        words = self._tree.taken("value", code)
        return code.function(  # type: ignore[no-any-return]
            "integers", "value", code.lines, f"({''.join(f'{word}, ' for word in words)})"
        )


_INTEGERS = {int, bool}


class _LayoutCode:
    """The text of a function that makes an object of words, or words of one."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.names: dict[Any, str] = {}

    def known(self, value: object) -> str:
        """Return a name that the text has for a value."""
        return self.names.setdefault(value, f"known_{len(self.names)}")

    def function(self, name: str, argument: str, lines: Iterable[str], result: str) -> Any:
        """Return the function of these statements."""
        text = [f"def {name}({argument}):", *(f"    {line}" for line in lines), f"    return {result}"]
        scope: dict[str, Any] = {known: value for value, known in self.names.items()}
        exec("\n".join(text), scope)
        return scope[name]


class _Leaf:
    def __init__(self, scalar: Scalar) -> None:
        self.scalar = scalar

    def fields(self, name: str) -> Iterator[Field]:
        s = self.scalar
        if s.bits:
            yield Field(name, s.bits, s.signed, s.fraction, s.least, s.most)

    def made(self, words: Iterator[str], code: _LayoutCode) -> str:
        return next(words) if self.scalar.bits else "0"

    def taken(self, value: str, code: _LayoutCode) -> list[str]:
        return [value] if self.scalar.bits else []

    def flatten(self, value: Any, where: str, result: list[Any]) -> None:
        if isinstance(value, (tuple, list, str)) or value is None:
            raise ArgumentError(f"{where} is {_described(value)}; it must be one word")
        if self.scalar.bits:
            result.append(value)


class _RealLeaf:
    fraction = 0

    def __init__(self, interval: Interval) -> None:
        self.interval, self.ends = interval, (interval.low, interval.high)

    def fields(self, name: str) -> Iterator[Field]:
        yield real_field(name, self.interval, self.fraction)

    def made(self, words: Iterator[str], code: _LayoutCode) -> str:
        word = next(words)
        number = f"{code.known(Number)}({word}, {self.fraction})"
        return f"{word} if isinstance({word}, float) else {number}"

    def taken(self, value: str, code: _LayoutCode) -> list[str]:
        return [value]

    def flatten(self, value: Any, where: str, result: list[Any]) -> None:
        if isinstance(value, (tuple, list, str)) or value is None:
            raise ArgumentError(f"{where} is {_described(value)}; it must be one number")
        result.append(stored(value, *self.ends, self.fraction))


def real_field(name: str, interval: Interval, fraction: int) -> Field:
    """Return the field that holds a real: as narrow as its range allows."""
    least, most = constant(interval.low, fraction), constant(interval.high, fraction)
    low, high = word_range(bits := bits_of(least, most), least < 0)
    return Field(
        name, bits, least < 0, fraction, None if low == least else least, None if high == most else most
    )


class _Several:
    def __init__(self, element: _Tree, count: int) -> None:
        self.element, self.count = element, count

    def fields(self, name: str) -> Iterator[Field]:
        for k in range(self.count):
            yield from self.element.fields(f"{name}_{k}")

    def made(self, words: Iterator[str], code: _LayoutCode) -> str:
        return f"[{', '.join(self.element.made(words, code) for _ in range(self.count))}]"

    def taken(self, value: str, code: _LayoutCode) -> list[str]:
        name = f"list_{len(code.lines)}"
        code.lines += [
            f"{name} = {value}",
            f"if {name}.__class__ is not list or len({name}) != {self.count}: return None",
        ]
        return [word for k in range(self.count) for word in self.element.taken(f"{name}[{k}]", code)]

    def flatten(self, value: Any, where: str, result: list[Any]) -> None:
        if not isinstance(value, (tuple, list)) or len(value) != self.count:
            raise ArgumentError(f"{where} is {_described(value)}; it must be a list of {self.count}")
        for k, one in enumerate(value):
            self.element.flatten(one, f"{where}[{k}]", result)


class _Group:
    def __init__(self, cls: type) -> None:
        self.cls = cls
        self.parts = {name: _tree(hint, f"{cls.__name__}.{name}") for name, hint in _hints(cls).items()}

    def fields(self, name: str) -> Iterator[Field]:
        for own, part in self.parts.items():
            yield from part.fields(f"{name}_{own}" if name else own)

    def made(self, words: Iterator[str], code: _LayoutCode) -> str:
        return f"{code.known(self.cls)}({', '.join(part.made(words, code) for part in self.parts.values())})"

    def taken(self, value: str, code: _LayoutCode) -> list[str]:
        name = f"group_{len(code.lines)}"
        code.lines += [
            f"{name} = {value}",
            f"if {name}.__class__ is not {code.known(self.cls)}: return None",
        ]
        return [word for own, part in self.parts.items() for word in part.taken(f"{name}.{own}", code)]

    def flatten(self, value: Any, where: str, result: list[Any]) -> None:
        if not isinstance(value, self.cls):
            raise ArgumentError(f"{where} is {_described(value)}; it must be a {self.cls.__name__}")
        for name, part in self.parts.items():
            part.flatten(getattr(value, name), f"{where}.{name}", result)


_Tree = _Leaf | _RealLeaf | _Several | _Group


def _inside(tree: _Tree) -> Iterator[_Tree]:
    """Yield a tree, and all that are inside it."""
    yield tree
    if isinstance(tree, _Several):
        yield from _inside(tree.element)
    if isinstance(tree, _Group):
        for part in tree.parts.values():
            yield from _inside(part)


def _tree(hint: Any, where: str) -> _Tree:
    for extra in getattr(hint, "__metadata__", ()):
        if isinstance(extra, Scalar):
            return _Leaf(extra)
        if isinstance(extra, Several):
            return _Several(_tree(extra.of, where), extra.count)
        if isinstance(extra, Interval):
            return _RealLeaf(extra)
    if isinstance(hint, type) and getattr(hint, "__annotations__", None):
        return _Group(hint)
    raise ArgumentError(
        f"{where} is annotated {getattr(hint, '__name__', hint)}; say how wide it is: Bits[4], Range[0, 9], "
        "Real[-1, 1], Array[Bits[4], 16] or a class of such fields"
    )


def _hints(cls: type) -> Mapping[str, Any]:
    """Return the annotations of a class."""
    try:
        return typing.get_type_hints(cls, include_extras=True)
    except NameError as error:
        raise ArgumentError(
            f"{cls.__name__}: {error}; a class inside a function needs a module without "
            "`from __future__ import annotations`"
        ) from None


def leaves(value: Any) -> list[Any]:
    """Return the words of what a golden function returns: tuples and lists, some inside others, in order."""
    if isinstance(value, (tuple, list)):
        return [word for part in value for word in leaves(part)]
    return [value]


def _described(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return f"a {'list' if isinstance(value, list) else type(value).__name__} of {len(value)}"
    if value is None:
        return "nothing"
    return repr(value) if isinstance(value, (int, str)) else f"a {type(value).__name__}"
