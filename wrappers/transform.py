"""What a wrapper does: a change to whole arrays, on their way into and out of a batch."""

from __future__ import annotations

import io
import secrets
import warnings
from functools import partial
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Space
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array, unpacked_arrays
from pearl_marl.base.deferral import uninterrupted
from pearl_marl.batch.actions import ActionRules
from pearl_marl.batch.results import Recycler
from pearl_marl.batch.step import BatchStep
from pearl_marl.errors import OrderError, SavedStateError
from pearl_marl.golden import rng
from pearl_marl.interfaces.batch import Batch, DeviceBatch
from pearl_marl.interfaces.world import Mask
from pearl_marl.spec.elements import ActionSpace

Rows = npt.NDArray[np.intp]

_FORMAT = b"PEARLWR1"


class Transform(Batch):
    """A batch around another one, which changes what goes in and comes out; by itself it changes nothing.

    A subclass overrides :meth:`actions`, :meth:`rewards`, and of the observations either
    :meth:`observe`, if each depends on nothing but itself, or :meth:`push`, :meth:`begin` and
    :meth:`show`. What it keeps from step to step it keeps in :attr:`memory`.

    Attributes
    ----------
    batch, n
        What it is put around, and how many agents that has.
    acting
        Which agents act in the step under way: are present, and in an episode.
    resetting
        Which rows spend the step resetting; in NEXT_STEP mode only.
    memory
        Arrays that a saved state has to hold, by name. They are only ever written into, never replaced.
    new
        Makes arrays for results, ``new.empty(shape, dtype)`` and ``new.copy(array)``: see :class:`Recycler`.
    """

    keeps_history = False
    """Whether observations depend on earlier ones: :meth:`push`, :meth:`begin` and :meth:`show` are used."""

    def __init__(self, batch: Batch, observation_space: Space[Any], action_space: ActionSpace) -> None:
        self.batch, self.n = batch, batch.batch_size
        inside = batch if isinstance(batch, Transform) else None
        # What decides about actions that are handed through.
        self._taker = inside if inside is not None and inside.action_space is action_space else None
        spec = batch.innermost.spec
        rules = ActionRules(
            action_space,
            self.n,
            # Of another space, its elements have no names.
            [field.name for field in spec.action_fields] if action_space == spec.action_space else [],
            kinds="" if self._taker is None else self._taker.action_rules.kinds,
        )
        world = batch.world.with_spaces(
            None if observation_space is batch.observation_space else observation_space,
            None if action_space is batch.action_space else action_space,
        )
        super().__init__(self.n, observation_space, rules, batch.autoreset, batch.slot_autoreset_mode, world)
        self.memory: dict[str, Array] = {}
        self.new = Recycler()
        self.acting, self.resetting = batch.present, np.zeros(self.n, np.bool_)
        self._seed: tuple[int, int] | None = None
        self._tick = 0
        self._depth: int = 0 if inside is None else inside._depth + 1

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "live" in vars(cls):  # by the name that it had before
            warnings.warn(f"{cls.__name__}.live is now present", DeprecationWarning, stacklevel=2)
            setattr(cls, "present", vars(cls)["live"])  # noqa: B010, as mypy takes properties for constants

    @property
    def transform(self) -> Self:
        """Itself: what ``env.transform`` is of an environment with wrappers."""
        return self

    @property
    def innermost(self) -> DeviceBatch:
        """See :class:`Batch`."""
        return self.batch.innermost

    @property
    def present(self) -> Mask:
        """Which agents are present: those of the batch inside. See :class:`Batch`."""
        return self.batch.present

    @property
    def in_episode(self) -> Mask:
        """See :class:`Batch`."""
        return self.batch.in_episode

    @property
    def action_masks(self) -> Array | None:
        """Which actions may be taken in the next step: as the batch inside has it."""
        return self.batch.action_masks

    @property
    def ready(self) -> bool:
        """Whether a step is possible: after the first reset of this wrapper, and until closed."""
        return self._seed is not None and self.batch.ready

    @uninterrupted
    def reset_batch(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """See :meth:`Batch.reset_batch`."""
        obs = self.batch.reset_batch(seed, mask)
        return self.reset(obs, seed, None if mask is None else np.asarray(mask))

    @uninterrupted
    def step_rows(self, actions: npt.ArrayLike) -> BatchStep:
        """See :meth:`Batch.step_rows`."""
        if not self.batch.ready:
            self.batch.step_batch(actions)  # says why that is impossible
        return self.step(actions)

    @uninterrupted
    def save_state(self) -> bytes:
        """Return all that the continuation depends on, what transforms remember included."""
        inner = self.batch.save_state()
        if not self.ready:
            raise OrderError("save_state() before reset(): call reset() of the outermost wrapper first")
        file = io.BytesIO()
        arrays: dict[str, Any] = {"inner": np.frombuffer(inner, np.uint8), **self.snapshot()}
        np.savez(file, **arrays)
        return _FORMAT + type(self).__name__.encode() + b"\0" + file.getvalue()

    @uninterrupted
    def load_state(self, blob: bytes) -> Array:
        """Continue from what :meth:`save_state` of a batch in transforms like these returned."""
        inner, remembered = self._unpacked(blob)
        obs = self.batch.load_state(inner)
        self.restore(remembered)
        return self.restored(obs)

    def _unpacked(self, blob: bytes) -> tuple[bytes, dict[str, Array]]:
        """Return the saved state of the batch inside, and a snapshot of one like this."""
        if not isinstance(blob, (bytes, bytearray, memoryview)):
            raise SavedStateError(f"a saved state is bytes, not {type(blob).__name__}")
        head, _, body = bytes(blob).partition(b"\0")
        name = type(self).__name__
        if head != _FORMAT + name.encode():
            raise SavedStateError(f"this is no saved state of an environment in a {name} wrapper")
        mine = self.snapshot()

        def check(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
            right = (
                (len(shape) == 1, np.uint8)
                if name == "inner"
                else (shape == mine[name].shape, mine[name].dtype)
            )
            if right != (True, dtype):
                raise SavedStateError(
                    f"the saved state's {name!r} has shape {shape} and dtype {dtype}, which is not that of "
                    "this wrapper"
                )

        try:
            saved = unpacked_arrays(body, {name: partial(check, name) for name in ("inner", *mine)})
        except SavedStateError:
            raise
        except ValueError as error:
            raise SavedStateError(f"the saved state is damaged: {error}") from None
        inner = saved.pop("inner").tobytes()
        if (wrong := self.wrong(saved)) is not None:
            raise SavedStateError(
                f"the saved state's {wrong!r} has numbers that no step of this wrapper leaves"
            )
        return inner, saved

    def reset(self, obs: Array, seed: int | None, mask: Mask | None = None) -> Array:
        """Take up that worlds (all, or those masked) begin an episode with ``obs``; return what to show."""
        if seed is not None:
            self._seed, self._tick = rng.seed_words(seed), 0
        elif self._seed is None:
            self._seed = rng.seed_words(secrets.randbits(64))
        began = np.arange(self.n) if mask is None else np.flatnonzero(self.world.rows(mask))
        self.resetting[began] = False
        self.episode_began(began)
        if not self.keeps_history:
            return self._outside_episodes_zero(self.observe(obs))
        self.begin(obs, began)
        return self._outside_episodes_zero(self.show())

    def step(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every world once."""
        actions = self.actions(self.array(actions))
        self.acting = self.batch.present
        if self.world.agents > 1:
            self.acting = self.acting & self.batch.in_episode
        step = self.take(actions)
        self._tick += 1
        return self.results(step)

    def take(self, actions: Array) -> BatchStep:
        """Step the batch; once, unless a subclass has it otherwise."""
        return self.batch.step_batch(actions)

    def array(self, actions: npt.ArrayLike) -> Array:
        """Return actions as an array; refuse them if it has not the shape and kind of dtype of actions."""
        if self._seed is None:
            raise OrderError("step() before reset(): call reset() of the outermost wrapper first")
        try:
            array = np.asarray(actions)
        except ValueError:  # some are sequences of other lengths
            raise self.action_rules.refusal(actions) from None
        if not self.action_rules.are_actions(array, self.n):
            raise self.action_rules.refusal(actions)
        return array

    def possible(self, actions: Array) -> Mask:
        """Return which rows of actions are valid, or become valid in a wrapper inside."""
        return self.action_rules.possible(actions) if self._taker is None else self._taker.possible(actions)

    def check(self, actions: Array) -> None:
        """Refuse actions that are not possible; for transforms that may not hand them on."""
        possible = self.possible(actions) | self.resetting  # whose action is ignored
        if not possible.all():
            first = int(np.argmin(possible))
            raise self.action_rules.refusal_of([f"agent_{first}"], [actions[first].tolist()])

    def results(self, step: BatchStep) -> BatchStep:
        """Return the results of a step with the change."""
        rewards = self.rewards(step)
        if self.batch.slot_autoreset_mode is AutoresetMode.NEXT_STEP:
            began = np.flatnonzero(self.resetting)
            self.resetting[:] = step.ended
            obs = final_obs = self._next_step_observations(step.obs, began)
        else:
            began = np.flatnonzero(self.world.begins(step))
            obs, final_obs = self._same_step_observations(step, began)
            obs = self._outside_episodes_zero(obs)
        if began.size:
            self.episode_began(began)
        return self.carried(step, obs, rewards, step.terminations, step.truncations, final_obs)

    def carried(self, step: BatchStep, *arrays: Array) -> BatchStep:
        """Return results in place of a step's, with ``action_masks`` and ``in_episode`` as they are now."""
        if len(step.arrays) == len(arrays):
            return BatchStep(*arrays)
        masks = self.action_masks
        in_episode = (self.batch.in_episode,) if self.world.agents > 1 else ()
        return BatchStep.of((*arrays, *(() if masks is None else (masks,)), *in_episode), masks is not None)

    def _outside_episodes_zero(self, obs: Array) -> Array:
        """Return observations that are zeros where an agent has ended before its world."""
        if self.world.agents == 1 or (over := ~self.batch.in_episode).sum() == 0:
            return obs
        obs = self.new.copy(obs)
        obs[over] = 0
        return obs

    def _next_step_observations(self, obs: Array, began: Rows) -> Array:
        """Return the observations of a step in which some rows did nothing but begin."""
        if not self.keeps_history:
            return self.observe(obs)
        self.push(obs)
        self.begin(obs, began)
        return self.show()

    def _same_step_observations(self, step: BatchStep, began: Rows) -> tuple[Array, Array]:
        """Return the observations of a step in which some rows ended and began, and the final ones."""
        if not self.keeps_history:
            obs = self.observe(step.obs)
            return obs, self.observe(self.ends(step)) if step.ended.any() else obs
        self.push(self.arrivals(step))
        obs = self.show()
        if not began.size:
            return obs, obs
        final_obs = self.new.copy(obs)
        self.begin(step.obs, began)
        obs[began] = self.show(began)
        return obs, final_obs

    def arrivals(self, step: BatchStep) -> Array:
        """Return where a step took every agent: see :meth:`BatchStep.arrivals`."""
        rows = np.flatnonzero(step.ended)
        if not rows.size:
            return step.obs
        obs = self.new.copy(step.obs)
        obs[rows] = step.final_obs.take(rows, 0)
        return obs

    def ends(self, step: BatchStep) -> Array:
        """Return what :meth:`observe` gets of a step's ends."""
        return step.final_obs

    def actions(self, actions: Array) -> Array:
        """Return the actions to take instead. They may yet be refused: nothing is to change here."""
        return actions

    def rewards(self, step: BatchStep) -> Array:
        """Return the rewards to give instead, in an array of their own or the step's."""
        return step.rewards

    def observe(self, obs: Array) -> Array:
        """Return what to show instead of each observation, in an array of its own or ``obs`` itself."""
        return obs

    def push(self, obs: Array) -> None:
        """Remember the observations of a step."""
        raise NotImplementedError

    def begin(self, obs: Array, rows: Rows) -> None:
        """Remember the first observations of episodes, ``obs[rows]``, and nothing from before them."""
        raise NotImplementedError

    def show(self, rows: Rows | None = None) -> Array:
        """Return the observations of some rows (all, if ``None``) by what is remembered, in a new array."""
        raise NotImplementedError

    def episode_began(self, rows: Rows) -> None:
        """Forget what else belongs to these rows' last episodes."""

    def draws(self, index: int = 0) -> npt.NDArray[np.uint32]:
        """Return a random ``u32`` an agent for this step; depends on seed, row, step and wrapper only.

        ``index``, below 256, tells apart what is drawn for different purposes.
        """
        assert self._seed is not None
        # Far from the draws of any environment, and other ones for every wrapper around it.
        return rng.draws(self._seed, np.arange(self.n), self._tick, 1 << 31 | self._depth << 8 | index)

    def snapshot(self) -> dict[str, Array]:
        """Return all that the continuation depends on."""
        place = np.array([*(self._seed or (0, 0)), self._tick], np.uint64)
        return {"place": place, "resetting": self.resetting, **self.memory}

    def restore(self, saved: dict[str, Array]) -> None:
        """Continue from a snapshot."""
        seed_0, seed_1, self._tick = map(int, saved["place"])
        self._seed = seed_0, seed_1
        self.resetting[:] = saved["resetting"]
        for name, array in self.memory.items():
            array[...] = saved[name]

    def wrong(self, saved: dict[str, Array]) -> str | None:
        """Return the name of what is no snapshot's among arrays of the right shapes and dtypes, if any."""
        if (saved["place"][:2] >= 1 << 32).any():
            return "place"
        for name, array in saved.items():
            if array.dtype == np.bool_ and (array.view(np.uint8) > 1).any():
                return name
        return next((name for name in self.memory if not self.is_possible(name, saved)), None)

    def is_possible(self, name: str, saved: dict[str, Array]) -> bool:
        """Return whether an array of :attr:`memory` can have come of steps."""
        return bool(np.isfinite(saved[name]).all())

    def restored(self, obs: Array) -> Array:
        """Return what to show after :meth:`restore`, where the batch shows ``obs``."""
        return self._outside_episodes_zero(self.show() if self.keeps_history else self.observe(obs))
