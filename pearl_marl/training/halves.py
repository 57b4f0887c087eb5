"""A minibatch's gradients by two threads, where it is large enough for a second one to pay."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from pearl_marl.base.arrays import Array

SECOND_THREAD = 1 << 16
"""Rows times width of a minibatch from which on a second thread does half of it."""


class Halves:
    """Has gradients found for all rows of a minibatch, or for its halves, which are added up.

    The number of threads changes nothing: a minibatch that is large enough for two is always the sum of two
    halves.

    Parameters
    ----------
    model
        What is learned; the gradients are left with its parameters.
    width
        Of its layers.
    weights
        Returns the weights as compiled loops take them, or the tensors that stand for them.
    """

    def __init__(
        self, model: nn.Module, width: int, weights: Callable[[Mapping[Tensor, Tensor] | None], Any]
    ) -> None:
        parameters: Any = list(model.parameters())
        self._width = width
        self._first: list[Tensor] = [parameter.grad for parameter in parameters]
        self._second = [torch.empty_like(parameter) for parameter in parameters]
        self._gradients = [
            weights(dict(zip(parameters, tensors, strict=True))) for tensors in (self._first, self._second)
        ]
        self._helper = ThreadPoolExecutor(1)

    def find(self, rows: Array, half: Callable[[Array, Any], npt.NDArray[np.float64]]) -> Tensor:
        """Call ``half`` with rows and where it writes their gradients; return the sum of what it returns."""
        if len(rows) * self._width < SECOND_THREAD:
            return torch.from_numpy(half(rows, self._gradients[0]))
        middle = len(rows) // 2
        other = self._helper.submit(half, rows[middle:], self._gradients[1])
        figures = half(rows[:middle], self._gradients[0]) + other.result()
        for gradient, second in zip(self._first, self._second, strict=True):
            gradient += second
        return torch.from_numpy(figures)
