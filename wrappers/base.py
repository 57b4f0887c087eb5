"""What a wrapper is: a change to whole arrays, put around an environment of either interface."""

from __future__ import annotations

import io
import secrets
import zipfile
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete, Space
from gymnasium.vector import AutoresetMode

from pearl_marl import rng
from pearl_marl.devices import BatchStep
from pearl_marl.errors import ArgumentError, SavedStateError
from pearl_marl.parallel_interface import ParallelInterface
from pearl_marl.vector_interface import VectorInterface

Array = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]


class Batch(Protocol):
    """What a transform is put around: an environment of this package, or another transform's."""

    _n: int
    _autoreset_mode: AutoresetMode

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once."""

    def _reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked slots; return all observations."""


class Transform:
    """A change to what goes into and comes out of a batch of slots; by itself it changes nothing.

    A subclass overrides :meth:`actions`, :meth:`rewards`, and of the observations either
    :meth:`observe`, if each depends on nothing but itself, or :meth:`begin` and :meth:`push`.
    What it keeps from step to step it keeps in :attr:`memory`, a row a slot.

    Parameters
    ----------
    batch
        What it is put around.
    observation_space, action_space
        One slot's spaces there.

    Attributes
    ----------
    observation_space, action_space
        One slot's spaces with the change.
    memory
        Arrays that a saved state has to hold, by name.
    """

    keeps_history = False
    """Whether observations depend on earlier ones: :meth:`begin` and :meth:`push` are used then."""

    action_kinds: str | None = None
    """Kinds of dtype that actions may have, if not those of the action space."""

    def __init__(self, batch: Batch, observation_space: Space[Any], action_space: Discrete | Box) -> None:
        self.batch, self.n = batch, batch._n
        self.observation_space, self.action_space = observation_space, action_space
        self.memory: dict[str, Array] = {}
        self._resetting = np.zeros(self.n, np.bool_)
        self._seed: tuple[int, int] | None = None
        self._tick = 0

    def reset(self, obs: Array, seed: int | None, mask: Mask | None = None) -> Array:
        """Take up that the masked slots (all, if ``None``) begin an episode with ``obs``."""
        if seed is not None:
            self._seed, self._tick = rng.seed_words(seed), 0
        elif self._seed is None:
            self._seed = rng.seed_words(secrets.randbits(64))
        began = np.ones(self.n, np.bool_) if mask is None else mask
        self._resetting &= ~began
        self.episode_began(began)
        if not self.keeps_history:
            return self.observe(obs)
        return self.begin(obs, began)

    def step(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once."""
        result = self.batch.step_batch(self.actions(np.asarray(actions)))
        self._tick += 1
        return self.results(result)

    def results(self, step: BatchStep) -> BatchStep:
        """Change the results of a step."""
        ended = step.ended
        rewards = self.rewards(step)
        if self.batch._autoreset_mode is AutoresetMode.NEXT_STEP:
            began, self._resetting = self._resetting, ended
            obs = self.push(step.obs) if self.keeps_history else self.observe(step.obs)
            if self.keeps_history and began.any():
                obs[began] = self.begin(step.obs, began)[began]
            final_obs = obs
        elif self.keeps_history:
            obs = final_obs = self.push(step.arrivals())
            began = ended
            if ended.any():
                final_obs = obs.copy()
                obs[ended] = self.begin(step.obs, ended)[ended]
        else:
            obs, began = self.observe(step.obs), ended
            final_obs = self.observe(step.final_obs) if ended.any() else obs
        if began.any():
            self.episode_began(began)
        return BatchStep(obs, rewards, step.terminations, step.truncations, final_obs)

    def actions(self, actions: Array) -> Array:
        """Return the actions to take instead."""
        return actions

    def rewards(self, step: BatchStep) -> Array:
        """Return the rewards to give instead; of an array of their own, or the step's."""
        return step.rewards

    def observe(self, obs: Array) -> Array:
        """Return what to show instead of each observation."""
        return obs

    def begin(self, obs: Array, began: Mask) -> Array:
        """Return what to show of first observations: rows of ``began`` changed, the others as last shown."""
        raise NotImplementedError

    def push(self, obs: Array) -> Array:
        """Return what to show of a step's observations, in an array of its own."""
        raise NotImplementedError

    def shown(self) -> Array:
        """Return what was shown last, as :attr:`memory` has it."""
        raise NotImplementedError

    def snapshot(self) -> dict[str, Array]:
        """Return all that the continuation depends on."""
        place = np.array([*(self._seed or (0, 0)), self._tick], np.uint64)
        return {"place": place, "resetting": self._resetting, **self.memory}

    def restore(self, saved: dict[str, Array]) -> None:
        """Continue from a snapshot."""
        seed_0, seed_1, self._tick = map(int, saved["place"])
        self._seed = seed_0, seed_1
        self._resetting = saved["resetting"]
        for name, array in self.memory.items():
            array[...] = saved[name]

    def episode_began(self, began: Mask) -> None:
        """Forget what belongs to the masked slots' last episode."""

    def draws(self, index: int) -> npt.NDArray[np.uint32]:
        """Return a random ``u32`` a slot for this step, which depends on seed, slot and step only."""
        assert self._seed is not None
        # Wrappers have numbers of their own from here on, far from those of any environment.
        return rng.draws(self._seed, np.arange(self.n), self._tick, 1 << 31 | index)


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
        self._action_kinds = transform.action_kinds or self._action_kinds

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "env":
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        return getattr(self.env, name)

    def reset_batch(self, seed: int | None = None) -> Array:
        """Begin an episode for every agent; return observations of shape ``(n_agents, ...)``."""
        return self.transform.reset(self.env.reset_batch(seed), seed)

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """See :meth:`ParallelInterface.step_batch`."""
        return self.transform.step(actions)

    def save_state(self) -> bytes:
        """Return all that the continuation depends on, what wrappers remember included."""
        return _packed(self.env.save_state(), self.transform)

    def load_state(self, blob: bytes) -> Array:
        """Continue from what :meth:`save_state` of an environment wrapped like this one returned."""
        inner, remembered = _unpacked(blob, self.transform)
        obs = self.env.load_state(inner)
        self.transform.restore(remembered)
        return self.transform.shown() if self.transform.keeps_history else self.transform.observe(obs)

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
        ready: bool = self.env._ready
        return ready

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

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "env":
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        return getattr(self.env, name)

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
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise SavedStateError(f"the saved state is damaged: {error}") from None
    for key, array in transform.snapshot().items():
        if key not in saved or saved[key].shape != array.shape or saved[key].dtype != array.dtype:
            raise SavedStateError(f"the saved state's {key!r} is not that of this wrapper")
    return saved.pop("inner").tobytes(), saved
