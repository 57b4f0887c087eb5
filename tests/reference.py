"""What every device has to do, written for reading: golden functions over NumPy arrays, no kernel.

It shares with the package only the golden functions and the random draws; the order in which
slots step, end and begin again is written here a second time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Discrete
from gymnasium.vector import AutoresetMode

from pearl_marl import rng
from pearl_marl.devices import BatchConfig, BatchStep
from pearl_marl.golden import call_reference
from pearl_marl.spec import Field

Array = np.ndarray[Any, Any]


class Reference:
    """A batch of slots; call its methods as those of a device."""

    def __init__(self, config: BatchConfig, rewards: Any = None) -> None:
        self.spec, self.n = config.spec, config.n_envs
        self.next_step = config.autoreset_mode is AutoresetMode.NEXT_STEP
        self.limit = config.limit
        self.repeat = config.initial_states == "stored"
        self.slots = np.arange(config.first_slot, config.first_slot + self.n)
        self.table = self.spec.rewards if rewards is None else rewards
        self.tick = 0
        self.seed: tuple[int, int] | None = None
        self.words: list[Array] = []
        self.elapsed = np.zeros(self.n, np.int64)
        self.resets_next = np.zeros(self.n, bool)

    def reset(self, seed: int | None = None, mask: Array | None = None) -> Array:
        if seed is not None:
            self.seed, self.tick = rng.seed_words(seed), 0
        elif mask is None:
            self.tick += 1
        if mask is None:
            self.words = self._random_start(self.tick)
            self.first_words = [word.copy() for word in self.words]
            mask = np.ones(self.n, bool)
        else:
            self._begin(mask, self.tick)
        self.elapsed[mask] = 0
        self.resets_next[mask] = False
        return self._observe()

    def step(self, actions: Array) -> BatchStep:
        draws = self._draws(self.tick, self.spec.reset_draws, self.spec.step_draws)
        arguments = [*self.words, np.asarray(actions).astype(self.spec.action.dtype), *draws]
        *words, reward, terminated = call_reference(self.spec.golden.step, arguments)
        self.words = [self._word(w, f) for w, f in zip(words, self.spec.state, strict=True)]

        resetting = self.resets_next.copy()
        if resetting.any():
            self._begin(resetting, self.tick)
        self.elapsed = np.where(resetting, 0, self.elapsed + 1)
        rewards = np.where(resetting, np.float32(0), self._rewards(self._word(reward, self.spec.reward)))
        terminations = terminated.astype(bool) & ~resetting
        truncations = (self.elapsed >= self.limit) & ~resetting if self.limit else np.zeros(self.n, bool)
        ended = terminations | truncations
        obs = final_obs = self._observe()
        if self.next_step:
            self.resets_next = ended
        else:
            self._begin(ended, self.tick + 1)
            self.elapsed[ended] = 0
            obs = self._observe()
        self.tick += 1
        return BatchStep(obs, rewards, terminations, truncations, final_obs)

    def set_max_cycles(self, limit: int) -> None:
        if not self.limit:
            self.elapsed[:] = 0
        self.limit = limit

    def state(self) -> Array:
        return np.stack(
            [
                w.astype(np.float64) * 2.0**-f.fraction
                for w, f in zip(self.words, self.spec.state, strict=True)
            ],
            1,
        )

    def _begin(self, where: Array, tick: int) -> None:
        start = self.first_words if self.repeat else self._random_start(tick)
        self.words = [np.where(where, new, old) for new, old in zip(start, self.words, strict=True)]

    def _random_start(self, tick: int) -> list[Array]:
        words = call_reference(self.spec.golden.initial, self._draws(tick, 0, self.spec.reset_draws))
        return [self._word(w, f) for w, f in zip(words, self.spec.state, strict=True)]

    def _draws(self, tick: int, first: int, count: int) -> list[Array]:
        assert self.seed is not None
        return [rng.draws(self.seed, self.slots, tick, first + k) for k in range(count)]

    def _word(self, word: Any, field: Field) -> Array:
        """Give a word a row a slot, and hold the golden function to the width it promised."""
        array = np.broadcast_to(np.asarray(word), self.n).astype(field.dtype)
        low, high = field.low * 2**field.fraction, field.high * 2**field.fraction
        assert low <= array.min() <= array.max() <= high, f"{field} holds {array.min()} to {array.max()}"
        return array

    def _observe(self) -> Array:
        words = call_reference(self.spec.golden.observe, self.words)
        space = self.spec.observation_space
        values = [
            self._word(w, f).astype(space.dtype) * space.dtype.type(2.0**-f.fraction if f.fraction else 1)
            for w, f in zip(words, self.spec.observation, strict=True)
        ]
        return values[0] if isinstance(space, Discrete) else np.stack(values, 1)

    def _rewards(self, words: Array) -> Array:
        if self.table is not None:
            return np.asarray(self.table, np.float32)[words]
        return words.astype(np.float32) * np.float32(2.0**-self.spec.reward.fraction)


def assert_same_step(ours: BatchStep, theirs: BatchStep, where: str = "") -> None:
    """Compare everything that has a meaning, dtypes included."""
    ended = theirs.terminations | theirs.truncations
    for name in ("obs", "rewards", "terminations", "truncations"):
        mine, other = getattr(ours, name), getattr(theirs, name)
        assert mine.dtype == other.dtype, f"{where} {name}"
        np.testing.assert_array_equal(mine, other, f"{where} {name}")
    np.testing.assert_array_equal(ours.final_obs[ended], theirs.final_obs[ended], f"{where} final_obs")
