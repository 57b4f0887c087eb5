"""What a wrapper is: a change to whole arrays, put around an environment of either interface."""

from __future__ import annotations

import io
import secrets
import zipfile
import zlib
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete, Space
from gymnasium.vector import AutoresetMode

from pearl_marl import rng
from pearl_marl.batch.actions import refusal, refuse_first
from pearl_marl.batch.recycling import Recycler
from pearl_marl.devices import BatchStep
from pearl_marl.devices.by_name import make_host_device
from pearl_marl.errors import ArgumentError, OrderError, SavedStateError
from pearl_marl.interfaces.parallel_interface import ParallelInterface
from pearl_marl.interfaces.vector_interface import VectorInterface

Array = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]
Slots = npt.NDArray[np.intp]


class Batch(Protocol):
    """What a transform is put around: an environment of this package, wrapped or not."""

    # How many slots, when their device resets those that ended, whether those go on by themselves, and
    # which have not left for good.
    _n: int
    _autoreset_mode: AutoresetMode
    _autoreset: bool
    _live: Mask

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once."""

    def _reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked slots; return all observations."""


class Transform:
    """A change to what goes into and comes out of a batch of slots; by itself it changes nothing.

    A subclass overrides :meth:`actions`, :meth:`rewards`, and of the observations either
    :meth:`observe`, if each depends on nothing but itself, or :meth:`push`, :meth:`begin` and
    :meth:`show`. What it keeps from step to step it keeps in :attr:`memory`.

    Parameters
    ----------
    batch
        What it is put around.
    observation_space, action_space
        One slot's spaces, with the change.

    Attributes
    ----------
    batch, n
        What it is put around, and how many slots that has.
    observation_space, action_space
        One slot's spaces, with the change.
    action_kinds
        The kinds of dtype that actions may have.
    memory
        Arrays that a saved state has to hold, by name. They are only ever written into, never replaced.
    new
        Makes arrays for results, ``new.empty(shape, dtype)`` and ``new.copy(array)``: see :class:`Recycler`.
    """

    keeps_history = False
    """Whether observations depend on earlier ones: :meth:`push`, :meth:`begin` and :meth:`show` are used."""

    def __init__(self, batch: Batch, observation_space: Space[Any], action_space: Discrete | Box) -> None:
        self.batch, self.n = batch, batch._n
        self.observation_space, self.action_space = observation_space, action_space
        inside: Transform | None = getattr(batch, "transform", None)
        # Whom to ask about actions that are handed through.
        self._taker = inside if inside is not None and inside.action_space is action_space else None
        self.action_kinds = "iu" if isinstance(action_space, Discrete) else "iuf"
        if self._taker is not None:
            self.action_kinds = self._taker.action_kinds
        self._idle: Any = action_space.start if isinstance(action_space, Discrete) else action_space.low
        self.memory: dict[str, Array] = {}
        self.new = Recycler()
        # NEXT_STEP mode only: who spends the next step resetting.
        self._resetting = np.zeros(self.n, np.bool_)
        self._seed: tuple[int, int] | None = None
        self._tick = 0
        self._depth: int = 0 if inside is None else inside._depth + 1

    def reset(self, obs: Array, seed: int | None, mask: Mask | None = None) -> Array:
        """Take up that masked slots (all, if ``None``) begin an episode with ``obs``; return what to show."""
        if seed is not None:
            self._seed, self._tick = rng.seed_words(seed), 0
        elif self._seed is None:
            self._seed = rng.seed_words(secrets.randbits(64))
        began = np.arange(self.n) if mask is None else np.flatnonzero(mask)
        self._resetting[began] = False
        self.episode_began(began)
        if not self.keeps_history:
            return self.observe(obs)
        self.begin(obs, began)
        return self.show()

    def step(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once."""
        result = self.batch.step_batch(self.actions(self.given(actions)))
        self._tick += 1
        return self.results(result)

    def given(self, actions: npt.ArrayLike) -> Array:
        """Return actions as an array; refuse them if it has not the shape and kind of dtype of actions."""
        if self._seed is None:
            raise OrderError("step() before reset(): call reset() of the outermost wrapper first")
        try:
            array = np.asarray(actions)
        except ValueError:  # a ragged list
            raise refusal(actions, self.action_space, self.n) from None
        shape = self.n, *(self.action_space.shape or ())
        if array.shape != shape or array.dtype.kind not in self.action_kinds:
            raise refusal(actions, self.action_space, self.n)
        live = self.batch._live
        if not live.all():  # whatever an array says for those that left, it is ignored
            here = live.reshape(-1, *(1,) * (array.ndim - 1))
            array = np.where(here, array, self._idle)
        return array

    def possible(self, actions: Array) -> Mask:
        """Return which slots' actions can be taken, be it that a wrapper inside mends them."""
        if self._taker is not None:
            return self._taker.possible(actions)
        space = self.action_space
        if isinstance(space, Box):
            within: Any = (space.low <= actions) & (actions <= space.high)
            return np.asarray(within.reshape(self.n, -1).all(1))
        result: Mask = (space.start <= actions) & (actions < space.start + space.n)
        return result if actions.dtype.kind in "iu" else result & (actions == np.floor(actions))

    def check(self, actions: Array) -> None:
        """Refuse actions that are not possible; for transforms that may not hand them on."""
        possible = self.possible(actions)
        if not possible.all():
            first = int(np.argmin(possible))
            raise refuse_first([f"agent_{first}"], [actions[first].tolist()], self.action_space)

    def results(self, step: BatchStep) -> BatchStep:
        """Change the results of a step."""
        ended = step.ended
        rewards = self.rewards(step)
        if self.batch._autoreset_mode is AutoresetMode.NEXT_STEP:
            began = np.flatnonzero(self._resetting)
            self._resetting[:] = ended
            if self.keeps_history:
                self.push(step.obs)
                self.begin(step.obs, began)
                obs = final_obs = self.show()
            else:
                obs = final_obs = self.observe(step.obs)
        else:
            began = np.flatnonzero(ended)
            if self.keeps_history:
                self.push(self.arrivals(step))
                obs = final_obs = self.show()
                if began.size:
                    final_obs = self.new.copy(obs)
                    self.begin(step.obs, began)
                    obs[began] = self.show(began)
            else:
                obs = self.observe(step.obs)
                final_obs = self.observe(step.final_obs) if began.size else obs
        if began.size:
            self.episode_began(began)
        return BatchStep(obs, rewards, step.terminations, step.truncations, final_obs)

    def arrivals(self, step: BatchStep) -> Array:
        """Return where a step took every slot: see :meth:`BatchStep.arrivals`."""
        slots = np.flatnonzero(step.ended)
        if not slots.size:
            return step.obs
        obs = self.new.copy(step.obs)
        obs[slots] = step.final_obs.take(slots, 0)
        return obs

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

    def begin(self, obs: Array, slots: Slots) -> None:
        """Remember the first observations of episodes, ``obs[slots]``, and nothing from before them."""
        raise NotImplementedError

    def show(self, slots: Slots | None = None) -> Array:
        """Return what to show the slots (all, if ``None``) of what is remembered, in an array of its own."""
        raise NotImplementedError

    def episode_began(self, slots: Slots) -> None:
        """Forget what else belongs to these slots' last episodes."""

    def draws(self, index: int = 0) -> npt.NDArray[np.uint32]:
        """Return a random ``u32`` a slot for this step; depends on seed, slot, step and wrapper only.

        ``index``, below 256, tells apart what is drawn for different purposes.
        """
        assert self._seed is not None
        # Far from the draws of any environment, and other ones for every wrapper around it.
        return rng.draws(self._seed, np.arange(self.n), self._tick, 1 << 31 | self._depth << 8 | index)

    def snapshot(self) -> dict[str, Array]:
        """Return all that the continuation depends on."""
        place = np.array([*(self._seed or (0, 0)), self._tick], np.uint64)
        return {"place": place, "resetting": self._resetting, **self.memory}

    def restore(self, saved: dict[str, Array]) -> None:
        """Continue from a snapshot."""
        seed_0, seed_1, self._tick = map(int, saved["place"])
        self._seed = seed_0, seed_1
        self._resetting[:] = saved["resetting"]
        for name, array in self.memory.items():
            array[...] = saved[name]

    def restored(self, obs: Array) -> Array:
        """Return what to show after :meth:`restore`, where the batch shows ``obs``."""
        return self.show() if self.keeps_history else self.observe(obs)


class WrappedParallelEnv(ParallelInterface):
    """An environment with a transform around it; everything else is as the environment has it.

    Attributes
    ----------
    env
        The environment inside.
    transform
        The :class:`Transform`.
    """

    def __init__(self, env: Any, transform: Transform) -> None:
        self.env, self.transform = env, transform
        self.metadata, self.render_mode = env.metadata, env.render_mode
        self.possible_agents = env.possible_agents
        self._known, self._autoreset = env._known, env._autoreset
        self._set_spaces(transform.observation_space, transform.action_space)
        self._action_kinds = transform.action_kinds

    def __getattr__(self, name: str) -> Any:
        return _inside(self, name)

    def reset_batch(self, seed: int | None = None) -> Array:
        """Begin an episode for every agent; return observations of shape ``(n_agents, ...)``."""
        return self.transform.reset(self.env.reset_batch(seed), seed)

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """See :meth:`ParallelInterface.step_batch`."""
        if not self.env._ready:
            self.env.step_batch(actions)  # says why that is impossible
        return self.transform.step(actions)

    def save_state(self) -> bytes:
        """Return all that the continuation depends on, what wrappers remember included."""
        inner = self.env.save_state()
        if not self._ready:
            raise OrderError("save_state() before reset(): call reset() of the outermost wrapper first")
        return _packed(inner, self.transform)

    def load_state(self, blob: bytes) -> Array:
        """Continue from what :meth:`save_state` of an environment wrapped like this one returned."""
        inner, remembered = _unpacked(blob, self.transform)
        obs = self.env.load_state(inner)
        self.transform.restore(remembered)
        return self.transform.restored(obs)

    def _reset_slots(self, mask: Mask) -> Array:
        return self.transform.reset(self.env._reset_slots(mask), None, mask)

    @property
    def max_cycles(self) -> int:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        limit: int = self.env.max_cycles
        return limit

    @max_cycles.setter
    def max_cycles(self, value: int | None) -> None:
        self.env.max_cycles = value

    @property
    def unwrapped(self) -> Any:
        """The environment inside all wrappers."""
        return self.env.unwrapped

    @property
    def agents(self) -> list[str]:
        """Who is still there."""
        here: list[str] = self.env.agents
        return here

    @property
    def _agents(self) -> tuple[str, ...]:  # type: ignore[override]
        here: tuple[str, ...] = self.env._agents
        return here

    @property
    def _live(self) -> Mask:  # type: ignore[override]
        live: Mask = self.env._live
        return live

    @property
    def _ready(self) -> bool:
        return bool(self.env._ready) and self.transform._seed is not None

    @property
    def _n(self) -> int:
        return len(self.possible_agents)

    @property
    def _autoreset_mode(self) -> AutoresetMode:
        mode: AutoresetMode = self.env._autoreset_mode
        return mode

    def state(self) -> Any:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.state()

    def render(self, agent: str | None = None) -> Any:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.render(agent)

    def close(self) -> None:
        """Close the environment inside."""
        self.env.close()


class WrappedVectorEnv(VectorInterface):
    """A vector environment with a transform around it; everything else is as the environment has it.

    Attributes
    ----------
    env
        The environment inside.
    transform
        The :class:`Transform`.
    """

    def __init__(self, env: Any, transform: Transform) -> None:
        self.env, self.transform = env, transform
        self._set_up(env.num_envs, transform.observation_space, transform.action_space, env._mode)
        self.spec, self.render_mode = env.spec, env.render_mode

    def __getattr__(self, name: str) -> Any:
        return _inside(self, name)

    def reset_batch(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """See :class:`VectorInterface`."""
        obs = self.env.reset_batch(seed, mask)
        return self.transform.reset(obs, seed, None if mask is None else np.asarray(mask, np.bool_))

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """See :class:`VectorInterface`."""
        return self.transform.step(actions)

    def _reset_slots(self, mask: Mask) -> Array:
        return self.transform.reset(self.env._reset_slots(mask), None, mask)

    @property
    def _n(self) -> int:
        return int(self.num_envs)

    @property
    def _autoreset_mode(self) -> AutoresetMode:
        mode: AutoresetMode = self.env._autoreset_mode
        return mode

    @property
    def unwrapped(self) -> Any:
        """The environment inside all wrappers."""
        return self.env.unwrapped

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environment inside."""
        self.env.close(**kwargs)


Env = TypeVar("Env", ParallelInterface, VectorInterface)


def wrap(env: Env, make: Callable[[Batch, Space[Any], Discrete | Box], Transform]) -> Any:
    """Put a transform around an environment.

    Parameters
    ----------
    env
        A :class:`pearl_marl.PearlParallelEnv` or :class:`pearl_marl.PearlVectorEnv`, wrapped or not.
    make
        Makes the transform from what is inside: the batch, and one slot's spaces.

    Returns
    -------
    An environment of the same interface.
    """
    inside: Any = env
    if isinstance(env, (ParallelInterface, VectorInterface)):
        make_host_device(inside.unwrapped.device)  # a transform is NumPy's work
    if isinstance(env, ParallelInterface):
        return WrappedParallelEnv(inside, make(inside, inside._observation_space, inside._action_space))
    if isinstance(env, VectorInterface):
        spaces = inside.single_observation_space, inside.single_action_space
        return WrappedVectorEnv(inside, make(inside, *spaces))
    raise ArgumentError(
        f"{type(env).__name__} is no environment of this package; for others, SuperSuit has this wrapper"
    )


def box(space: Space[Any], name: str) -> Box:
    """Return a space that has to be a ``Box``, or refuse it for the wrapper called ``name``."""
    if not isinstance(space, Box):
        raise ArgumentError(f"{name} takes observations in a Box, not {space}")
    return space


def with_zeros(space: Space[Any]) -> Space[Any]:
    """Return the space itself, or if zeros are beyond its bounds, one that they are within."""
    if not isinstance(space, Box) or ((space.low <= 0) & (space.high >= 0)).all():
        return space
    return Box(np.minimum(space.low, 0), np.maximum(space.high, 0), dtype=space.dtype.type)


def _inside(wrapped: Any, name: str) -> Any:
    """Return an attribute of the environment inside a wrapped one."""
    if name.startswith("_") or name == "env":
        raise AttributeError(f"{type(wrapped).__name__} has no attribute {name!r}")
    if name in ("send", "recv"):  # they would go past the wrapper
        raise AttributeError(f"a wrapped environment has no {name}(): only step() and step_batch()")
    return getattr(wrapped.env, name)


_FORMAT = b"PEARLWR1"


def _packed(inner: bytes, transform: Transform) -> bytes:
    file = io.BytesIO()
    arrays: dict[str, Any] = {"inner": np.frombuffer(inner, np.uint8), **transform.snapshot()}
    np.savez(file, **arrays)
    return _FORMAT + type(transform).__name__.encode() + b"\0" + file.getvalue()


def _unpacked(blob: bytes, transform: Transform) -> tuple[bytes, dict[str, Array]]:
    if not isinstance(blob, (bytes, bytearray, memoryview)):
        raise SavedStateError(f"a saved state is bytes, not {type(blob).__name__}")
    blob = bytes(blob)
    head, _, body = blob.partition(b"\0")
    name = type(transform).__name__.encode()
    if head != _FORMAT + name:
        raise SavedStateError(f"this is no saved state of an environment in a {name.decode()} wrapper")
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as file:
            saved = dict(file)
        inner = saved.pop("inner").tobytes()
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise SavedStateError(f"the saved state is damaged: {error}") from None
    for key, array in transform.snapshot().items():
        if key not in saved or saved[key].shape != array.shape or saved[key].dtype != array.dtype:
            raise SavedStateError(f"the saved state's {key!r} is not that of this wrapper")
    return inner, saved
