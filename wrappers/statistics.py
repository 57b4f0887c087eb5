"""Running normalisation of observations and rewards, as Gymnasium's vector wrappers do it."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space

from pearl_marl.devices import BatchStep

from .base import Array, Batch, Env, Mask, Transform, box, wrap


class _Moments:
    """Mean and variance of all rows seen, after Chan, Golub and LeVeque's formula for joining two sets."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.mean, self.variance = np.zeros(shape), np.ones(shape)
        self.count = np.full((), 1e-4)

    def update(self, rows: Array) -> None:
        if not len(rows):
            return
        mean, variance, count = rows.mean(0, np.float64), rows.var(0, np.float64), len(rows)
        total = self.count + count
        apart = mean - self.mean
        spread = self.variance * self.count + variance * count + apart**2 * self.count * count / total
        self.mean[...] += apart * count / total
        self.variance[...] = spread / total
        self.count[...] = total

    def arrays(self) -> dict[str, Array]:
        return {"mean": self.mean, "variance": self.variance, "count": self.count}


class _Normalised(Transform):
    """Keeps statistics, which can be frozen and carried to another environment."""

    updates = True

    def __init__(self, batch: Batch, space: Space[Any], action_space: Any, shape: tuple[int, ...]) -> None:
        super().__init__(batch, space, action_space)
        self.moments = _Moments(shape)
        self.memory = self.moments.arrays()

    def statistics(self) -> dict[str, Array]:
        """Return mean, variance and count, to be given to :meth:`set_statistics` elsewhere."""
        return {name: array.copy() for name, array in self.moments.arrays().items()}

    def set_statistics(self, statistics: dict[str, Array]) -> None:
        """Take up the statistics of another environment, for example those of training."""
        for name, array in self.moments.arrays().items():
            array[...] = statistics[name]


class _NormalisedObservation(_Normalised):
    def __init__(self, batch: Batch, space: Space[Any], action_space: Any, epsilon: float) -> None:
        old = box(space, "normalize_observation_v0")
        new = Box(-np.inf, np.inf, old.shape, np.float32)
        super().__init__(batch, new, action_space, old.shape)
        self._epsilon = epsilon

    def observe(self, obs: Array) -> Array:
        scale = np.sqrt(self.moments.variance + self._epsilon)
        return ((obs - self.moments.mean) / scale).astype(np.float32)

    def reset(self, obs: Array, seed: int | None, mask: Mask | None = None) -> Array:
        if self.updates:
            self.moments.update(obs if mask is None else obs[mask])
        return super().reset(obs, seed, mask)

    def results(self, step: BatchStep) -> BatchStep:
        if self.updates:
            self.moments.update(step.obs)
        return super().results(step)


class _NormalisedReward(_Normalised):
    def __init__(
        self, batch: Batch, space: Space[Any], action_space: Any, gamma: float, epsilon: float
    ) -> None:
        super().__init__(batch, space, action_space, ())
        self._gamma, self._epsilon = gamma, epsilon
        self._returns = np.zeros(self.n)
        self.memory["returns"] = self._returns

    def rewards(self, step: BatchStep) -> Array:
        self._returns[:] = self._returns * self._gamma * ~self._resetting + step.rewards
        if self.updates:
            self.moments.update(self._returns)
        return (step.rewards / np.sqrt(self.moments.variance + self._epsilon)).astype(np.float32)

    def episode_began(self, began: Mask) -> None:
        self._returns[began] = 0


def normalize_observation_v0(env: Env, epsilon: float = 1e-8) -> Any:
    """Shift and scale observations to mean 0 and variance 1, by the statistics of all seen so far.

    ``env.transform.updates = False`` freezes the statistics; ``env.transform.statistics()`` returns
    them and ``env.transform.set_statistics(...)`` takes them up, as for evaluation.
    """
    return wrap(
        env, lambda batch, space, actions: _NormalisedObservation(batch, space, actions, float(epsilon))
    )


def normalize_reward_v0(env: Env, gamma: float = 0.99, epsilon: float = 1e-8) -> Any:
    """Scale rewards so that their discounted sum has variance 1; see :func:`normalize_observation_v0`."""
    return wrap(
        env,
        lambda batch, space, actions: _NormalisedReward(batch, space, actions, float(gamma), float(epsilon)),
    )
