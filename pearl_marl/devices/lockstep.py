"""Two devices as one: every step on both, every word compared."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn, TypeVar

import numpy.typing as npt

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.rollout import Rollout
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.batch.step import BatchStep, Observed
from pearl_marl.checks import checked_count_or_none
from pearl_marl.devices.base import Device, Phase
from pearl_marl.devices.by_name import make_host_device
from pearl_marl.devices.divergence import (
    Divergence,
    WordComparison,
    result_words,
    rollout_words,
    seen_words,
    state_of,
    state_words,
)
from pearl_marl.devices.replay import Replay
from pearl_marl.errors import ArgumentError, LockstepError, PearlError
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.spec import EnvSpec

T = TypeVar("T")

SMALL = 4096
"""Up to so many slots the states are compared after every step."""

STEPS_BETWEEN_STATES = 16
"""Beyond that, after so many. Reading every slot's state back can cost a device more than the step."""


class Lockstep(Device):
    """A device, and another one that it must agree with; it is used as the device would be.

    Whatever both return is compared bit for bit, final observations where a slot ended. So are their
    states, after every ``state_every`` steps and at every reset, snapshot and restore. At the first
    difference the call raises :class:`~pearl_marl.errors.LockstepError`, and both devices are given the
    state that the reference had before the call.

    A rollout is one on both, of which sums and states are compared; where they differ, it is done again step
    by step. One that is recorded, or of so many episodes, is compared at every step.

    A state that went wrong between two comparisons is not reported late: the steps since the last
    one are taken again, with a comparison after each, to find the first that differs.

    Parameters
    ----------
    device
        The one to check: a name, or a configured device.
    reference
        What it is held against, likewise.
    state_every
        Steps from one comparison of the states to the next; ``None`` is 1 for up to 4,096 slots and
        16 beyond. The last steps are compared by calling :meth:`snapshot`.
    """

    def __init__(
        self, device: str | Device, reference: str | Device = "native", state_every: int | None = None
    ) -> None:
        self._asked = checked_count_or_none("state_every", state_every)
        self.device, self.reference = make_host_device(device), make_host_device(reference)
        if self.device is self.reference:
            raise ArgumentError("a device is not its own reference: lockstep takes two")
        self.name = f"lockstep of {self.device.name} and {self.reference.name}"
        self.words_compared: int = 0

    def recover(self) -> None:
        """Go on from the last call that succeeded on both devices; see :meth:`Device.recover`."""
        self.check_idle("recover")
        self.device.recover()
        self.reference.recover()
        if self._since is not None:
            self.reference.restore(self._since)
            for actions in self._taken[: self.tick - self._since.tick]:
                self.reference.step_words(actions)
            self._continue_from(self.reference.snapshot())

    def timed(self) -> dict[str, float]:
        """Time the device that is checked; see :meth:`Device.timed`."""
        self.check_idle("timed")
        return self.device.timed()

    @property
    def cycles(self) -> int | None:
        """Those of the device that is checked."""
        return self.device.cycles

    def _open(self, config: BatchConfig) -> None:
        self._every = self._asked or (1 if config.n_envs <= SMALL else STEPS_BETWEEN_STATES)
        # The state that both were last seen to share, and the actions of the steps since.
        self._since: SavedState | None = None
        self._taken: list[Array] = []
        self.device.open(config)
        try:
            self.reference.open(config)
        except BaseException:
            self.device.close()
            raise

    def _reset(self, mask: Array | None, seed: int | None) -> Observed:
        if self._since is not None:  # the first reset of all may have begun different episodes
            self._compare_states()
        copy = None if mask is None else mask.copy()
        return self._restart("reset", lambda device: device.reset(seed, mask), seed=seed, mask=copy)

    def _write(self, memory: Array, stored: Array) -> Observed:
        saved = self.saved(memory, stored)
        return self._restart("restore", lambda device: device.restore(saved), saved)

    def _restart(
        self, call: str, begin: Callable[[Device], Array], saved: SavedState | None = None, **arguments: Any
    ) -> Observed:
        """Reset both devices, or restore what was saved, and compare all there is."""
        previous = None if self._since is None else self.reference.snapshot()
        ours, theirs = self._both(
            lambda device: Observed(begin(device), device.action_masks, device.in_episode)
        )
        found = WordComparison()
        found.add(seen_words(self.config.spec, ours, theirs))
        self._add_states(found)
        self.words_compared += found.words
        if found:
            if previous is not None:
                self._continue_from(previous)
            raise self._error(call, found, saved or previous, tick=self.tick, **arguments)
        self._agreed()
        return ours

    def _step(self, actions: Array) -> BatchStep:
        ours, theirs = self._both(lambda device: device.step_words(actions))
        self._taken.append(actions.copy())
        found = WordComparison()
        found.add(result_words(self.config.spec, ours, theirs))
        if found or len(self._taken) >= self._every:
            self._add_states(found)
        self.words_compared += found.words
        if found:
            self._diverged(found, undo=1)
        if len(self._taken) >= self._every:
            self._agreed()
        return ours

    @property
    def has_engine(self) -> bool:  # type: ignore[override]
        """Whether the device that is checked has a policy engine."""
        return self.device.has_engine

    def check_engine(self, policy: DevicePolicy, steps: int) -> None:
        """See :meth:`Device.check_engine`."""
        self.device.check_engine(policy, steps)

    def _rollout_alone(
        self, policy: DevicePolicy, steps: int, record: bool, episodes: int | None
    ) -> Rollout | None:
        if record or episodes is not None:  # every step is compared then
            return None
        self._compare_states()
        before = self._since
        assert before is not None
        ours, found = self._roll_out(policy, steps)
        if found:
            self._continue_from(before)
            tick = before.tick
            for k in range(steps):  # the first step that differs, if any does by itself
                previous = self.reference.snapshot()
                _, alone = self._roll_out(policy, 1)
                if alone:
                    found, before, tick = alone, previous, tick + k
                    break
            self._continue_from(before)
            raise self._error("rollout", found, before, tick=tick)
        self.tick = self.device.tick
        self.action_masks, self.in_episode = self.device.action_masks, self.device.in_episode
        self._agreed()
        return ours

    def _roll_out(self, policy: DevicePolicy, steps: int) -> tuple[Rollout, WordComparison]:
        """Do a rollout on both; return the result, and how it and the states compare."""
        found = WordComparison()
        ours, theirs = self._both(lambda device: device.rollout(policy, steps))
        found.add(rollout_words(self.config.n_envs, ours, theirs))
        self._add_states(found)
        self.words_compared += found.words
        return ours, found

    def _read(self) -> tuple[Array, Array]:
        self._compare_states()
        saved = self.device.snapshot()
        return saved.memory, saved.stored

    def _close(self) -> None:
        self.device.close()
        self.reference.close()

    def _apply_rewards(self, table: npt.ArrayLike) -> None:
        self._change(lambda device: device.set_rewards(table))

    def _apply_limit(self, config: BatchConfig) -> None:
        self._change(lambda device: device.set_max_cycles(config.max_cycles))

    def _change(self, setting: Callable[[Device], None]) -> None:
        """Change what steps depend on; those taken before could not be taken again."""
        if self.phase is Phase.READY:
            self._compare_states()
        self._both(setting)
        if self.phase is Phase.READY:
            self._agreed()

    def _compare_states(self) -> None:
        found = WordComparison()
        self._add_states(found)
        self.words_compared += found.words
        if found:
            self._diverged(found, undo=0)
        self._agreed()

    def _agreed(self) -> None:
        self._since = self.reference.snapshot()
        self._taken = []

    def _add_states(self, found: WordComparison) -> None:
        saved = self.device.snapshot(), self.reference.snapshot()
        found.add(state_words(self.config.spec, self.config.n_envs, *saved))

    def _both(self, call: Callable[[Device], T]) -> tuple[T, T]:
        """Call both devices. Should one refuse, or Ctrl-C come between them, neither has moved."""
        ours = call(self.device)
        try:
            return ours, call(self.reference)
        except (PearlError, KeyboardInterrupt):
            if self.reference.phase is Phase.READY:
                self.device.restore(self.reference.snapshot())
            raise

    def _diverged(self, found: WordComparison, undo: int) -> NoReturn:
        """Find the first step that differs, take back the last ``undo`` steps, and raise."""
        since, taken = self._since, self._taken
        assert since is not None
        at = len(taken) - 1
        earlier = self._search(since, taken[:-1])
        if earlier is not None:
            at, found = earlier
        self.reference.restore(since)
        before = since
        for i, actions in enumerate(taken):
            if i == at:
                before = self.reference.snapshot()
            if i == len(taken) - undo:
                break
            self.reference.step_words(actions)
        self._continue_from(self.reference.snapshot())
        if not taken:
            raise self._error("snapshot", found, since, tick=since.tick)
        raise self._error("step", found, before, tick=before.tick, actions=taken[at])

    def _search(self, since: SavedState, taken: list[Array]) -> tuple[int, WordComparison] | None:
        """Take steps again, comparing the states after each; return the first that differs, if any does.

        A device that does not make the same mistake twice may differ in none.
        """
        if taken:
            self._both(lambda device: device.restore(since))
        for i, actions in enumerate(taken):
            for device in (self.device, self.reference):
                device.step_words(actions)
            found = WordComparison()
            self._add_states(found)
            if found:
                return i, found
        return None

    def _continue_from(self, saved: SavedState) -> None:
        self._both(lambda device: device.restore(saved))
        self._agreed()

    def _error(
        self, call: str, found: WordComparison, before: SavedState | None, tick: int, **arguments: Any
    ) -> LockstepError:
        spec, n = self.config.spec, self.config.n_envs
        i, count, differences = found.first()
        actions = arguments.get("actions")
        divergence = Divergence(
            environment=spec.id,
            device=self.device.name,
            reference=self.reference.name,
            call=call,
            step=tick,
            slot=self.config.first_slot + i,
            slots=count,
            differences=differences,
            state_before=None if before is None else state_of(spec, n, before, i),
            action=None if actions is None else _action_of(spec, actions, i),
        )
        return LockstepError(
            divergence, Replay(config=self.config, divergence=divergence, before=before, **arguments)
        )


def _action_of(spec: EnvSpec, actions: Array, slot: int) -> float | list[float]:
    """Return what a slot was told to do: a list where it has several agents, or actions several fields."""
    words = actions[slot * spec.agents : (slot + 1) * spec.agents].ravel()
    told = [field.value(word) for field, word in zip(spec.agents * spec.action_fields, words, strict=True)]
    return told[0] if len(told) == 1 else told
