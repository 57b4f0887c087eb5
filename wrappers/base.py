"""Putting a change to whole arrays around an environment of either interface: where own wrappers begin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from gymnasium.spaces import Box, Discrete, Space

from pearl_marl.devices.by_name import make_host_device
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.batch import Batch
from pearl_marl.interfaces.parallel_interface import ParallelInterface
from pearl_marl.interfaces.vector_interface import VectorInterface

from .transform import Transform
from .wrapped import WrappedParallelEnv, WrappedVectorEnv

__all__ = ["Batch", "Env", "Transform", "wrap"]

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
    if not isinstance(env, (ParallelInterface, VectorInterface)):
        raise ArgumentError(
            f"{type(env).__name__} is no environment of this package; for others, SuperSuit has this wrapper"
        )
    unwrapped: Any = env.unwrapped
    make_host_device(unwrapped.device)  # a transform is NumPy's work
    transform = make(env, env.slot_observation_space, env.slot_action_space)
    if isinstance(env, ParallelInterface):
        return WrappedParallelEnv(env, transform)
    return WrappedVectorEnv(env, transform)
