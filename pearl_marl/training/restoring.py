"""Values that a trainer takes from a checkpoint, which others may have written: checked, or refused.

Tensors are copied into those that are there, and PyTorch would stretch smaller ones to fit. Compiled loops
trust numbers of rows and of actions.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from pearl_marl.errors import ArgumentError, brief
from pearl_marl.spec import EnvSpec
from pearl_marl.spec.elements import are_numbers, bounds


def whole(name: str, value: Any) -> int:
    """Return a number of things."""
    if type(value) is not int or not 0 <= value < 1 << 63:
        raise ArgumentError(f"its {name} is {brief(value)}; it must be an integer from 0")
    return value


def copied(name: str, mine: Tensor, kept: Any, least: float | None = None, most: float | None = None) -> None:
    """Copy a tensor from a checkpoint into the trainer's own, of finite numbers between two bounds."""
    kind = f"{kept.dtype} of shape {tuple(kept.shape)}" if isinstance(kept, Tensor) else type(kept).__name__
    if kind != f"{mine.dtype} of shape {tuple(mine.shape)}":
        raise ArgumentError(f"its {name} is {kind}, not {mine.dtype} of shape {tuple(mine.shape)}")
    if kept.dtype == torch.bool:
        right = bool((kept.contiguous().view(torch.uint8) <= 1).all())
    else:
        right = bool(kept.isfinite().all()) and (
            not kept.numel()
            or ((least is None or kept.min() >= least) and (most is None or kept.max() <= most))
        )
    if not right:
        raise ArgumentError(f"its {name} has numbers that no training leaves")
    mine.copy_(kept)


def observed(name: str, mine: Tensor, kept: Any, filled: int, spec: EnvSpec) -> None:
    """Do so with observations of every agent; the first ``filled`` rows, if there are so many, have some."""
    copied(name, mine, kept)
    if not are_numbers(spec.observation_space):
        return
    ends = [end.ravel().tolist() for end in bounds(spec.observation_space)]
    columns = mine[:filled].reshape(-1, len(ends[0])).unbind(1)
    for low, high, column in zip(*ends, columns, strict=True):
        if len(column) and (column.min() < low or column.max() > high):
            raise ArgumentError(f"its {name} has numbers that {spec.name} does not show")


def saved_bytes(name: str, kept: Any) -> bytes:
    """Return bytes that a checkpoint keeps as a tensor, as long as that is in the file."""
    if isinstance(kept, Tensor) and kept.dtype == torch.uint8 and kept.ndim == 1 and kept.is_contiguous():
        return kept.numpy().tobytes()
    raise ArgumentError(f"its {name} is no row of bytes")
