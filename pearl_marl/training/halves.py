"""A minibatch's gradients by two threads, where it is large enough for a second one to pay."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from pearl_marl.base.arrays import Array
from pearl_marl.policies.second_thread import both, is_free

SECOND_THREAD = 1 << 16
"""Rows times width of a minibatch from which on a second thread does half of it.

Of smaller ones of PPO, it finds the critic's gradients: see :func:`pearl_marl.training.dense_ppo.descend`.
"""


class Halves:
    """Has gradients found for all rows of a minibatch, or for its halves, which are added up.

    The number of threads changes nothing: a minibatch that is large enough for two is always the sum of two
    halves, which this thread finds one after the other if no second one is free.

    Parameters
    ----------
    model
        What is learned; the gradients are left with its parameters.
    width
        Of its layers.
    weights
        Given a tensor for each parameter, returns where a half writes its gradients.
    """

    def __init__(
        self, model: nn.Module, width: int, weights: Callable[[Mapping[Tensor, Tensor]], Any]
    ) -> None:
        parameters: Any = list(model.parameters())
        self._width = width
        self._first: list[Tensor] = [parameter.grad for parameter in parameters]
        self._second = [torch.empty_like(parameter) for parameter in parameters]
        self._gradients = [
            weights(dict(zip(parameters, tensors, strict=True))) for tensors in (self._first, self._second)
        ]

    def find(self, rows: Array, half: Callable[[Array, Any], npt.NDArray[np.float64]]) -> Tensor:
        """Call ``half`` with rows and where it writes their gradients; return the sum of what it returns."""
        if len(rows) * self._width < SECOND_THREAD:
            return torch.from_numpy(half(rows, self._gradients[0]))
        middle = len(rows) // 2
        parts = rows[:middle], rows[middle:]
        first, second = (partial(half, *part) for part in zip(parts, self._gradients, strict=True))
        figures = sum(both(first, second)) if is_free() else first() + second()
        for gradient, other in zip(self._first, self._second, strict=True):
            gradient += other
        return torch.from_numpy(figures)


class AutogradHalves:
    """Has autograd find the gradients of a mean loss, where it pays by two threads, a half of the rows each.

    PyTorch's own threads share a product of matrices and wait for each other after each; halves meet once.

    Parameters
    ----------
    parameters
        What is learned; the gradients are left with it.
    width
        Of the networks' layers, times the samples of a row.
    """

    def __init__(self, parameters: Sequence[nn.Parameter], width: int) -> None:
        self._parameters, self._width = parameters, width
        self._divisible = not parameters[0].is_cuda
        self._helper: ThreadPoolExecutor | None = None  # only where threads are shared

    def find(
        self,
        rows: Tensor,
        loss: Callable[[Tensor], tuple[Tensor, Tensor]],
        terms: Callable[[Tensor], int],
    ) -> Tensor:
        """Leave the gradients of the loss of all rows.

        ``loss`` is given rows, and returns their mean loss, and figures that are means, too; ``terms``
        returns how many terms the means of some rows have. Return the figures of all rows.
        """
        if not self._divides(len(rows)):
            gradients, figures = self._of(rows, 1.0, loss)
            for parameter, gradient in zip(self._parameters, gradients, strict=True):
                parameter.grad.copy_(gradient)  # type: ignore[union-attr]
            return figures
        middle = len(rows) // 2
        halves = rows[:middle], rows[middle:]
        numbers = [terms(some) for some in halves]
        parts = [(some, n / sum(numbers), loss) for some, n in zip(halves, numbers, strict=True)]
        if self._helper is not None:
            other = self._helper.submit(self._of, *parts[1])
            first, second = self._of(*parts[0]), other.result()
        else:
            first, second = self._of(*parts[0]), self._of(*parts[1])
        for parameter, *gradients in zip(self._parameters, first[0], second[0], strict=True):
            torch.add(*gradients, out=parameter.grad)
        return first[1] + second[1]

    @contextmanager
    def shared(self, rows: int, threads: int) -> Iterator[None]:
        """Let a second thread find a half of each minibatch of so many rows, if there are several threads.

        The halves share PyTorch's threads until the block ends: to do so for each minibatch would take longer
        than it saves.
        """
        if threads == 1 or not self._divides(rows):
            yield
            return
        before = torch.get_num_threads()
        half = max(before // 2, 1)
        try:
            with ThreadPoolExecutor(1, initializer=torch.set_num_threads, initargs=(half,)) as self._helper:
                torch.set_num_threads(half)
                yield
        finally:
            self._helper = None
            torch.set_num_threads(before)

    def _divides(self, rows: int) -> bool:
        return self._divisible and rows > 1 and rows * self._width >= SECOND_THREAD

    def _of(
        self, rows: Tensor, share: float, loss: Callable[[Tensor], tuple[Tensor, Tensor]]
    ) -> tuple[Sequence[Tensor], Tensor]:
        """Return the gradients and the figures of rows that are so large a share of all."""
        value, figures = loss(rows)
        gradients = torch.autograd.grad(value * share, self._parameters, materialize_grads=True)
        return gradients, figures.detach() * share
