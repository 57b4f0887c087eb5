"""Registering environments: here, and in the registries of PettingZoo and Gymnasium."""

from __future__ import annotations

import warnings
from typing import Any, NoReturn

import gymnasium
import pettingzoo

from pearl_marl import registry
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec


def register(spec: EnvSpec) -> None:
    """Add an environment from outside this package, under its ``spec.name``.

    It is then known to :func:`pearl_marl.parallel_env` and :func:`pearl_marl.make_vec`, to
    ``pettingzoo.make`` as ``"pearl/Name-v0"`` and to ``gymnasium.make_vec`` as ``"Pearl/Name-v0"``.
    A second registration of the same name replaces the first, with a warning.
    """
    registry.register(spec)
    announce(spec)


def announce(spec: EnvSpec) -> None:
    """Make an environment known to the registries of PettingZoo and Gymnasium."""
    arguments = {"env_id": spec.name}
    for kind, entry_point in (("parallel", "parallel:parallel_env"), ("aec", "aec:env")):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # PettingZoo warns of every replacement; register() has done so
            pettingzoo.register(
                kind, f"pearl/{spec.id}", f"pearl_marl.interfaces.{entry_point}", kwargs=arguments
            )
    name = f"Pearl/{spec.id}"
    gymnasium.registry.pop(name, None)
    gymnasium.register(
        name,
        "pearl_marl.interfaces.registration:refuse_make",
        vector_entry_point="pearl_marl.interfaces.vector:make_vec",
        kwargs=arguments,
    )


def refuse_make(env_id: str, **arguments: Any) -> NoReturn:
    """Say what to call instead of ``gymnasium.make``, which makes one sub-environment."""
    name = f"Pearl/{registry.get_spec(env_id).id}"
    raise ArgumentError(
        f"{name} has a vector form only: call gymnasium.make_vec({name!r}, num_envs=...), without a "
        "vectorization_mode, instead of gymnasium.make()"
    )
