"""Running normalisation of observations and rewards, as Gymnasium's vector wrappers do it."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space

from pearl_marl.base.arrays import Array
from pearl_marl.batch.step import BatchStep
from pearl_marl.checks import checked_number
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.batch import Batch
from pearl_marl.interfaces.world import Mask

from . import kernels
from .base import Env, box, wrap
from .transform import Rows, Transform

_FARTHEST = 1e100
"""Statistics of no environment go so far; of a saved state that says so, their squares would be infinite."""


class _Normalised(Transform):
    """Keeps mean, variance and count of all that it saw, joined by Chan, Golub and LeVeque's formula."""

    updates = True

    def __init__(
        self, batch: Batch, space: Space[Any], action_space: Any, width: int, epsilon: float
    ) -> None:
        super().__init__(batch, space, action_space)
        self._epsilon = checked_number("epsilon", epsilon, above=0)
        self._mean, self._variance, self._count = np.zeros(width), np.ones(width), np.full((), 1e-4)
        self._statistics = {"mean": self._mean, "variance": self._variance, "count": self._count}
        self.memory = dict(self._statistics)

    def is_possible(self, name: str, saved: dict[str, Array]) -> bool:
        least = {"variance": 0.0, "count": np.finfo(np.float64).tiny}.get(name, -_FARTHEST)
        return bool(((saved[name] >= least) & (saved[name] <= _FARTHEST)).all())

    def deviation(self) -> Array:
        """Return what to divide by."""
        return np.sqrt(self._variance + self._epsilon)

    def update(self, rows: Array, counted: Mask) -> None:
        """Add the rows that count to the statistics, if they are not frozen."""
        if not self.updates:
            return
        mean, variance = np.empty_like(self._mean), np.empty_like(self._mean)
        count = kernels.moments(rows.reshape(self.n, -1), counted, mean, variance)
        total = self._count + count
        difference = mean - self._mean
        spread = self._variance * self._count + variance * count + difference**2 * self._count * count / total
        self._mean += difference * count / total
        self._variance[:] = spread / total
        self._count[...] = total

    def statistics(self) -> dict[str, Array]:
        """Return mean, variance and count, to be given to :meth:`set_statistics` elsewhere."""
        return {name: array.copy() for name, array in self._statistics.items()}

    def set_statistics(self, statistics: dict[str, Array]) -> None:
        """Take up the statistics of another environment, for example those of training."""
        for name, array in self._statistics.items():
            if name not in statistics or np.shape(statistics[name]) != array.shape:
                raise ArgumentError(f"the statistics have no {name!r} of shape {array.shape}")
        for name, array in self._statistics.items():
            array[...] = statistics[name]


class _NormalisedObservation(_Normalised):
    def __init__(self, batch: Batch, space: Space[Any], action_space: Any, epsilon: float) -> None:
        old = box(space, "normalize_observation_v0")
        new = Box(-np.inf, np.inf, old.shape, np.float32)
        super().__init__(batch, new, action_space, int(np.prod(old.shape)), epsilon)

    def reset(self, obs: Array, seed: int | None, mask: Mask | None = None) -> Array:
        self.update(obs, np.ones(self.n, np.bool_) if mask is None else self.world.rows(mask))
        return super().reset(obs, seed, mask)

    def results(self, step: BatchStep) -> BatchStep:
        # What is counted is what is seen; the ends of episodes are not where the next begins at once.
        if self.batch.autoreset:
            self.update(step.obs, self.batch.in_episode)
        else:
            self.update(step.arrivals(), self.acting)
        return super().results(step)

    def observe(self, obs: Array) -> Array:
        out = self.new.empty(obs.shape, np.float32)
        rows = obs.reshape(self.n, -1), out.reshape(self.n, -1)
        kernels.standardised(rows[0], self._mean, self.deviation(), rows[1])
        return out


class _NormalisedReward(_Normalised):
    def __init__(
        self, batch: Batch, space: Space[Any], action_space: Any, gamma: float, epsilon: float
    ) -> None:
        super().__init__(batch, space, action_space, 1, epsilon)
        self._gamma = checked_number("gamma", gamma, 0, 1)
        self._returns = np.zeros(self.n)
        self.memory["returns"] = self._returns

    def rewards(self, step: BatchStep) -> Array:
        counted = self.acting & ~self.resetting
        kernels.discounted(self._returns, step.rewards, step.terminations, counted, self._gamma)
        self.update(self._returns, counted)
        return (step.rewards / self.deviation()).astype(np.float32)

    def episode_began(self, rows: Rows) -> None:
        self._returns[rows] = 0


def normalize_observation_v0(env: Env, epsilon: float = 1e-8) -> Any:
    """Shift and scale observations to mean 0 and variance 1, by the statistics of all seen so far.

    ``env.transform.updates = False`` freezes the statistics; ``env.transform.statistics()`` returns
    them and ``env.transform.set_statistics(...)`` takes them up, as for evaluation.
    """
    return wrap(env, _NormalisedObservation, epsilon)


def normalize_reward_v0(env: Env, gamma: float = 0.99, epsilon: float = 1e-8) -> Any:
    """Scale rewards so that their discounted sum has variance 1; see :func:`normalize_observation_v0`.

    As in Gymnasium, where an episode terminates the sum is that last reward alone.
    """
    return wrap(env, _NormalisedReward, gamma, epsilon)
