"""An environment with a transform around it: as much of either interface as the change is about."""

from __future__ import annotations

import io
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.arrays import unpacked_arrays
from pearl_marl.batch.step import Array, BatchStep
from pearl_marl.deferral import uninterrupted
from pearl_marl.errors import OrderError, SavedStateError
from pearl_marl.interfaces.batch import Mask
from pearl_marl.interfaces.parallel_interface import ParallelInterface
from pearl_marl.interfaces.vector_interface import VectorInterface

from .transform import Transform

_FORMAT = b"PEARLWR1"


class _Wrapped:
    """An environment, ``env``, with a transform around it; everything else is as the environment has it."""

    env: Any
    transform: Transform

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "env":
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        if name in ("send", "recv"):  # they would go past the wrapper
            raise AttributeError(f"a wrapped environment has no {name}(): only step() and step_batch()")
        return getattr(self.env, name)

    @property
    def ready(self) -> bool:
        """Whether a step is possible: after the first reset of this wrapper, and until closed."""
        return self.transform.ready and bool(self.env.ready)

    @property
    def alive(self) -> Mask:
        """Who takes part in the next step, as the environment has it."""
        alive: Mask = self.env.alive
        return alive

    @property
    def action_masks(self) -> Array | None:
        """Which actions may be taken in the next step: the transform says."""
        return self.transform.action_masks

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


class WrappedParallelEnv(_Wrapped, ParallelInterface):
    """An environment of PettingZoo's form with a transform around it."""

    def __init__(self, env: Any, transform: Transform) -> None:
        self.env, self.transform = env, transform
        self.metadata, self.render_mode = env.metadata, env.render_mode
        spaces = transform.observation_space, transform.action_space
        super().__init__(env.batch_size, *spaces, transform.action_kinds, env.autoreset, transform.world)

    @uninterrupted
    def reset_batch(self, seed: int | None = None) -> Array:
        """Begin an episode for every agent; return observations of shape ``(n_agents, ...)``."""
        return self.transform.reset(self.env.reset_batch(seed), seed)

    @uninterrupted
    def reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked worlds; return all observations."""
        return self.transform.reset(self.env.reset_slots(mask), None, np.asarray(mask))

    @uninterrupted
    def step_slots(self, actions: npt.ArrayLike) -> BatchStep:
        """See :meth:`ParallelInterface.step_slots`."""
        if not self.env.ready:
            self.env.step_batch(actions)  # says why that is impossible
        return self.transform.step(actions)

    @uninterrupted
    def save_state(self) -> bytes:
        """Return all that the continuation depends on, what wrappers remember included."""
        inner = self.env.save_state()
        if not self.ready:
            raise OrderError("save_state() before reset(): call reset() of the outermost wrapper first")
        return _packed(inner, self.transform)

    @uninterrupted
    def load_state(self, blob: bytes) -> Array:
        """Continue from what :meth:`save_state` of an environment wrapped like this one returned."""
        inner, remembered = _unpacked(blob, self.transform)
        obs = self.env.load_state(inner)
        self.transform.restore(remembered)
        return self.transform.restored(obs)

    @property
    def live(self) -> Mask:
        """Which slots' agents are there: the transform says."""
        return self.transform.live

    def state(self) -> Any:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.state()

    def render(self, agent: str | None = None) -> Any:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.render(agent)

    def close(self) -> None:
        """Close the environment inside."""
        self.env.close()


class WrappedVectorEnv(_Wrapped, VectorInterface):
    """An environment of Gymnasium's form with a transform around it."""

    def __init__(self, env: Any, transform: Transform) -> None:
        self.env, self.transform = env, transform
        mode = env.metadata["autoreset_mode"]
        spaces = transform.observation_space, transform.action_space
        super().__init__(env.num_envs, *spaces, mode, transform.world)
        self.spec, self.render_mode = env.spec, env.render_mode

    @property
    def np_random(self) -> np.random.Generator:
        """The random numbers of the environment inside."""
        generator: np.random.Generator = self.env.np_random
        return generator

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self.env.np_random = value

    @property
    def np_random_seed(self) -> int:
        """What they were made from; -1 where they were assigned."""
        seed: int = self.env.np_random_seed
        return seed

    def start_from(self, state: object) -> None:
        """See :class:`VectorInterface`."""
        self.env.start_from(state)

    @uninterrupted
    def reset_batch(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """See :class:`VectorInterface`."""
        obs = self.env.reset_batch(seed, mask)
        return self.began(self.transform.reset(obs, seed, None if mask is None else np.asarray(mask)), mask)

    @uninterrupted
    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """See :class:`VectorInterface`."""
        return self.transform.step(actions)

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environment inside."""
        self.env.close(**kwargs)


def _packed(inner: bytes, transform: Transform) -> bytes:
    """Return the bytes of an environment and of the transform around it, as one."""
    file = io.BytesIO()
    arrays: dict[str, Any] = {"inner": np.frombuffer(inner, np.uint8), **transform.snapshot()}
    np.savez(file, **arrays)
    return _FORMAT + type(transform).__name__.encode() + b"\0" + file.getvalue()


def _unpacked(blob: bytes, transform: Transform) -> tuple[bytes, dict[str, Array]]:
    """Return the environment's bytes, and the snapshot for a transform like the one that was packed."""
    if not isinstance(blob, (bytes, bytearray, memoryview)):
        raise SavedStateError(f"a saved state is bytes, not {type(blob).__name__}")
    blob = bytes(blob)
    head, _, body = blob.partition(b"\0")
    name = type(transform).__name__.encode()
    if head != _FORMAT + name:
        raise SavedStateError(f"this is no saved state of an environment in a {name.decode()} wrapper")
    mine = transform.snapshot()

    def check(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        right = (
            (len(shape) == 1, np.uint8) if name == "inner" else (shape == mine[name].shape, mine[name].dtype)
        )
        if right != (True, dtype):
            raise SavedStateError(
                f"the saved state's {name!r} has shape {shape} and dtype {dtype}, which is not that of this "
                "wrapper"
            )

    try:
        saved = unpacked_arrays(body, {name: partial(check, name) for name in ("inner", *mine)})
    except SavedStateError:
        raise
    except ValueError as error:
        raise SavedStateError(f"the saved state is damaged: {error}") from None
    inner = saved.pop("inner").tobytes()
    if (wrong := transform.wrong(saved)) is not None:
        raise SavedStateError(f"the saved state's {wrong!r} has numbers that no step of this wrapper leaves")
    return inner, saved
