"""The pieces of the CPU's kernels that write observations of many flags.

Left to itself, a loop that writes a long row for each slot is scalar, or scatters its words. So one loop packs the
flags into bytes, in SIMD code, and another one writes the bits of a byte out as so many elements at once. With its
71 elements RobotWarehouse steps nine times as many agents like this.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pearl_marl.spec import EnvSpec, Field

FEW = 16
"""Up to so many flags are written one by one."""
BYTE = 8


class Run(NamedTuple):
    """Elements of an observation that are written at once: flags that a byte holds, or a single one."""

    first: int
    count: int


def is_flag(field: Field) -> bool:
    """Return whether a field is 0 or 1, and its element too."""
    return field.bits == 1 and not field.signed and not field.fraction


def runs(spec: EnvSpec) -> list[Run]:
    """Return all elements in runs; none where there are few flags, or the fields are not the elements."""
    flags = [is_flag(field) for field in spec.observation]
    if spec.unpack is not None or sum(flags) <= FEW:
        return []
    found: list[Run] = []
    for k, flag in enumerate(flags):
        if flag and found and flags[k - 1] and found[-1].count < BYTE:
            found[-1] = Run(found[-1].first, found[-1].count + 1)
        else:
            found.append(Run(k, 1))
    return found


def packed(run: Run, dtype: str, words: Sequence[str]) -> str:
    """Return the word of a run, of the words of its elements."""
    text = f"np.{dtype}({words[run.first]})"
    for bit, flag in enumerate(words[run.first + 1 : run.first + run.count], 1):
        text = f"uint8_or({text}, uint8_left({flag}, {bit}))"
    return text


def written(run: Run, dtype: str, at: str, word: str) -> str:
    """Return what writes the elements of a run from its word; ``at`` is where the first one goes in ``O``."""
    return (
        f"O[{at}] = np.{dtype}({word})" if run.count == 1 else f"{dtype}_flags(O, {at}, {word}, {run.count})"
    )
