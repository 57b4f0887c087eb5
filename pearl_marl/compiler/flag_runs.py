"""Runs: what is written at once of observations of many flags or of one wide number, and of masks.

Left to itself, a loop that writes a long row for each slot is scalar, or scatters its words. So one loop
packs the flags into bytes, in SIMD code, and another one writes a byte's bits out, all of them at once.
RobotWarehouse, whose observations have 71 elements, steps nine times as many agents like this.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.spec import EnvSpec, Field

FEW = 16
"""Up to so many flags of an observation are written one by one."""
BYTE = 8
WIDER = 4
"""From so many times the width of its word on, an observation is made first and widened then."""


def cell_dtype(spec: EnvSpec) -> np.dtype[Any]:
    """Return what an element of an observation is written as: a bool as its byte."""
    return np.dtype(np.uint8 if spec.observation_dtype == np.bool_ else spec.observation_dtype)


class FlagRun(NamedTuple):
    """Elements of a row that are written at once: flags that a byte holds, or a single one."""

    of_mask: bool
    """Whether it is of action masks, or else of observations."""
    at: int
    """The first element's place in an agent's row."""
    word: int
    """The first element's place among the words that ``observe`` returns."""
    size: int


def is_flag(field: Field) -> bool:
    """Return whether a field is 0 or 1, and its element too."""
    return field.bits == 1 and not field.signed and not field.fraction


def runs(spec: EnvSpec) -> list[FlagRun]:
    """Return the elements of an agent's row that are written in runs.

    That is all masks, and all of an observation whose elements are its fields and that has many flags, or is
    one number in a much wider word: a loop works on as few slots at once as its widest word allows.
    """
    masks = _runs(True, spec.mask_fields, len(spec.observation))
    wide = [spec.observation_dtype.itemsize >= WIDER * field.dtype.itemsize for field in spec.observation]
    if spec.unpack is not None or (wide != [True] and sum(map(is_flag, spec.observation)) <= FEW):
        return masks
    return _runs(False, spec.observation, 0) + masks


def _runs(of_mask: bool, fields: Sequence[Field], first: int) -> list[FlagRun]:
    found: list[FlagRun] = []
    flags = [is_flag(field) for field in fields]
    for k, flag in enumerate(flags):
        if flag and k and flags[k - 1] and found[-1].size < BYTE:
            found[-1] = found[-1]._replace(size=found[-1].size + 1)
        else:
            found.append(FlagRun(of_mask, k, first + k, 1))
    return found
