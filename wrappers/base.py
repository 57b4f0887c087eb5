"""Putting a change to whole arrays around an environment of either interface: where own wrappers begin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from gymnasium.spaces import Box, Space

from pearl_marl.devices.by_name import make_host_device
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.batch import Batch
from pearl_marl.interfaces.parallel import PearlParallelEnv
from pearl_marl.interfaces.vector import PearlVectorEnv

from .transform import Transform

Env: TypeAlias = PearlParallelEnv | PearlVectorEnv

__all__ = ["Batch", "Transform", "box", "with_zeros", "wrap"]


def wrap(env: Env, make: Callable[..., Transform], *arguments: Any) -> Any:
    """Put a transform around an environment.

    Parameters
    ----------
    env
        A :class:`pearl_marl.PearlParallelEnv` or :class:`pearl_marl.PearlVectorEnv`, wrapped or not.
    make
        Makes the transform from what is inside, the batch and one agent's spaces, and from ``arguments``.

    Returns
    -------
    An environment of the same interface.
    """
    batch = checked(env).batch
    make_host_device(batch.innermost.device)  # a transform is NumPy's work
    transform = make(batch, batch.observation_space, batch.action_space, *arguments)
    _check_roles(batch, transform)
    return env.around(transform)


def checked(env: Any) -> Env:
    """Return an environment of this package, or refuse what is none."""
    if not isinstance(env, (PearlParallelEnv, PearlVectorEnv)):
        raise ArgumentError(
            f"{type(env).__name__} is no environment of this package; for others, SuperSuit has this wrapper"
        )
    return env


def in_wrappers(env: Any, wrap: Callable[[Any], Any] | None, fits: Callable[[Any], bool]) -> Any:
    """Return an environment as ``wrap`` wraps it, which must not have made another one of it."""
    wrapped = env if wrap is None else wrap(env)
    if not fits(wrapped):
        raise ArgumentError(
            f"wrap returned {type(wrapped).__name__}, which is not the environment it was given in "
            "wrappers of this package"
        )
    return wrapped


def differing(batch: Batch, what: str) -> list[str]:
    """Return the names of the roles whose ``what``, a space, is not that of the rows in arrays."""
    whole = getattr(batch, what)
    return sorted({role.name for role in batch.world.roles if getattr(role, what) != whole})


def _check_roles(batch: Batch, transform: Transform) -> None:
    """Refuse a change that is one to all agents alike where they are not, or that masks do not follow."""
    name = batch.innermost.spec.name
    for what, shown, pad in (
        ("observation_space", transform.observation_space, "pad_observations_v0"),
        ("action_space", transform.action_space, "pad_action_space_v0"),
    ):
        if shown is not getattr(batch, what) and (roles := differing(batch, what)):
            raise ArgumentError(
                f"this wrapper would mix roles, and in {name} {' and '.join(roles)} have another {what} than "
                f"the widest: put {pad} inside it"
            )
    if batch.world.masked and transform.action_space is not batch.action_space:
        raise ArgumentError(
            f"this wrapper changes the action space, and {name} has masks of {batch.action_space}, "
            "which do not follow: change actions before you give them"
        )


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
