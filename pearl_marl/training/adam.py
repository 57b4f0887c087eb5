"""Adam (Kingma and Ba, 2015, arXiv:1412.6980), for networks so small that the calls are what takes time.

All parameters lie in one tensor and their gradients in another, so a step is a handful of operations, however
many parameters there are. It does what ``torch.optim.Adam`` does after ``clip_grad_norm_``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.training.restoring import copied, whole

Array = npt.NDArray[Any]

FADING, FADING_SQUARES = 0.9, 0.999
"""What remains, at each step, of the means of gradients and of their squares."""


LINE = 16
"""Numbers of a cache line."""


def _adam(
    values: Array,
    gradient: Array,
    mean: Array,
    square: Array,
    rate: float,
    known: float,
    epsilon: float,
    longest: float,
) -> None:
    """Move all values by their gradient, in one go: ``known`` is how much of the squares' mean is known."""
    length = 0.0
    for i in range(len(gradient)):
        length += gradient[i] * gradient[i]
    cut = np.float32(min(longest / (math.sqrt(length) + 1e-6), 1.0))
    fade, fade_squares = np.float32(1 - FADING), np.float32(1 - FADING_SQUARES)
    far, share, least = np.float32(rate), np.float32(1 / known), np.float32(epsilon)
    for i in range(len(values)):
        step = gradient[i] * cut
        mean[i] += fade * (step - mean[i])
        square[i] += fade_squares * (step * step - square[i])
        values[i] -= far * mean[i] / (np.sqrt(square[i] * share) + least)


_move = compiled_loop(_adam)

Gradients = list[tuple[Tensor, Tensor]]
"""Tensors, each with the gradient of the loss by it."""


class Adam:
    """Moves parameters, which it takes into one tensor; they have to be where they stay.

    Parameters
    ----------
    parameters
        All of the same dtype and device.
    epsilon
        What is added to the root of the mean square that steps are divided by.
    longest
        The length to which the gradient of all parameters together is cut.
    """

    def __init__(self, parameters: Iterable[nn.Parameter], epsilon: float, longest: float) -> None:
        self.parameters = list(parameters)
        self.epsilon, self.longest = epsilon, longest
        # Each begins on a cache line, as it does alone: products of matrices differ in last bits where not.
        sizes = [-(-parameter.numel() // LINE) * LINE for parameter in self.parameters]
        self._values = self.parameters[0].new_zeros(sum(sizes))
        self._gradient, self._mean, self._square = (torch.zeros_like(self._values) for _ in range(3))
        self._steps = 0
        parts = (torch.split(tensor, sizes) for tensor in (self._values, self._gradient))
        for parameter, *rooms in zip(self.parameters, *parts, strict=True):
            values, gradient = (room[: parameter.numel()].view_as(parameter) for room in rooms)
            parameter.data, parameter.grad = values.copy_(parameter.data), gradient

    def backward(self, gradients: Gradients) -> None:
        """Find the gradients by the parameters, of a loss of which those by some tensors are known."""
        self._gradient.zero_()
        tensors, by = map(list, zip(*gradients, strict=True))
        torch.autograd.backward(tensors, by)

    def step(self, rate: float) -> None:
        """Learn at a learning rate from the gradients that the parameters have."""
        self._steps += 1
        state = self._values, self._gradient, self._mean, self._square
        rates = rate / (1 - FADING**self._steps), 1 - FADING_SQUARES**self._steps
        if self._values.is_cuda:
            self._move(*state, *rates)
        else:
            _move(*(tensor.numpy() for tensor in state), *rates, self.epsilon, self.longest)

    def _move(
        self, values: Tensor, gradient: Tensor, mean: Tensor, square: Tensor, rate: float, known: float
    ) -> None:
        """Do what the function of that name does on a CPU."""
        gradient *= (self.longest / (gradient.norm() + 1e-6)).clamp(max=1)
        mean.lerp_(gradient, 1 - FADING)
        square.mul_(FADING_SQUARES).addcmul_(gradient, gradient, value=1 - FADING_SQUARES)
        values.addcdiv_(mean, square.div(known).sqrt_().add_(self.epsilon), value=-rate)

    def state_dict(self) -> dict[str, Any]:
        """Return all that later steps depend on, but for the parameters."""
        return {"mean": self._mean, "square": self._square, "steps": self._steps}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state_dict` returned."""
        copied("mean of gradients", self._mean, state["mean"])
        copied("mean of their squares", self._square, state["square"], least=0)
        self._steps = whole("number of steps", state["steps"])
