"""Putting a change to whole arrays around an environment of either interface: where own wrappers begin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space

from pearl_marl.devices.by_name import make_host_device
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.batch import Batch
from pearl_marl.interfaces.parallel_interface import ParallelInterface
from pearl_marl.interfaces.vector_interface import VectorInterface

from .transform import Transform
from .wrapped import WrappedParallelEnv, WrappedVectorEnv

__all__ = ["Batch", "Transform", "box", "with_zeros", "wrap"]


def wrap(env: Batch, make: Callable[..., Transform], *arguments: Any) -> Any:
    """Put a transform around an environment.

    Parameters
    ----------
    env
        A :class:`pearl_marl.PearlParallelEnv` or :class:`pearl_marl.PearlVectorEnv`, wrapped or not.
    make
        Makes the transform from what is inside, the batch and one slot's spaces, and from ``arguments``.

    Returns
    -------
    An environment of the same interface.
    """
    if not isinstance(env, (ParallelInterface, VectorInterface)):
        raise ArgumentError(
            f"{type(env).__name__} is no environment of this package; for others, SuperSuit has this wrapper"
        )
    unwrapped: Any = env.unwrapped
    make_host_device(unwrapped.device)  # a transform is NumPy's work
    transform = make(env, env.slot_observation_space, env.slot_action_space, *arguments)
    wrapped = WrappedParallelEnv if isinstance(env, ParallelInterface) else WrappedVectorEnv
    return wrapped(env, transform)


def box(space: Space[Any], name: str, what: str = "observations") -> Box:
    """Return a space that has to be a ``Box``, or refuse it for the wrapper called ``name``."""
    if not isinstance(space, Box):
        raise ArgumentError(f"{name} takes {what} in a Box, not {space}")
    return space


def with_zeros(space: Space[Any]) -> Space[Any]:
    """Return the space itself, or if zeros are beyond its bounds, one that they are within."""
    if not isinstance(space, Box) or ((space.low <= 0) & (space.high >= 0)).all():
        return space
    return Box(np.minimum(space.low, 0), np.maximum(space.high, 0), dtype=space.dtype.type)
