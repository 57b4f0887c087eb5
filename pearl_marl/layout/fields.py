"""The fields that hardware words are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, SupportsInt

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.tracing.operations import word_range


@dataclass(frozen=True, slots=True)
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
