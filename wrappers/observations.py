"""Wrappers that change observations, each as SuperSuit's of the same name unless it says otherwise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete, Space

from pearl_marl.errors import ArgumentError

from .base import Array, Batch, Env, Mask, Transform, box, wrap


class _Mapped(Transform):
    """Observations through a function of whole batches."""

    def __init__(
        self, batch: Batch, observation_space: Space[Any], action_space: Any, change: Callable[[Array], Array]
    ) -> None:
        super().__init__(batch, observation_space, action_space)
        self._change = change

    def observe(self, obs: Array) -> Array:
        return self._change(obs)


def _mapped(env: Env, name: str, change: Callable[[Array], Array]) -> Any:
    """Wrap an environment whose ``Box`` goes through ``change`` as its observations do."""

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        old = box(space, name)
        low, high = (change(bound[None])[0] for bound in (old.low, old.high))
        return _Mapped(batch, Box(low, high, dtype=low.dtype.type), action_space, change)

    return wrap(env, make)


def observation_lambda_v0(
    env: Env,
    change_observation_fn: Callable[[Array, Space[Any]], Array],
    change_obs_space_fn: Callable[[Space[Any]], Space[Any]] | None = None,
) -> Any:
    """Change observations by a function of the whole batch.

    Parameters
    ----------
    env
        The environment.
    change_observation_fn
        Takes observations of shape ``(n, ...)`` and one slot's space; returns as many rows.
    change_obs_space_fn
        Takes one slot's space and returns the new one. ``None``: a ``Box`` whose bounds are those of the
        old one, changed.
    """

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        def change(obs: Array) -> Array:
            result = np.asarray(change_observation_fn(obs, space))
            if len(result) != len(obs):
                raise ArgumentError(
                    f"change_observation_fn made {len(result)} rows of {len(obs)}; it gets whole batches"
                )
            return result

        if change_obs_space_fn is not None:
            return _Mapped(batch, change_obs_space_fn(space), action_space, change)
        old = box(space, "observation_lambda_v0 without change_obs_space_fn")
        ends = np.stack([change(bound[None])[0] for bound in (old.low, old.high)])
        new = Box(ends.min(0), ends.max(0), dtype=ends.dtype.type)
        return _Mapped(batch, new, action_space, change)

    return wrap(env, make)


def dtype_v0(env: Env, dtype: npt.DTypeLike) -> Any:
    """Cast observations."""
    kind = np.dtype(dtype)
    return _mapped(env, "dtype_v0", lambda obs: obs.astype(kind))


def flatten_v0(env: Env) -> Any:
    """Give each observation one axis."""
    return _mapped(env, "flatten_v0", lambda obs: obs.reshape(len(obs), -1))


def reshape_v0(env: Env, shape: tuple[int, ...]) -> Any:
    """Give each observation another shape of as many elements."""

    def change(obs: Array) -> Array:
        if np.prod(shape) != np.prod(obs.shape[1:]):
            raise ArgumentError(f"{obs.shape[1:]} cannot be reshaped to {shape}: not as many elements")
        return obs.reshape(len(obs), *shape)

    return _mapped(env, "reshape_v0", change)


def normalize_obs_v0(env: Env, env_min: float = 0.0, env_max: float = 1.0) -> Any:
    """Scale observations from the bounds of their space, which must be finite, to others."""
    if not env_min < env_max:
        raise ArgumentError(f"env_min is {env_min}, env_max {env_max}; the first must be the smaller")

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        old = box(space, "normalize_obs_v0")
        if old.dtype not in (np.float32, np.float64):
            raise ArgumentError(f"normalize_obs_v0 takes floats, not {old.dtype}: put dtype_v0 inside it")
        if not old.is_bounded():
            raise ArgumentError(f"normalize_obs_v0 takes finite bounds; {old} has others")
        scale = old.dtype.type(env_max - env_min)
        size, least = old.high - old.low, old.dtype.type(env_min)

        def change(obs: Array) -> Array:
            return (obs - old.low) / size * scale + least

        new = Box(env_min, env_max, old.shape, old.dtype.type)
        return _Mapped(batch, new, action_space, change)

    return wrap(env, make)


def color_reduction_v0(env: Env, mode: str = "full") -> Any:
    """Keep one channel of pictures (``"R"``, ``"G"``, ``"B"``) or their brightness (``"full"``)."""
    if mode not in ("full", "R", "G", "B"):
        raise ArgumentError(f"mode is {mode!r}; possible are 'full', 'R', 'G' and 'B'")
    weights = np.array([0.299, 0.587, 0.114], np.float32)

    def change(obs: Array) -> Array:
        if obs.ndim != 4 or obs.shape[3] != 3:
            raise ArgumentError(f"color_reduction_v0 takes pictures with 3 channels, not {obs.shape[1:]}")
        if mode == "full":
            return (obs.astype(np.float32) @ weights).astype(np.uint8)
        return obs[..., "RGB".index(mode)].copy()

    return _mapped(env, "color_reduction_v0", change)


def resize_v1(env: Env, x_size: int, y_size: int, linear_interp: bool = True) -> Any:
    """Give pictures another size.

    Parameters
    ----------
    env
        The environment; observations of shape ``(y, x)`` or ``(y, x, channels)``.
    x_size, y_size
        The new width and height.
    linear_interp
        Whether to mix the four nearest pixels (in ``float32``, and cut off for integers), not take one.
    """
    for name, size in (("x_size", x_size), ("y_size", y_size)):
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise ArgumentError(f"{name} is {size!r}; it must be a positive integer")

    def weights(old: int, new: int) -> Array:
        """Return which old pixels make up each new one, shape ``(new, old)``."""
        result = np.zeros((new, old), np.float32)
        if linear_interp:
            # Centres of pixels lie on centres; beyond the outermost, the outermost count alone.
            at = np.clip((np.arange(new) + 0.5) * old / new - 0.5, 0, old - 1)
            low = np.minimum(at.astype(int), max(old - 2, 0))
            share = (at - low).astype(np.float32)
            np.add.at(result, (np.arange(new), low), 1 - share)
            np.add.at(result, (np.arange(new), np.minimum(low + 1, old - 1)), share)
        else:
            result[np.arange(new), np.arange(new) * old // new] = 1
        return result

    def change(obs: Array) -> Array:
        if obs.ndim not in (3, 4):
            raise ArgumentError(f"resize_v1 takes pictures of 2 or 3 axes, not {obs.shape[1:]}")
        rows, columns = weights(obs.shape[1], y_size), weights(obs.shape[2], x_size)
        mixed = np.tensordot(obs.astype(np.float32), columns, (2, 1))  # columns go last
        mixed = np.moveaxis(np.tensordot(mixed, rows, (1, 1)), -1, 1)  # and rows back to their place
        if obs.ndim == 4:
            mixed = np.moveaxis(mixed, 3, 2)
        return mixed.astype(obs.dtype)

    return _mapped(env, "resize_v1", change)


def agent_indicator_v0(env: Env, type_only: bool = False) -> Any:
    """Show each agent which one it is.

    A ``Discrete`` observation becomes ``observation * n + agent``, as SuperSuit has it. A ``Box`` gets
    one more element (a picture one more channel) that grows evenly from 0 for the first agent to 1 for
    the last; SuperSuit appends a one-hot vector, which for 43,008 agents would be 43,008 wide.

    Parameters
    ----------
    env
        The environment.
    type_only
        Show the type in the agent's name instead. All agents here are of one type, so nothing changes.
    """
    if type_only:
        return env

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        n = batch._n
        if isinstance(space, Discrete):
            agents = np.arange(n)
            if int(space.n) * n >= 1 << 63:
                raise ArgumentError(f"{space} times {n} agents does not fit 63 bits")
            new: Space[Any] = Discrete(int(space.n) * n, start=int(space.start) * n)
            return _Mapped(batch, new, action_space, lambda obs: obs * n + agents)
        old: Box = box(space, "agent_indicator_v0")
        number = np.arange(n) / max(n - 1, 1)
        added: tuple[int, ...] = (*old.shape[:-1], 1) if len(old.shape) == 3 else (1,)
        if len(old.shape) not in (1, 3):
            raise ArgumentError(
                f"agent_indicator_v0 takes vectors and pictures with channels, not {old.shape}"
            )
        kind = old.dtype if old.dtype.kind == "f" else np.dtype(np.float32)
        more = np.broadcast_to(number.reshape(n, *(1,) * len(added)), (n, *added)).astype(kind)

        def change(obs: Array) -> Array:
            return np.concatenate([obs, more], axis=-1, dtype=kind)

        low, high = (
            np.concatenate([bound, np.full(added, end)], axis=-1, dtype=kind)
            for bound, end in ((old.low, 0), (old.high, 1))
        )
        return _Mapped(batch, Box(low, high, dtype=kind.type), action_space, change)

    return wrap(env, make)


def pad_observations_v0(env: Env) -> Any:
    """Pad observations to the largest agent's. Here all are alike, so this returns ``env`` as it is."""
    return env


class _FrameStack(Transform):
    keeps_history = True

    def __init__(
        self, batch: Batch, space: Space[Any], action_space: Any, size: int, axis: int, repeat: bool
    ) -> None:
        self._size, self._repeat, self._n_values = size, repeat, 0
        shape: tuple[int, ...] = space.shape or ()
        if isinstance(space, Discrete):
            self._n_values = int(space.n)
            if space.start != 0 or self._n_values**size >= 1 << 63:
                raise ArgumentError(f"{size} frames of {space} are more than 63 bits tell apart")
            new: Space[Any] = Discrete(self._n_values**size)
        else:
            old = box(space, "frame_stack")
            if not 1 <= len(shape) <= 3:
                raise ArgumentError(f"frames of shape {shape} cannot be stacked: 1 to 3 axes can")
            # Vectors and pictures with channels are put side by side, pictures without get an axis.
            self._axis = 0 if axis == 0 or len(shape) == 1 else len(shape) - (len(shape) == 3)
            self._one = np.expand_dims(old.low, self._axis).shape if len(shape) == 2 else shape
            low, high = (
                np.concatenate([bound.reshape(self._one)] * size, self._axis) for bound in (old.low, old.high)
            )
            # Frames before the first are zeros.
            low, high = (low, high) if repeat else (np.minimum(low, 0), np.maximum(high, 0))
            new = Box(low, high, dtype=old.dtype.type)
        super().__init__(batch, new, action_space)
        self._stack = np.zeros((self.n, *(new.shape or ())), space.dtype)
        self.memory = {"stack": self._stack}

    def begin(self, obs: Array, began: Mask) -> Array:
        if self._n_values:
            repeats = sum(self._n_values**k for k in range(self._size)) if self._repeat else 1
            self._stack[began] = obs[began] * repeats
        elif self._repeat:
            frames = obs[began].reshape(-1, *self._one)
            self._stack[began] = np.concatenate([frames] * self._size, self._axis + 1)
        else:
            self._stack[began] = 0
            self._last(self._stack)[began] = obs[began].reshape(-1, *self._one)
        return self._stack.copy()

    def push(self, obs: Array) -> Array:
        stack = self._stack
        if self._n_values:
            stack[:] = (stack * self._n_values + obs) % self._n_values**self._size
        else:
            length = self._one[self._axis]
            moved = np.moveaxis(stack, self._axis + 1, 1)
            moved[:, :-length] = moved[:, length:].copy()
            self._last(stack)[...] = obs.reshape(-1, *self._one)
        return stack.copy()

    def shown(self) -> Array:
        return self._stack.copy()

    def _last(self, stack: Array) -> Array:
        """Return the newest frames, a view."""
        start = stack.shape[self._axis + 1] - self._one[self._axis]
        index = (slice(None),) * (self._axis + 1)
        return stack[(*index, slice(start, None))]


def frame_stack_v1(env: Env, stack_size: int = 4, stack_dim: int = -1) -> Any:
    """Show the last frames, oldest first; zeros before an episode's first.

    Parameters
    ----------
    env
        The environment. Of a ``Discrete`` observation, frames become the digits of one number.
    stack_size
        How many.
    stack_dim
        Along which axis pictures are stacked: 0, or -1 for the last.
    """
    return _frame_stack(env, stack_size, stack_dim, repeat=False)


def frame_stack_v2(env: Env, stack_size: int = 4, stack_dim: int = -1) -> Any:
    """Do as :func:`frame_stack_v1`, but with an episode's first frame in place of zeros."""
    return _frame_stack(env, stack_size, stack_dim, repeat=True)


def _frame_stack(env: Env, size: int, axis: int, repeat: bool) -> Any:
    if isinstance(size, bool) or not isinstance(size, int) or size < 1:
        raise ArgumentError(f"stack_size is {size!r}; it must be a positive integer")
    if axis not in (0, -1):
        raise ArgumentError(f"stack_dim is {axis!r}; possible are 0 and -1")
    return wrap(env, lambda batch, space, actions: _FrameStack(batch, space, actions, size, axis, repeat))


class _Window(Transform):
    """The frames of the last steps, one after the other in turn."""

    keeps_history = True

    def __init__(self, batch: Batch, space: Space[Any], action_space: Any, frames: int) -> None:
        super().__init__(batch, space, action_space)
        self._frames = frames
        shape = self.batch_shape(space)
        # How many steps each slot's episode is old, the reset included, up to the number of frames.
        self.memory = {
            "window": np.zeros((frames, self.n, *shape), space.dtype),
            "age": np.zeros(self.n, np.uint32),
            "turn": np.zeros((), np.int64),
        }

    @staticmethod
    def batch_shape(space: Space[Any]) -> tuple[int, ...]:
        if isinstance(space, (Box, Discrete)):
            return space.shape or ()
        raise ArgumentError(f"observations in {space} cannot be kept: a Box or Discrete is needed")

    def begin(self, obs: Array, began: Mask) -> Array:
        window, age, turn = self.memory.values()
        window[turn, began] = obs[began]
        age[began] = 1
        return self.shown()

    def push(self, obs: Array) -> Array:
        window, age, turn = self.memory.values()
        turn[...] = (turn + 1) % self._frames
        window[turn] = obs
        np.minimum(age + 1, self._frames, out=age, casting="unsafe")
        return self.shown()


class _Delay(_Window):
    def shown(self) -> Array:
        window, age, turn = self.memory.values()
        old = age == self._frames
        oldest = window[(turn + 1) % self._frames]
        result: Array = np.where(old.reshape(-1, *(1,) * (oldest.ndim - 1)), oldest, oldest.dtype.type(0))
        return result


class _Maximum(_Window):
    def shown(self) -> Array:
        window, age, turn = self.memory.values()
        result: Array = window[turn].copy()
        for back in range(1, self._frames):
            before = window[(turn - back) % self._frames]
            here = (age > back).reshape(-1, *(1,) * (before.ndim - 1))
            np.maximum(result, before, out=result, where=here)
        return result


def delay_observations_v0(env: Env, delay: int) -> Any:
    """Show what was to be seen ``delay`` steps ago; zeros before."""
    if isinstance(delay, bool) or not isinstance(delay, int) or delay < 0:
        raise ArgumentError(f"delay is {delay!r}; it must be an integer of at least 0")
    return wrap(env, lambda batch, space, actions: _Delay(batch, space, actions, delay + 1))


def max_observation_v0(env: Env, memory: int) -> Any:
    """Show the greatest value of each element in the last ``memory`` steps of the episode."""
    if isinstance(memory, bool) or not isinstance(memory, int) or memory < 1:
        raise ArgumentError(f"memory is {memory!r}; it must be a positive integer")
    return wrap(env, lambda batch, space, actions: _Maximum(batch, space, actions, memory))
