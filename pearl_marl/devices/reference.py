"""The golden functions as a device: Python itself runs them, one slot after the other; written to be read.

It is what every other device is compared with. So it shares with them no more than the golden functions
and ``unpack`` as their author wrote them, the random draws, the table of rewards, the layout of a saved
state, and the code that checks and encodes actions for all devices. It states a second time in which order
slots step, end and begin again, and uses neither Numba nor any code that is generated for kernels.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.results import ResultArrays
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.batch.step import BatchStep, Observed
from pearl_marl.devices.base import Device
from pearl_marl.errors import DeviceError
from pearl_marl.golden import GoldenFunction, reference, rng
from pearl_marl.spec import TERMINATED, EnvSpec, Field


class Reference(Device):
    """The golden functions themselves, some thousand times slower than :class:`Native`.

    It also holds them to the widths that the spec promises: a word that does not fit its field
    raises :class:`~pearl_marl.errors.DeviceError`, where hardware would lose the upper bits.
    """

    name = "reference"

    def _open(self, config: BatchConfig) -> None:
        self._call = functools.cache(reference)
        self._next_step = config.autoreset_mode is AutoresetMode.NEXT_STEP
        self._slots = np.arange(config.first_slot, config.first_slot + config.n_envs)
        self._results = ResultArrays(config)
        self._memory = SlotMemory(config.spec, config.n_envs)
        self._stored: SlotMemory | None = None
        if config.initial_states == "stored":
            self._stored = SlotMemory(config.spec, config.n_envs)

    def _reset(self, mask: Array | None, seed: int | None) -> Observed:
        memory = self._memory
        if mask is None:
            self._put(self._random_start(self.tick, np.ones(len(self._slots), np.bool_)))
            memory.elapsed[:] = memory.ended[:] = 0
            if self._stored is not None:
                self._stored.bytes[:] = memory.bytes
        else:
            self._put(_chosen(mask, self._start(self.tick, mask), memory.state))
            memory.elapsed[mask] = memory.ended[mask] = 0
        return self._see(self._results.take(), memory.state, memory.ended_early)

    def _step(self, actions: Array) -> BatchStep:
        config, memory = self.config, self._memory
        spec, limit = config.spec, config.limit
        draws = self._draws(self.tick, spec.reset_draws, spec.step_draws)
        fields = (*spec.state, *spec.each_agent(spec.reward), *spec.each_agent(TERMINATED))
        by_agent = actions.reshape(config.n_envs, -1).T
        words = self._words(spec.positional.step, [*memory.state, *by_agent, *draws], fields)
        state, outcome = words[: len(spec.state)], words[len(spec.state) :]
        reward, terminated = np.stack(outcome[: spec.agents], 1), np.stack(outcome[spec.agents :], 1)

        # NEXT_STEP: a slot that ended has run on unseen, and begins now instead.
        resetting = (memory.ended & 1).astype(np.bool_)
        # Agents that have ended while their world goes on have no part in it any more.
        idle = memory.ended_early | resetting[:, None]
        if resetting.any():
            state = _chosen(resetting, self._start(self.tick, resetting), state)
        elapsed = np.where(resetting, 0, memory.elapsed + 1) if limit else memory.elapsed
        terminations = terminated.astype(np.bool_) & ~idle
        late = (elapsed >= limit if limit else np.zeros_like(resetting)) & ~resetting
        over = memory.ended_early | terminations
        ended = over.all(1) | late
        over[ended] = False
        results = self._results.take()
        final_obs = self._observe(state)
        self._see(results, state, over, final_obs)
        # SAME_STEP: it begins at once, with the draws of the next step.
        if not self._next_step and ended.any():
            state = _chosen(ended, self._start(rng.following(self.tick), ended), state)
            elapsed = np.where(ended, 0, elapsed)
            self._see(results, state, over)

        # Every golden function has been called: from here on nothing can be refused any more.
        truncations = late[:, None] & ~idle
        self._put(state)
        memory.elapsed[:] = elapsed
        memory.ended[:] = ended & self._next_step
        for k in range(spec.agents):
            memory.ended[over[:, k]] |= memory.ended.dtype.type(1 << 1 + k)
        results.final_obs[...] = final_obs
        results.rewards[:] = np.where(idle, np.float32(0), self._reward_values(reward)).ravel()
        results.terminations[:] = terminations.ravel()
        results.truncations[:] = truncations.ravel()
        return results

    def _read(self) -> tuple[Array, Array]:
        memory = self._memory.bytes
        return memory, memory[:0] if self._stored is None else self._stored.bytes

    def _write(self, memory: Array, stored: Array) -> Observed:
        self._memory.bytes[:] = memory
        if self._stored is not None:
            self._stored.bytes[:] = stored
        return self._see(self._results.take(), self._memory.state, self._memory.ended_early)

    def _close(self) -> None:
        """Nothing is held but memory."""

    def _put(self, state: list[Array]) -> None:
        for column, words in zip(self._memory.state, state, strict=True):
            column[:] = words

    def _start(self, tick: int, slots: Array) -> list[Array]:
        """Return what the next episode of some slots begins from, if it begins at ``tick``; others hold 0."""
        return self._random_start(tick, slots) if self._stored is None else self._stored.state

    def _random_start(self, tick: int, slots: Array) -> list[Array]:
        spec = self.config.spec
        columns = [np.zeros(len(self._slots), f.dtype) for f in spec.state]
        if slots.any():
            draws = self._draws(tick, 0, spec.reset_draws, slots)
            start = self._words(spec.positional.initial, draws, spec.state)
            for column, words in zip(columns, start, strict=True):
                column[slots] = words if draws else words[slots]
        return columns

    def _draws(self, tick: int, first: int, count: int, slots: Any = slice(None)) -> list[Array]:
        return [rng.draws(self.seed, self._slots[slots], tick, first + k) for k in range(count)]

    def _words(
        self, function: GoldenFunction, arguments: list[Array], fields: tuple[Field, ...], *agent: int
    ) -> list[Array]:
        """Call a golden function; return a row a slot of each word, in its field's dtype."""
        words = []
        for word, field in zip(self._call(function, *agent)(*arguments), fields, strict=True):
            word = np.asarray(word)
            low, high = field.range
            for value in (int(word.min()), int(word.max())):
                if not low <= value <= high:
                    raise DeviceError(
                        f"reference: the golden functions of {self.config.spec.name} gave {field.name} = "
                        f"{value}, and {'signed ' if field.signed else ''}{field.bits} bits hold "
                        f"{low} to {high}; fix {function.__name__}() or widen the field in the spec"
                    )
            # Without arguments a golden function gives scalars.
            shape = arguments[0].shape if arguments else (self.config.n_envs,)
            words.append(np.broadcast_to(word, shape).astype(field.dtype))
        return words

    def _see(
        self, results: BatchStep, state: list[Array], over: Array, observed: Array | None = None
    ) -> Observed:
        """Write what agents see in a state, and which are in an episode; the others see zeros."""
        spec, rows = self.config.spec, over.ravel()
        results.obs[...] = self._observe(state) if observed is None else observed
        results.obs[rows] = 0
        if spec.positional.masks is not None:
            assert results.action_masks is not None
            by_agent = [
                np.stack(self._words(spec.positional.masks, state, spec.mask_fields, *agent), -1)
                for agent in spec.views
            ]
            results.action_masks[...] = np.stack(by_agent, 1).reshape(len(rows), -1)
            results.action_masks[rows] = 0
        if spec.agents > 1:
            results.in_episode[...] = ~rows
        return results.observed

    def _look(self, form: EnvSpec) -> Observed:
        obs = self._observe(self._memory.state, form)
        obs[self._memory.ended_early.ravel()] = 0
        return Observed(obs.reshape(len(obs), -1), self.action_masks, self.in_episode)

    def _observe(self, state: list[Array], form: EnvSpec | None = None) -> Array:
        """Return the observations of all agents, as ``form`` has them, one world after the other."""
        spec = self.config.spec
        form = form or spec
        by_agent = [
            observations_of(form, self._words(spec.positional.observe, state, spec.observation, *agent))
            for agent in spec.views
        ]
        return np.stack(by_agent, 1).reshape(-1, *form.observation_shape)

    def _reward_values(self, words: Array) -> Array:
        if self.config.spec.rewards is not None:
            return self.reward_table[words]
        return words.astype(np.float32) * np.float32(2.0**-self.config.spec.reward.fraction)


def observations_of(spec: EnvSpec, words: list[Array]) -> Array:
    """Return the observations that words stand for, shape ``(n, *spec.observation_shape)``.

    ``words`` are arrays of shape ``(n,)``, one for each field. Plain Python writes planes.
    """
    dtype: Any = spec.observation_dtype
    unpack = spec.plain_unpack
    if unpack is None:
        rows = [
            word.astype(dtype) * dtype.type(2.0**-f.fraction) if f.fraction else word.astype(dtype)
            for word, f in zip(words, spec.observation, strict=True)
        ]
        return np.stack(rows, -1).reshape(-1, *spec.observation_shape)
    numbers = zip(*(column.tolist() for column in words), strict=True)
    rows = [_row(unpack, row, spec.observation_size, dtype) for row in numbers]
    return np.stack(rows).reshape(-1, *spec.observation_shape)


@functools.lru_cache(1 << 14)
def _row(unpack: GoldenFunction, words: tuple[int, ...], size: int, dtype: np.dtype[Any]) -> Array:
    """Return one observation, unpacked by Python itself, which takes it some 0.1 ms; not to be written to."""
    row = np.empty(size, dtype)
    unpack(*words, row)
    return row


def _chosen(where: Array, new: list[Array], old: list[Array]) -> list[Array]:
    return [np.where(where, a, b) for a, b in zip(new, old, strict=True)]
