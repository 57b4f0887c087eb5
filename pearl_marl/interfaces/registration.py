"""Registering environments: here, and in the registries of PettingZoo and Gymnasium.

Neither library is imported for that. One that is imported already is told at once, the other when it is.
"""

from __future__ import annotations

import sys
import warnings
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn

from pearl_marl import envs
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.importing import when_imported

if TYPE_CHECKING:
    from pearl_marl.spec import EnvSpec


def register(spec: EnvSpec) -> None:
    """Add an environment from outside this package, under its ``spec.name``.

    It is then known to :func:`pearl_marl.parallel_env` and :func:`pearl_marl.make_vec`, to
    ``pettingzoo.make`` as ``"pearl/Name-v0"`` and to ``gymnasium.make_vec`` as ``"Pearl/Name-v0"``.
    A second registration of the same name replaces the first, with a warning.
    """
    envs.register(spec)
    for library, announce in _LIBRARIES.items():
        if library in sys.modules:
            announce(spec.name, spec.id)


def announce_all() -> None:
    """Make every environment known to the registries of PettingZoo and Gymnasium."""
    for library in _LIBRARIES:
        when_imported(library, partial(_announce_all_to, library))


def _announce_all_to(library: str) -> None:
    for name, env_id in envs.ids().items():
        _LIBRARIES[library](name, env_id)


def _announce_to_gymnasium(name: str, env_id: str) -> None:
    from gymnasium.envs import registration

    registered = f"Pearl/{env_id}"
    registration.registry.pop(registered, None)
    registration.register(
        registered,
        "pearl_marl.interfaces.registration:refuse_make",
        vector_entry_point="pearl_marl.interfaces.vector:make_vec",
        kwargs={"env_id": name},
    )


def _announce_to_pettingzoo(name: str, env_id: str) -> None:
    import pettingzoo

    for kind, entry_point in (("parallel", "parallel:parallel_env"), ("aec", "aec:env")):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # PettingZoo warns of every replacement; register() has done so
            pettingzoo.register(
                kind, f"pearl/{env_id}", f"pearl_marl.interfaces.{entry_point}", kwargs={"env_id": name}
            )


_LIBRARIES = {"gymnasium": _announce_to_gymnasium, "pettingzoo": _announce_to_pettingzoo}


def refuse_make(env_id: str, **arguments: Any) -> NoReturn:
    """Say what to call where one sub-environment is asked for: by ``gymnasium.make``, or to vectorise it."""
    name = f"Pearl/{envs.get_spec(env_id).id}"
    raise ArgumentError(
        f"{name} has a vector form only: call gymnasium.make_vec({name!r}, num_envs=...), without a "
        "vectorization_mode"
    )
