"""Wrappers that change observations, each as SuperSuit's of the same name unless it says otherwise."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from operator import methodcaller
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete, Space

from pearl_marl.base.arrays import Array
from pearl_marl.batch.results import Recycler, memory_of_machine
from pearl_marl.batch.step import BatchStep
from pearl_marl.checks import checked_choice, checked_function, checked_integer, is_number
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.batch import Batch
from pearl_marl.spec.elements import bounds

from . import kernels
from .base import Env, box, checked, differing, with_zeros, wrap
from .transform import Rows, Transform

Change = Callable[[Array], Array]


class _MappedObservations(Transform):
    """Observations through a function of whole batches."""

    def __init__(
        self, batch: Batch, observation_space: Space[Any], action_space: Any, change: Change
    ) -> None:
        super().__init__(batch, observation_space, action_space)
        self._change = change

    def observe(self, obs: Array) -> Array:
        return self._change(obs)


def _mapped(env: Env, name: str, change: Change) -> Any:
    """Wrap an environment whose ``Box`` goes through ``change`` as its observations do."""

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        old = box(space, name)
        low, high = (change(bound[None])[0] for bound in (old.low, old.high))
        if (low > high).any():  # it may be cast to a type that does not hold it
            raise ArgumentError(f"{name} would make {low} and {high} of the bounds of {old}: low above high")
        return _MappedObservations(batch, Box(low, high, dtype=low.dtype.type), action_space, change)

    return wrap(env, make)


def observation_lambda_v0(
    env: Env,
    change_observation_fn: Callable[[Array, Space[Any]], Array],
    change_obs_space_fn: Callable[[Space[Any]], Space[Any]] | None = None,
) -> Any:
    """Change observations by a function of the whole batch.

    Parameters
    ----------
    change_observation_fn
        Takes observations of shape ``(n, ...)`` and one agent's space; returns as many rows.
    change_obs_space_fn
        Takes one agent's space and returns the new one. ``None``: a ``Box`` whose bounds are those of the
        old one, changed.
    """
    checked_function("change_observation_fn", change_observation_fn)
    if change_obs_space_fn is not None:
        checked_function("change_obs_space_fn", change_obs_space_fn)

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        new_space: Space[Any] | None = None
        if change_obs_space_fn is not None:
            new_space = change_obs_space_fn(space)
            if not isinstance(new_space, Space):
                raise ArgumentError(
                    f"change_obs_space_fn made {new_space!r}; it must be a space of Gymnasium"
                )
        change = partial(_by_function, change_observation_fn, space, new_space)
        if new_space is not None:
            return _MappedObservations(batch, new_space, action_space, change)
        old = box(space, "observation_lambda_v0 without change_obs_space_fn")
        ends = np.stack([change(bound[None])[0] for bound in (old.low, old.high)])
        new = Box(ends.min(0), ends.max(0), dtype=ends.dtype.type)
        return _MappedObservations(batch, new, action_space, change)

    return wrap(env, make)


def _by_function(
    change_observation_fn: Callable[[Array, Space[Any]], Array],
    space: Space[Any],
    new_space: Space[Any] | None,
    obs: Array,
) -> Array:
    """Return what a user's function makes of observations, to be in ``new_space`` if that is known."""
    result = np.asarray(change_observation_fn(obs, space))
    if result.ndim == 0 or len(result) != len(obs):
        rows = len(result) if result.ndim else "no"
        raise ArgumentError(f"change_observation_fn made {rows} rows of {len(obs)}; it gets whole batches")
    if new_space is not None and new_space.shape not in (None, result.shape[1:]):
        raise ArgumentError(
            f"change_observation_fn made rows of shape {result.shape[1:]}, and change_obs_space_fn "
            f"{new_space}"
        )
    return result


def dtype_v0(env: Env, dtype: npt.DTypeLike) -> Any:
    """Cast observations."""
    try:
        kind = np.dtype(dtype)
    except TypeError:
        kind = np.dtype(object)
    if kind.kind not in "biuf":
        raise ArgumentError(f"dtype is {dtype!r}; it must be one of integers, floats or bool")
    return _mapped(env, "dtype_v0", methodcaller("astype", kind))


def flatten_v0(env: Env) -> Any:
    """Give each observation one axis."""
    return _mapped(env, "flatten_v0", _flat)


def _flat(obs: Array) -> Array:
    return obs.reshape(len(obs), -1)


def reshape_v0(env: Env, shape: tuple[int, ...]) -> Any:
    """Give each observation another shape of as many elements."""
    if not isinstance(shape, (tuple, list)) or not all(isinstance(side, (int, np.integer)) for side in shape):
        raise ArgumentError(f"shape is {shape!r}; it must be a tuple of integers")
    return _mapped(env, "reshape_v0", partial(_reshaped, shape))


def _reshaped(shape: tuple[int, ...], obs: Array) -> Array:
    if min(shape, default=0) < 0 or np.prod(shape) != np.prod(obs.shape[1:]):
        raise ArgumentError(f"{obs.shape[1:]} cannot be reshaped to {shape}: not as many elements")
    return obs.reshape(len(obs), *shape)


def normalize_obs_v0(env: Env, env_min: float = 0.0, env_max: float = 1.0) -> Any:
    """Scale observations from the bounds of their space, which must be finite, to others."""
    if not (is_number(env_min) and is_number(env_max) and env_min < env_max):
        raise ArgumentError(
            f"env_min is {env_min!r}, env_max {env_max!r}; the first must be the smaller number"
        )

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        old = box(space, "normalize_obs_v0")
        if old.dtype not in (np.float32, np.float64):
            raise ArgumentError(f"normalize_obs_v0 takes floats, not {old.dtype}: put dtype_v0 inside it")
        if not old.is_bounded():
            raise ArgumentError(f"normalize_obs_v0 takes finite bounds; {old} has others")
        new_size, new_low = old.dtype.type(env_max - env_min), old.dtype.type(env_min)
        scale = old.low.ravel(), (old.high - old.low).ravel(), new_size, new_low
        new_space = Box(env_min, env_max, old.shape, old.dtype.type)
        return _MappedObservations(batch, new_space, action_space, partial(_rescaled, Recycler(), scale))

    return wrap(env, make)


def _rescaled(new: Recycler, scale: tuple[Any, ...], obs: Array) -> Array:
    """Return observations on another scale, as the kernel takes it."""
    out = new.empty(obs.shape, obs.dtype)
    kernels.rescaled(obs.reshape(len(obs), -1), *scale, out.reshape(len(obs), -1))
    return out


def color_reduction_v0(env: Env, mode: str = "full") -> Any:
    """Keep one channel of pictures (``"R"``, ``"G"``, ``"B"``) or their brightness (``"full"``)."""
    checked_choice("mode", mode, ("full", "R", "G", "B"))
    return _mapped(env, "color_reduction_v0", partial(_one_channel, mode))


def _one_channel(mode: str, obs: Array) -> Array:
    """Return a channel of pictures, or their brightness."""
    if obs.ndim != 4 or obs.shape[3] != 3:
        raise ArgumentError(f"color_reduction_v0 takes pictures with 3 channels, not {obs.shape[1:]}")
    if mode == "full":
        return (obs.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)).astype(np.uint8)
    return obs[..., "RGB".index(mode)].copy()


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
    x_size, y_size = checked_integer("x_size", x_size), checked_integer("y_size", y_size)
    return _mapped(env, "resize_v1", partial(_resized, x_size, y_size, linear_interp))


def _resized(x_size: int, y_size: int, linear_interp: bool, obs: Array) -> Array:
    """Return pictures of another size."""
    if obs.ndim not in (3, 4):
        raise ArgumentError(f"resize_v1 takes pictures of 2 or 3 axes, not {obs.shape[1:]}")
    if not linear_interp:
        return obs[:, _nearest(obs.shape[1], y_size)][:, :, _nearest(obs.shape[2], x_size)]
    result: Array = _mixed(_mixed(obs.astype(np.float32), 2, x_size), 1, y_size).astype(obs.dtype)
    return result


def _nearest(old: int, new: int) -> Rows:
    """Return which of ``old`` pixels each of ``new`` ones shows."""
    return ((np.arange(new) + 0.5) * old / new).astype(np.intp)


def _mixed(obs: Array, axis: int, new: int) -> Array:
    """Return pictures with ``new`` pixels along an axis, each a mixture of the two nearest."""
    # As tinyscaler has it, with which SuperSuit resizes: the centres of the outermost pixels are the
    # edges of the picture, and a new pixel shows what is at its centre.
    at = (np.arange(new) + 0.5) * (obs.shape[axis] - 1) / new
    low = at.astype(np.intp)
    share = (at - low).astype(np.float32).reshape(-1, *(1,) * (obs.ndim - axis - 1))
    one, other = obs.take(low, axis), obs.take(np.minimum(low + 1, obs.shape[axis] - 1), axis)
    return np.asarray(one + (other - one) * share)


def agent_indicator_v0(env: Env, type_only: bool = False) -> Any:
    """Show each agent which one of its world it is.

    As in SuperSuit, a ``Discrete`` observation becomes ``observation * k + agent``, and a ``Box`` gets ``k``
    more elements (a picture ``k`` more channels), of which the agent's own is 1 (SuperSuit: the greatest that
    the space has) and the others 0.

    Where a world has one agent, it shows which of all it is. A ``Box`` then gets one more element that grows
    evenly from 0 for the first to 1 for the last: a one-hot vector of 43,008 agents would be 43,008 wide.

    Parameters
    ----------
    type_only
        Show the agent's role instead. Where all agents are alike, nothing changes.
    """
    names = [role.name for role in checked(env).batch.world.roles]
    kinds = sorted(set(names), key=names.index)
    if type_only and len(kinds) < 2:
        return env

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        n, k = batch.batch_size, batch.world.agents
        which = np.arange(n) % k if k > 1 else np.arange(n)
        if type_only:
            which = np.array([kinds.index(name) for name in names])[which]
        count = int(which.max()) + 1
        if isinstance(space, Discrete):
            numbered, change = _numbered(space, count, which)
            return _MappedObservations(batch, numbered, action_space, change)
        share = which[:, None] / max(n - 1, 1)
        numbers = share if k == 1 else (which[:, None] == np.arange(count)).astype(np.float64)
        new_space, change = _with_numbers(box(space, "agent_indicator_v0"), numbers)
        return _MappedObservations(batch, new_space, action_space, change)

    return wrap(env, make)


def _numbered(space: Discrete, n: int, which: Array) -> tuple[Discrete, Change]:
    """Return the space of ``observation * n + which``, and what computes it."""
    if int(space.n) * n >= 1 << 63:
        raise ArgumentError(f"{space} times {n} agents does not fit 63 bits")
    return Discrete(int(space.n) * n, start=int(space.start) * n), partial(_with_number, n, which)


def _with_number(n: int, which: Array, obs: Array) -> Array:
    numbered: Array = obs * n + which
    return numbered


def _with_numbers(space: Box, numbers: Array) -> tuple[Box, Change]:
    """Return the space of observations with more elements, from 0 to 1, and what appends an agent's row."""
    if not 1 <= len(space.shape) <= 3:
        raise ArgumentError(f"agent_indicator_v0 takes vectors and pictures, not shape {space.shape}")
    # A picture without channels gets an axis for them.
    one: tuple[int, ...] = (*space.shape, 1) if len(space.shape) == 2 else space.shape
    kind = space.dtype if space.dtype.kind == "f" else np.dtype(np.float32)
    more = numbers.shape[1]
    change = partial(_appended, Recycler(), numbers.astype(kind), one)
    low, high = (
        np.concatenate([bound.reshape(one).astype(kind), np.full((*one[:-1], more), end, kind)], -1)
        for bound, end in ((space.low, 0), (space.high, 1))
    )
    return Box(low, high, dtype=kind.type), change


def _appended(new: Recycler, numbers: Array, one: tuple[int, ...], obs: Array) -> Array:
    """Return observations of the shape ``one``, with an agent's numbers after each row's elements."""
    (n, more), rows, width = numbers.shape, int(np.prod(one[:-1])), one[-1]
    out = new.empty((n, *one[:-1], width + more), numbers.dtype)
    kernels.appended(obs.reshape(n, rows, width), numbers, out.reshape(n, rows, width + more))
    return out


class _Padded(Transform):
    def __init__(self, batch: Batch, space: Space[Any], action_space: Any) -> None:
        super().__init__(batch, with_zeros(space), action_space)
        self.world = batch.world.with_spaces(self.observation_space, None)


def pad_observations_v0(env: Env) -> Any:
    """Pad observations with zeros to the widest role's.

    Where all agents are alike this returns ``env`` as it is.
    """
    return wrap(env, _Padded) if differing(checked(env).batch, "observation_space") else env


class _Window(Transform):
    """The frames of the last steps; before an episode's first, zeros or the first itself."""

    keeps_history = True

    def __init__(
        self,
        batch: Batch,
        space: Space[Any],
        action_space: Any,
        frames: int,
        one: tuple[int, ...],
        dtype: npt.DTypeLike,
        repeat: bool,
    ) -> None:
        super().__init__(batch, space, action_space)
        self._frames, self._repeat = frames, repeat
        # The newest is at `turn`, and the next comes in place of the oldest.
        self._window, self._turn = np.zeros((frames, self.n, *one), dtype), np.zeros((), np.int64)
        self.memory = {"window": self._window, "turn": self._turn}

    def is_possible(self, name: str, saved: dict[str, Array]) -> bool:
        if name == "turn":
            return 0 <= int(saved["turn"]) < self._frames
        low, high = self._range()
        return bool(((saved["window"] >= min(low, 0)) & (saved["window"] <= max(high, 0))).all())

    def _range(self) -> tuple[Any, Any]:
        """Return between what the numbers of frames are, but for zeros before an episode."""
        low, high = bounds(self.observation_space)
        return low.min(), high.max()

    def push(self, obs: Array) -> None:
        self._turn[...] = (self._turn + 1) % self._frames
        newest = self._frame(0)
        newest[...] = obs.reshape(newest.shape)

    def begin(self, obs: Array, rows: Rows) -> None:
        newest = self._frame(0)
        first = obs.take(rows, 0).reshape(len(rows), *newest.shape[1:])
        for frame in self._window:
            frame[rows] = first if self._repeat else 0
        newest[rows] = first

    def show(self, rows: Rows | None = None) -> Array:
        shape = self.n if rows is None else len(rows), *(self.observation_space.shape or ())
        out = (self.new.empty if rows is None else np.empty)(shape, self._window.dtype)
        self.write(out, rows)
        return out

    def write(self, out: Array, rows: Rows | None) -> None:
        """Write the observations of some rows (all, if ``None``), made of their frames."""
        raise NotImplementedError

    def _frame(self, age: int, rows: Rows | None = None) -> Array:
        """Return the frame of so many steps ago."""
        frame: Array = self._window[(int(self._turn) - age) % self._frames]
        return frame if rows is None else frame.take(rows, 0)


def _check_frames(env: Env, name: str, frames: Any, least: int = 1) -> None:
    """Refuse what is no number of frames, or too many for this machine's memory."""
    checked_integer(name, frames, least)
    space = checked(env).batch.observation_space
    most = memory_of_machine() // (env.batch.batch_size * max(1, int(np.prod(space.shape or ()))))
    if frames > most:
        raise ArgumentError(f"{name} is {frames:,}; this machine has memory for less than {most:,} frames")


class _FrameStack(_Window):
    def __init__(
        self, batch: Batch, space: Space[Any], action_space: Any, size: int, axis: int, repeat: bool
    ) -> None:
        old = box(space, "frame_stack")
        if not 1 <= len(old.shape) <= 3:
            raise ArgumentError(f"frames of shape {old.shape} cannot be stacked: 1 to 3 axes can")
        low, high = old.low, old.high
        if low.ndim == 2:  # pictures without channels get an axis
            low, high = np.expand_dims(low, axis), np.expand_dims(high, axis)
        # Other pictures' channels, and vectors, are put side by side.
        axis = 0 if axis == 0 else low.ndim - 1
        rows = int(np.prod(low.shape[:axis]))
        low, high = (np.concatenate([bound] * size, axis) for bound in (low, high))
        new: Space[Any] = Box(low, high, dtype=old.dtype.type)
        new = new if repeat else with_zeros(new)
        width = int(np.prod(old.shape)) // rows
        super().__init__(batch, new, action_space, size, (rows, width), old.dtype, repeat)

    def write(self, out: Array, rows: Rows | None) -> None:
        # A row of a frame moves as one thing, whatever it consists of.
        width = self._window.shape[3]
        row = np.dtype((np.void, width * out.itemsize))
        stacks = out.reshape(len(out), -1, self._frames * width).view(row)
        for age in range(self._frames):
            stacks[:, :, self._frames - 1 - age] = self._frame(age, rows).view(row)[:, :, 0]


class _NumberStack(_Window):
    """A stack of ``Discrete`` observations: the digits of one number."""

    def __init__(self, batch: Batch, space: Discrete, action_space: Any, size: int, repeat: bool) -> None:
        n = int(space.n)
        if space.start != 0 or n**size >= 1 << 63:
            raise ArgumentError(f"{size} frames of {space} are more than 63 bits tell apart")
        super().__init__(batch, Discrete(n**size), action_space, size, (), np.int64, repeat)
        self._n_values = n

    def _range(self) -> tuple[Any, Any]:
        return 0, self._n_values - 1

    def write(self, out: Array, rows: Rows | None) -> None:
        out[:] = 0
        for age in range(self._frames - 1, -1, -1):
            out *= self._n_values
            out += self._frame(age, rows)


class _Together(Transform):
    """What all agents of a world see."""

    def observe(self, obs: Array) -> Array:
        k = self.world.agents
        together = self.new.empty((self.n, k, *obs.shape[1:]), obs.dtype)
        together.reshape(-1, k, *together.shape[1:])[...] = obs.reshape(-1, 1, k, *obs.shape[1:])
        return together

    def ends(self, step: BatchStep) -> Array:
        # Beside those that ended, what the others of their world saw: nothing, if they had ended before.
        last = self.new.copy(self.arrivals(step))
        last[~self.acting] = 0
        return last


def world_observations_v0(env: Env) -> Any:
    """Show each agent what all ``k`` agents of its world observe, in a ``Box`` of shape ``(k, ...)``.

    Those of agents that have ended before their world are zeros.
    """

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        old, k = box(space, "world_observations_v0"), batch.world.agents
        low, high = (np.stack([bound] * k) for bound in (old.low, old.high))
        new_space = with_zeros(Box(low, high, dtype=old.dtype.type))
        return _Together(batch, new_space, action_space)

    return wrap(env, make)


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
    _check_frames(env, "stack_size", size)
    checked_choice("stack_dim", axis, (0, -1))

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        if isinstance(space, Discrete):
            return _NumberStack(batch, space, action_space, size, repeat)
        return _FrameStack(batch, space, action_space, size, axis, repeat)

    return wrap(env, make)


class _Delay(_Window):
    def write(self, out: Array, rows: Rows | None) -> None:
        out[...] = self._frame(self._frames - 1, rows).reshape(out.shape)


class _Maximum(_Window):
    def write(self, out: Array, rows: Rows | None) -> None:
        out[...] = self._frame(0, rows).reshape(out.shape)
        for age in range(1, self._frames):
            np.maximum(out, self._frame(age, rows).reshape(out.shape), out=out)


def _window(env: Env, name: str, kind: type[_Window], frames: int, repeat: bool) -> Any:
    """Wrap an environment in a window that shows observations of the shape they have inside."""

    def make(batch: Batch, space: Space[Any], action_space: Any) -> Transform:
        if space.dtype is None:
            raise ArgumentError(f"{name} takes observations that are one array, not {space}")
        one = (int(np.prod(space.shape or ())),)
        return kind(
            batch, space if repeat else with_zeros(space), action_space, frames, one, space.dtype, repeat
        )

    return wrap(env, make)


def delay_observations_v0(env: Env, delay: int) -> Any:
    """Show what was to be seen ``delay`` steps ago; zeros before."""
    _check_frames(env, "delay", delay, least=0)
    return _window(env, "delay_observations_v0", _Delay, delay + 1, repeat=False)


def max_observation_v0(env: Env, memory: int) -> Any:
    """Show the greatest value of each element in the last ``memory`` steps of the episode."""
    _check_frames(env, "memory", memory)
    return _window(env, "max_observation_v0", _Maximum, memory, repeat=True)
