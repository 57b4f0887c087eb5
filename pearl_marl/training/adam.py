"""Adam (Kingma and Ba, 2015, arXiv:1412.6980), for networks so small that calls take most of the time.

All parameters lie in one tensor and their gradients in another, so a step is a handful of operations, however
many parameters there are. It does what ``torch.optim.Adam`` does after ``clip_grad_norm_``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import njit
from torch import Tensor, nn

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.training.restoring import copied, whole

BETA_1, BETA_2 = 0.9, 0.999
"""Shares of the means of gradients, and of their squares, that remain at each step."""

LINE = 16
"""Numbers of a cache line."""


@njit(nogil=True, fastmath={"contract", "reassoc"})
def _square_length(gradient: Array) -> float:
    """Return the sum of all squares, in any order, so that it is done by vectors."""
    length = 0.0
    for i in range(len(gradient)):
        length += gradient[i] * gradient[i]
    return length


def adam_step(
    values: Array,
    gradient: Array,
    mean: Array,
    square: Array,
    rate: float,
    correction: float,
    epsilon: float,
    max_grad_norm: float,
) -> None:
    """Move all values by their gradient, in one pass; ``correction`` is of the bias of the squares' mean."""
    factor = np.float32(min(max_grad_norm / (math.sqrt(_square_length(gradient)) + 1e-6), 1.0))
    toward, toward_square = np.float32(1 - BETA_1), np.float32(1 - BETA_2)
    rate_32, per_correction, epsilon_32 = np.float32(rate), np.float32(1 / correction), np.float32(epsilon)
    for i in range(len(values)):
        step = gradient[i] * factor
        mean[i] += toward * (step - mean[i])
        square[i] += toward_square * (step * step - square[i])
        values[i] -= rate_32 * mean[i] / (np.sqrt(square[i] * per_correction) + epsilon_32)


move_all = compiled_loop(adam_step, fused=True)


class Moves(NamedTuple):
    """What some steps of :func:`adam_step` depend on."""

    values: Array
    gradient: Array
    mean: Array
    square: Array
    rates: Array  # (steps, 2): of each step, rate and correction
    epsilon: float
    max_grad_norm: float


class Adam:
    """Moves parameters, which it takes into one tensor; move them to their device before.

    Parameters
    ----------
    parameters
        All of the same dtype and device.
    epsilon
        What is added to the root of the mean square that steps are divided by.
    max_grad_norm
        The norm to which the gradient of all parameters together is clipped.
    """

    def __init__(self, parameters: Iterable[nn.Parameter], epsilon: float, max_grad_norm: float) -> None:
        self.parameters = list(parameters)
        self.epsilon, self.max_grad_norm = epsilon, max_grad_norm
        # Each begins on a cache line, as it does alone: products of matrices differ in last bits where not.
        sizes = [-(-parameter.numel() // LINE) * LINE for parameter in self.parameters]
        self._values = self.parameters[0].new_zeros(sum(sizes))
        self._gradient, self._mean, self._square = (torch.zeros_like(self._values) for _ in range(3))
        self._state = self._values, self._gradient, self._mean, self._square
        self._steps = 0
        parts = (torch.split(tensor, sizes) for tensor in (self._values, self._gradient))
        for parameter, *pieces in zip(self.parameters, *parts, strict=True):
            values, gradient = (piece[: parameter.numel()].view_as(parameter) for piece in pieces)
            parameter.data, parameter.grad = values.copy_(parameter.data), gradient

    def zero_grad(self) -> None:
        """Forget the gradients that the parameters have."""
        self._gradient.zero_()

    def step(self, rate: float) -> None:
        """Learn at a learning rate from the gradients that the parameters have."""
        rates = self._rates(rate)
        if self._values.is_cuda:
            self._move(*self._state, *rates)
        else:
            move_all()(*(tensor.numpy() for tensor in self._state), *rates, self.epsilon, self.max_grad_norm)

    def steps_by_others(self, rate: float, steps: int) -> Moves:
        """Return what :func:`adam_step` takes for the next steps, on a CPU. The caller does them."""
        rates = np.array([self._rates(rate) for _ in range(steps)]).reshape(steps, 2)
        values, gradient, mean, square = (tensor.numpy() for tensor in self._state)
        return Moves(values, gradient, mean, square, rates, self.epsilon, self.max_grad_norm)

    def _rates(self, rate: float) -> tuple[float, float]:
        """Count a step; return its rate and correction."""
        self._steps += 1
        return rate / (1 - BETA_1**self._steps), 1 - BETA_2**self._steps

    def _move(
        self, values: Tensor, gradient: Tensor, mean: Tensor, square: Tensor, rate: float, correction: float
    ) -> None:
        """Do on a GPU what ``adam_step`` does on a CPU."""
        gradient *= (self.max_grad_norm / (gradient.norm() + 1e-6)).clamp(max=1)
        mean.lerp_(gradient, 1 - BETA_1)
        square.mul_(BETA_2).addcmul_(gradient, gradient, value=1 - BETA_2)
        values.addcdiv_(mean, square.div(correction).sqrt_().add_(self.epsilon), value=-rate)

    def state_dict(self) -> dict[str, Any]:
        """Return all that later steps depend on, but for the parameters."""
        return {"mean": self._mean, "square": self._square, "steps": self._steps}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state_dict` returned."""
        copied("mean of gradients", self._mean, state["mean"])
        copied("mean of their squares", self._square, state["square"], least=0)
        self._steps = whole("number of steps", state["steps"])
