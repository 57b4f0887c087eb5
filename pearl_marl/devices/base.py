"""What every device is: an array of actions in, arrays of results out.

::

    NEW --open()--> OPEN --reset()--> READY <--send(), recv()--> STEPPING
                                      |   ^
              a call fails under way  |   |  reset(), restore(), recover()
                                      v   |
                                     FAILED             from any: --close()--> CLOSED

:class:`Device` does what all devices share; a subclass moves the slots.
"""

from __future__ import annotations

import enum
import secrets
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.base.deferral import uninterrupted
from pearl_marl.batch import rewards as reward_tables
from pearl_marl.batch.actions import ActionRules, encode, refuse_masked, room_for_words
from pearl_marl.batch.config import BatchConfig, checked_mask
from pearl_marl.batch.results import Recycler, ResultLayout
from pearl_marl.batch.rollout import Experience, Rollout
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.batch.step import BatchStep, Observed, on_host
from pearl_marl.devices import rollouts
from pearl_marl.devices.recovery import CheckpointLog
from pearl_marl.devices.threads import Threads
from pearl_marl.errors import ActionError, ArgumentError, DeviceError, OrderError, renamed
from pearl_marl.golden import rng
from pearl_marl.policies.dense_policy import DenseNetwork
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.spec import EnvSpec

CACHE_BYTES = 1 << 18
"""Results of which two sets may be in use in turns, and still be in a core's second cache."""


class Phase(enum.Enum):
    """What can be done with a device: see :attr:`Device.phase`."""

    NEW = enum.auto()
    """It has no batch yet: :meth:`Device.open` gives it one."""
    OPEN = enum.auto()
    """It has a batch, and no reset has succeeded."""
    READY = enum.auto()
    """It can step."""
    STEPPING = enum.auto()
    """A step is under way, between :meth:`Device.send` and :meth:`Device.recv`."""
    FAILED = enum.auto()
    """A call failed under way, so the state of the slots is unknown; :meth:`Device.recover` goes on."""
    CLOSED = enum.auto()
    """It has released everything, and takes no call but :meth:`Device.close`."""


READY = Phase.READY
"""For every step: an enum's members are looked up slowly."""


class Position(NamedTuple):
    """What a device knows of its batch besides the slots: where a refused or failed call goes back to."""

    config: BatchConfig
    seed: tuple[int, int]
    tick: int
    reward_table: npt.NDArray[np.float32]
    phase: Phase


class Device(ABC):
    """A place where slots are stepped. Usable on its own, or given to an environment as ``device=``.

    One object serves one batch: :meth:`open` it once, :meth:`close` it at the end. It is not to be
    used from two threads at the same time.

    Attributes
    ----------
    phase
        What can be done with it now: see :class:`Phase`.
    config
        The batch that it was opened for.
    seed, tick
        The position in the random numbers: see :mod:`pearl_marl.golden.rng`.
    reward_table
        The reward of every word of the reward field.
    action_masks
        Which actions may be taken in the next step, ``int8`` of shape ``(n, n_actions)``, from the first
        reset on; ``None`` where the environment has no masks. See :class:`BatchStep`.
    in_episode
        Which agents take part in it, ``bool`` of shape ``(n,)``.
    made_with
        The attributes that it had before it was opened, which are the settings of a copy.
    """

    name: str
    """As users write it, for example ``"native"``."""

    tensors = False
    """Whether results are tensors on a GPU rather than NumPy arrays."""

    words_compared: int | None = None
    """How many words have been compared with another device's; ``None`` where none are."""

    checkpoint_every: int | None = None
    """Steps between two states that are kept for :meth:`recover`; ``None`` keeps nothing."""

    has_engine = False
    """Whether it has a policy engine: then a rollout is one call of the hardware, and sums come back."""

    recovery_type: type[CheckpointLog] | None = None
    """What keeps them; ``None`` where nothing can fail under way."""

    recovery: CheckpointLog | None = None
    """One of these, from :meth:`open` on."""

    refuses = True
    """Whether masked actions are refused where the spec says so. Tests of devices take any action."""

    phase = Phase.NEW

    action_masks: Array | None = None
    in_episode: Array
    alive = renamed("alive", "in_episode")
    action_rules: ActionRules

    config: BatchConfig

    _sent: tuple[Any, Future[BatchStep]] | None = None
    """The words of the step under way, and what will have its results, also after :meth:`close`."""

    stage_seconds: dict[str, float] | None = None
    """Where each step writes how long its stages took, if steps are timed."""

    def open(self, config: BatchConfig, rewards: npt.ArrayLike | None = None) -> Self:
        """Take up a batch of slots; ``rewards`` replaces its reward table, as :meth:`set_rewards` does.

        Raises
        ------
        OrderError
            This device has been opened before.
        DeviceError
            The device is not available.
        """
        if self.phase is not Phase.NEW:
            raise OrderError(f"this {self.name} device has been opened before; make another one")
        if not isinstance(config, BatchConfig):
            raise ArgumentError(f"open() takes a BatchConfig, not {config!r}")
        self.made_with = dict(self.__dict__)
        table = reward_tables.reward_table(config.spec, config.spec.rewards if rewards is None else rewards)
        self._open(config)
        self.config = config
        self.reward_table = table
        self.seed = (0, 0)
        self.tick = 0
        self.action_rules = ActionRules.of(
            config.spec, config.spec.action_space, config.n_agents, config.first_slot
        )
        self._actions = room_for_words(config.spec, config.n_agents)
        self.in_episode = np.ones(config.n_agents, np.bool_)
        # Of one agent without masks nothing has to be remembered from one step to the next.
        self.remembers = config.spec.agents > 1 or bool(config.spec.mask_fields)
        large = config.copy and self.remembers and ResultLayout(config).size > CACHE_BYTES
        self._copies = Recycler() if large else None
        self._thread = Threads(1, f"pearl-{self.name}")
        # Every step asks for these two, and finds them faster here than on the class.
        self.stage_seconds = None
        self.recovery = None if self.recovery_type is None else self.recovery_type(self.checkpoint_every)
        self.phase = Phase.OPEN
        if rewards is not None:
            try:
                self._apply_rewards(rewards)
            except BaseException:
                self.close()
                raise
        return self

    @uninterrupted
    def reset(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """Begin new episodes and return every agent's observation.

        Parameters
        ----------
        seed
            A non-negative integer of any size. ``None`` goes on with the random numbers in use, or
            takes fresh ones from the operating system at the first reset.
        mask
            ``bool`` of shape ``(n,)``: the slots to reset, ``None`` for all. A slot that has not
            stepped since its episode began keeps its initial state.

        Raises
        ------
        ArgumentError
            The seed or the mask is not one.
        OrderError
            A mask at the first reset, or the device is closed or busy.
        """
        self.check_idle("reset")
        chosen = None if mask is None else checked_mask(mask, self.config.n_envs)
        if chosen is not None and seed is not None:
            raise ArgumentError("a seed restarts every slot, so it cannot come with a reset mask")
        if chosen is not None and self.phase is Phase.OPEN:
            raise OrderError("the first reset starts every slot: call reset() without a mask first")
        if chosen is not None:
            self.check_not_failed()
        if seed is not None:
            seed = rng.checked_seed(seed)
        elif self.phase is Phase.OPEN:
            seed = secrets.randbits(64)
        words = None if seed is None else rng.seed_words(seed)
        with self._noted("reset", seed, chosen):
            if words is not None:
                self.seed, self.tick = words, 0
            elif chosen is None:
                self.tick = rng.following(self.tick)  # or every reset would begin the same episodes
            observed = self._reset(chosen, seed)
            self.phase = Phase.READY
            return self._remember(observed)

    @uninterrupted
    def step(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once.

        Parameters
        ----------
        actions
            Of shape ``(n_agents, *action_space.shape)``, each in the action space.

        Raises
        ------
        ActionError
            Names the first agent whose action is not in the action space, or is masked in an environment that
            refuses such actions. No slot has stepped.
        OrderError
            Before the first reset, after ``close``, or between ``send`` and ``recv``.
        """
        if self.phase is not READY:
            self.check_idle("step", ready=True)
        return self._take(self.encoded(actions))

    @uninterrupted
    def step_words(self, words: Array) -> BatchStep:
        """Step every slot once by its actions' words, as ``room_for_words`` has room for them; unchecked."""
        if self.phase is not READY:
            self.check_idle("step_words", ready=True)
        return self._take(words)

    def _take(self, words: Array) -> BatchStep:
        tick = self.tick
        if self.recovery is not None:
            self.recovery.before(self, "step_words")
        try:
            result = self._step(words) if self.stage_seconds is None else self._timed_step(words)
        except BaseException:
            self._step_failed()
            raise
        return self._stepped(words, tick, result)

    @uninterrupted
    def send(self, actions: npt.ArrayLike) -> None:
        """Start a step and return at once; :meth:`recv` has its results. Raises as :meth:`step` does."""
        self.check_idle("send", ready=True)
        words = self.encoded(actions)
        if self.recovery is not None:
            self.recovery.before(self, "step_words")
        self._sent_at = self.tick
        self._sent = self._begin(words)
        self.phase = Phase.STEPPING

    @uninterrupted
    def recv(self) -> BatchStep:
        """Wait for the step that :meth:`send` started and return its results."""
        if self._sent is None:
            raise OrderError("recv() without a step under way: call send() first")
        words, step = self._sent
        try:
            result = step.result()
        except BaseException:
            if step.done():  # or Ctrl-C came first, and the step is still under way
                self._sent = None
                self._step_failed()
            raise
        self._sent = None
        if self.phase is Phase.STEPPING:  # a device that was closed meanwhile stays so
            self.phase = Phase.READY
        return self._stepped(words, self._sent_at, result)

    def _stepped(self, words: Array, tick: int, result: BatchStep) -> BatchStep:
        """Take note of a step from ``tick`` on that has succeeded; return its results."""
        if self.recovery is not None:
            self._note("step_words", words)
        self.tick = (tick + 1) & rng.LAST_TICK
        if self.remembers:
            self._remember(result)
        return result

    def _step_failed(self) -> None:
        if self.phase is not Phase.CLOSED:
            self.phase = Phase.FAILED if self._may_have_moved() else Phase.READY

    def encoded(self, actions: Any) -> Array:
        """Return actions as :meth:`step_words` takes them, in an array of the device's or the given one."""
        try:
            return self._encoded(actions)
        except ActionError:
            if self.config.autoreset_mode is not AutoresetMode.NEXT_STEP:
                raise
        # What a slot is given for a step that it spends resetting is ignored, whatever it is.
        return self._encoded(self.action_rules.with_idle(actions, self.resetting(), self.action_masks))

    def resetting(self) -> Array:
        """Return which agents' worlds spend the next step on their reset."""
        ended = SlotMemory(self.config.spec, self.config.n_envs, self._read()[0]).ended
        resetting: Array = (ended & 1).astype(np.bool_).repeat(self.config.spec.agents)
        return resetting

    def _encoded(self, actions: Any) -> Array:
        spec, first = self.config.spec, self.config.first_slot
        words = encode(actions, spec, self._actions, first)
        if spec.masked == "refused" and self.refuses:
            agents = spec.agents if spec.turns else 1
            refuse_masked(words, on_host(self.action_masks), first * spec.agents, agents)
        return words

    def _remember(self, observed: Observed | BatchStep) -> Array:
        """Keep what the next step goes by; return the observations."""
        obs, self.action_masks, self.in_episode = observed.obs, observed.action_masks, observed.in_episode
        if self._copies is not None and isinstance(obs, np.ndarray):
            # To refer to results would keep all the memory that they lie in from being used for the next.
            self.in_episode = self._copies.copy(self.in_episode)
            if self.action_masks is not None:
                self.action_masks = self._copies.copy(self.action_masks)
        return obs

    def rollout(
        self, policy: DevicePolicy, steps: int, record: bool = False, episodes: int | None = None
    ) -> Rollout:
        """Step every slot so many times, with the actions of a policy; return what came of it.

        Afterwards everything is as after single steps with these actions. If the call fails, or Ctrl-C ends
        it, the device is as before; but hardware that rolls out by itself has failed then: call
        :meth:`recover`.

        Parameters
        ----------
        policy
            One for this environment: see :class:`pearl_marl.policies.device_policy.DevicePolicy`.
        steps
            How many, at least 1.
        record
            Whether to return every step, too, and not only the sums of episodes.
        episodes
            How many episodes of each agent count, its first; all, if not given.

        Raises
        ------
        ArgumentError
            The policy is none, or is for another environment, or a number is impossible.
        OrderError
            As :meth:`step` does.
        """
        self.check_idle("rollout", ready=True)
        rollouts.check(self.config, policy, steps, record, episodes)
        with self._noted("rollout", policy, steps):
            alone = self._rollout_alone(policy, steps, record, episodes)
            if alone is not None:
                return alone
            with self._undone_if_it_fails():
                result, observed = self._rollout(policy, steps, record, episodes)
            self._remember(observed)
            return result

    @property
    def runs_networks(self) -> bool:
        """Whether it can run a network of floats beside its environments: see :meth:`experience`."""
        return False

    def experience(self, network: DenseNetwork, noise: Array) -> Experience:
        """Do a rollout for a learner, on a device that ``runs_networks``; see :meth:`rollout`.

        Its actions are those of the greatest outputs of a network, with noise added. Slots that end start
        again in the same step.

        Parameters
        ----------
        network
            One for this environment, whose observations take no ``unpack``.
        noise
            ``float32`` of shape ``(steps, n_agents, outputs)``, in C order.

        Raises
        ------
        ArgumentError
            The device runs no networks, the network is for another environment, or the noise is not as above.
        OrderError
            As :meth:`step` does.
        """
        self.check_idle("experience", ready=True)
        if not self.runs_networks:
            raise ArgumentError(f"the {self.name} device runs no networks of floats; native does")
        rollouts.check_experience(self.config, network, noise)
        with self._undone_if_it_fails():
            record, observed = self._experience(network, noise)
            last = self._remember(observed)
            return record.experience(self.config, observed._replace(obs=last))

    def _experience(self, network: DenseNetwork, noise: Array) -> tuple[rollouts.Record, Observed]:
        """Do the steps, as a device that ``runs_networks``; return the record, and what is observed last."""
        raise NotImplementedError

    @contextmanager
    def _undone_if_it_fails(self) -> Iterator[None]:
        """Put slots, seed and tick back where they were if what is done meanwhile fails."""
        saved = self.snapshot()
        try:
            yield
        except BaseException:
            if self.phase is not Phase.FAILED:
                self.seed, self.tick = saved.seed, saved.tick
                self._remember(self._write(saved.memory, saved.stored))
            raise

    def shown_to(self, policy: DevicePolicy) -> Observed:
        """Return what a policy is shown now: observations of shape ``(n_agents, elements)``."""
        return self._look(policy.form(self.config.spec))

    def _look(self, form: EnvSpec) -> Observed:
        """Return what agents are shown now, with observations as ``form`` has them, a row an agent."""
        return rollouts.look(self.config, form, self._read()[0])

    def check_engine(self, policy: DevicePolicy, steps: int) -> None:  # noqa: B027, most have none
        """Refuse a rollout that a policy engine of the device does not take."""

    def _rollout_alone(
        self, policy: DevicePolicy, steps: int, record: bool, episodes: int | None
    ) -> Rollout | None:
        """Do a rollout of which the host sees sums only; return ``None`` where there is no such way."""
        return None

    def _rollout(
        self, policy: DevicePolicy, steps: int, record: bool, episodes: int | None
    ) -> tuple[Rollout, Observed]:
        """Do a rollout, by single steps unless there is a faster way; return also what is observed last."""
        config, spec = self.config, self.config.spec
        form, recorded = policy.form(spec), rollouts.recorded_form(spec)
        elapsed = SlotMemory(spec, config.n_envs, self._read()[0]).elapsed.repeat(spec.agents)
        sums = rollouts.Sums.of(elapsed, self._look(form).in_episode, self.resetting(), episodes)
        kept = rollouts.Record.of(config, steps, policy.logits) if record else None
        next_step = config.autoreset_mode is AutoresetMode.NEXT_STEP
        room = room_for_words(spec, config.n_agents)
        for t in range(steps):
            seen = self._look(form)
            obs = seen.obs if recorded is form or kept is None else self._look(recorded).obs
            choice = rollouts.chosen(config, policy, seen, self.seed, self.tick)
            room.reshape(choice.words.shape)[:] = choice.words
            result = self._advance(room).on_host()
            sums.add(result, next_step)
            if kept is not None:
                kept.observations[t], kept.words[t] = obs, choice.words
                if seen.action_masks is not None:
                    kept.masks[t] = seen.action_masks
                kept.rewards[t], kept.terminations[t] = result.rewards, result.terminations
                kept.truncations[t] = result.truncations
                if choice.logits is not None:
                    kept.logits[t] = choice.logits
        return sums.result(steps, {} if kept is None else kept.arrays(config)), result.observed

    @uninterrupted
    def _advance(self, words: Array) -> BatchStep:
        """Do a step that is not noted for :meth:`recover`."""
        tick = self.tick
        try:
            result = self._step(words)
        except BaseException:
            self._step_failed()
            raise
        self.tick = (tick + 1) & rng.LAST_TICK
        if self.remembers:
            self._remember(result)
        return result

    @uninterrupted
    def set_rewards(self, table: npt.ArrayLike) -> None:
        """Replace the reward table, from the next step on: a finite number for each reward category."""
        self.check_idle("set_rewards")
        padded = reward_tables.reward_table(self.config.spec, table)
        with self._noted("set_rewards", np.array(table)):
            self._apply_rewards(table)
            self.reward_table = padded

    @property
    def rewards(self) -> Array:
        """The reward table in use, ``float32``; empty where rewards are not categories."""
        self.check_idle("rewards")
        return self.reward_table[: len(self.config.spec.rewards or ())].copy()

    @property
    def cycles(self) -> int | None:
        """Clock cycles that the last step took in the hardware; ``None`` where there is none."""
        return None

    @uninterrupted
    def state(self) -> Array:
        """Return every slot's state, shape ``(n, fields)``: what the next step starts from.

        Integers in the narrowest dtype that holds all fields, or ``float64`` values where a field
        has a fraction.
        """
        self.check_idle("state", ready=True)
        return SlotMemory(self.config.spec, self.config.n_envs, self._read()[0]).values()

    @uninterrupted
    def snapshot(self) -> SavedState:
        """Return all that the continuation depends on; :meth:`restore` of any device takes it."""
        return self.shared_snapshot().copy()

    @uninterrupted
    def shared_snapshot(self) -> SavedState:
        """Return the same in memory that the next step may change, to be written down before it."""
        self.check_idle("snapshot", ready=True)
        return self.saved(*self._read())

    def saved(self, memory: Array, stored: Array) -> SavedState:
        """Return slots' memory and stored initial states as a state saved now."""
        return SavedState(
            identity=self.config.identity(),
            seed=self.seed,
            tick=self.tick,
            rewards=tuple(self.rewards.tolist()),
            memory=memory,
            stored=stored,
            present=memory[:0],
        )

    @uninterrupted
    def restore(self, saved: SavedState) -> Array:
        """Continue from a snapshot of a batch like this one; return every agent's observation.

        A snapshot of another one raises SavedStateError, which names what differs. Nothing has changed then.
        """
        self.check_idle("restore")
        saved.check(self.config)
        with self._noted("restore", saved):
            self.seed, self.tick = saved.seed, saved.tick
            self.reward_table = reward_tables.padded(self.config.spec, saved.rewards)
            observed = self._write(saved.memory, saved.stored)
            self.phase = Phase.READY
            return self._remember(observed)

    @uninterrupted
    def put(self, start: Mapping[str, Array], mask: npt.ArrayLike | None = None) -> Array:
        """Set fields of states, in the masked slots or all; return every agent's observation.

        ``start`` is what :func:`pearl_marl.batch.starts.checked_start` returns. Where slots replay stored
        initial states, these are set, too.
        """
        saved = self.snapshot()
        where = slice(None) if mask is None else np.asarray(mask)
        for slots in (saved.memory, saved.stored):
            if slots.size:
                columns = SlotMemory(self.config.spec, self.config.n_envs, slots).columns
                for name, words in start.items():
                    columns[name][where] = words[where]
        return self.restore(saved)

    @uninterrupted
    def recover(self) -> None:
        """Go on from the last call that succeeded, after one that raised DeviceError.

        The connection is made anew, and the state and every call since are as they were; the call that
        failed may be made again. A device that cannot fail under way has nothing to do. Where nothing is
        kept, or the device is still not available, it raises DeviceError: then call it again later.
        """
        self.check_idle("recover")
        if self.recovery is None:
            self.check_not_failed()
        else:
            self.recovery.recover(self)

    @uninterrupted
    def set_max_cycles(self, max_cycles: int | None) -> None:
        """Replace the time limit, from the next step on; where there was none, steps count from now."""
        self.check_idle("set_max_cycles")
        config = replace(self.config, max_cycles=max_cycles)
        with self._noted("set_max_cycles", max_cycles):
            self._apply_limit(config)
            self.config = config

    def timed(self) -> dict[str, float]:
        """Time every step from now on; return where each step writes the seconds of its stages.

        They are named as in :data:`~pearl_marl.devices.transport.STAGES`; a device without a link to hardware
        has ``"compute"`` alone. What is kept for :meth:`recover` is not among them.
        """
        self.check_idle("timed")
        if self.stage_seconds is None:
            self.stage_seconds = {}
        return self.stage_seconds

    def _timed_step(self, words: Array) -> BatchStep:
        assert self.stage_seconds is not None
        began = time.perf_counter()
        result = self._step(words)
        self.stage_seconds.update(self._stages(began, time.perf_counter()))
        return result

    @uninterrupted
    def close(self) -> None:
        """Release what the device holds. Safe to call twice."""
        if self.phase is Phase.CLOSED:
            return
        opened, self.phase = self.phase is not Phase.NEW, Phase.CLOSED
        if opened:
            self._thread.close()
            self._close()

    @property
    def position(self) -> Position:
        """Where the device is: to be assigned again where a call has failed."""
        return Position(self.config, self.seed, self.tick, self.reward_table, self.phase)

    @position.setter
    def position(self, position: Position) -> None:
        self.config, self.seed, self.tick, self.reward_table, self.phase = position

    @property
    def remedy(self) -> str:
        """What to do after a call that failed under way, in words."""
        recover = "" if self.recovery is None else "recover(), or "
        return f"call {recover}reset(), or load a saved state, to go on"

    def fail(self) -> None:
        """Note that the state of the slots is unknown. Before the first reset nothing is lost by that."""
        if self.phase is not Phase.OPEN:
            self.phase = Phase.FAILED

    def check_idle(self, call: str, ready: bool = False) -> None:
        """Refuse a call that comes at the wrong time; with ``ready``, also where no step is possible."""
        if self.phase is Phase.CLOSED:
            raise OrderError(f"{call}() after close(): make a new environment")
        if self.phase is Phase.NEW:
            raise OrderError(f"{call}() before open(): this {self.name} device has no batch yet")
        if self.phase is Phase.STEPPING:
            raise OrderError(f"{call}() between send() and recv(): call recv() first")
        if ready and self.phase is Phase.OPEN:
            raise OrderError(f"{call}() before reset(): call reset() first")
        if ready:
            self.check_not_failed()

    def check_not_failed(self) -> None:
        """Refuse to go on where a call has failed under way."""
        if self.phase is Phase.FAILED:
            raise DeviceError(f"a step of the {self.name} device failed before; {self.remedy}")

    @contextmanager
    def _noted(self, call: str, *arguments: Any) -> Iterator[None]:
        """Make a call that is no step, and note it for :meth:`recover`; if it fails, go back to before."""
        position = self.position
        if self.recovery is not None:
            self.recovery.before(self, call)
        try:
            yield
            self._note(call, *arguments)
        except BaseException:
            failed = self.phase is Phase.FAILED
            self.position = position
            if failed:
                self.fail()
            raise

    def _note(self, call: str, *arguments: Any) -> None:
        if self.recovery is None:
            return
        try:
            self.recovery.after(self, call, *arguments)
        except BaseException:  # the slots have moved, and that is not noted
            self.phase = Phase.FAILED
            raise

    def __getstate__(self) -> dict[str, Any]:
        # A copy is a device of its own that goes on from here: threads, buffers and compiled code stay.
        if self.phase is Phase.NEW:
            return {"settings": self.__dict__}
        saved = self.snapshot() if self.phase not in (Phase.OPEN, Phase.CLOSED) else None
        settings = {name: _unopened(value) for name, value in self.made_with.items()}
        state = {"settings": settings, "config": self.config, "rewards": self.reward_table, "saved": saved}
        return {**state, "closed": self.phase is Phase.CLOSED}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state["settings"])
        if "config" in state:
            config = state["config"]
            if state["closed"]:  # nothing is taken up for that
                self.made_with, self.config, self.reward_table = state["settings"], config, state["rewards"]
                self.in_episode, self.phase = np.ones(config.n_agents, np.bool_), Phase.CLOSED
                return
            self.open(config, reward_tables.categories(config.spec, state["rewards"]))
            if state["saved"] is not None:
                self.restore(state["saved"])

    @abstractmethod
    def _open(self, config: BatchConfig) -> None:
        """Get ready to step the slots of ``config``, or raise DeviceError."""

    @abstractmethod
    def _reset(self, mask: Array | None, seed: int | None) -> Observed:
        """Start the masked slots (all, if ``None``) at ``tick``; return what all agents see then.

        ``seed`` is what ``self.seed`` was made from, where the random numbers begin anew.
        """

    @abstractmethod
    def _step(self, actions: Array) -> BatchStep:
        """Step every slot at ``tick``; ``actions`` are checked and in the device's width.

        The caller sets ``tick`` to the next one. A device whose slots and tick move at once may have done so.
        """

    def _begin(self, words: Any) -> tuple[Any, Future[BatchStep]]:
        """Start a step whose results :meth:`recv` will ask for; return its words, and what will have them."""
        if words is not self._actions:  # the caller may change its own
            self._actions[:] = words
        step = self._step if self.stage_seconds is None else self._timed_step
        return self._actions, self._thread.submit(step, self._actions)

    def _may_have_moved(self) -> bool:
        """Return whether a step that raised an error may have moved slots; the device has failed then."""
        return False

    def _stages(self, began: float, ended: float) -> dict[str, float]:
        """Return the seconds of the last step's stages; it took from ``began`` to ``ended``."""
        return {"compute": ended - began}

    @abstractmethod
    def _read(self) -> tuple[Array, Array]:
        """Return the slots' memory and the stored initial states (empty if random), as bytes."""

    @abstractmethod
    def _write(self, memory: Array, stored: Array) -> Observed:
        """Replace both; return what all agents see then."""

    def _apply_rewards(self, table: npt.ArrayLike) -> None:  # noqa: B027, as most use the table itself
        """Bring another reward table to where it is used, if that is not ``self.reward_table``."""

    def _apply_limit(self, config: BatchConfig) -> None:
        """Get ready for another time limit, that of ``config``."""
        if self.phase is not Phase.OPEN and not (self.config.limit and config.limit):
            self.check_not_failed()
            memory, stored = self._read()
            memory = memory.copy()
            SlotMemory(config.spec, config.n_envs, memory).elapsed[:] = 0
            self._write(memory, stored)

    @abstractmethod
    def _close(self) -> None:
        """Release everything; called once."""


def _unopened(setting: Any) -> Any:
    """Return a setting of a device as it was when that was made: other devices in it without a batch."""
    if isinstance(setting, list):
        return [_unopened(value) for value in setting]
    if not isinstance(setting, Device) or setting.phase is Phase.NEW:
        return setting
    fresh = object.__new__(type(setting))
    fresh.__dict__.update({name: _unopened(value) for name, value in setting.made_with.items()})
    return fresh
