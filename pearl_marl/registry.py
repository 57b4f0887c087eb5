"""From a name to an environment's spec.

An environment of this package is a folder under ``envs/`` whose ``spec.py`` defines ``SPEC``;
being there is all the registration it needs. Other packages call :func:`register`.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import pkgutil
import warnings

import gymnasium
import pettingzoo

from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec

_PACKAGE = "pearl_marl.envs"


def _key(name: str) -> str:
    return name.replace("_", "").lower()


@functools.cache
def _specs() -> dict[str, EnvSpec]:
    folders = sorted(
        m.name for m in pkgutil.iter_modules(importlib.import_module(_PACKAGE).__path__) if m.ispkg
    )
    specs = (importlib.import_module(f"{_PACKAGE}.{folder}.spec").SPEC for folder in folders)
    return {_key(spec.name): spec for spec in specs}


def names() -> list[str]:
    """Return the names of all environments, in alphabetical order."""
    return sorted(spec.name for spec in _specs().values())


def get_spec(name: str) -> EnvSpec:
    """Return the spec of an environment by its name, whatever its case.

    Raises
    ------
    ArgumentError
        There is none of that name; the message lists the near ones.
    """
    if not isinstance(name, str):
        raise ArgumentError(f"an environment's name is a string, not {name!r}")
    spec = _specs().get(_key(name))
    if spec is None:
        near = difflib.get_close_matches(_key(name), _specs(), n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(repr(_specs()[k].name) for k in near)}?" if near else ""
        raise ArgumentError(f"there is no environment {name!r}; {hint or 'there are ' + ', '.join(names())}")
    return spec


def register(spec: EnvSpec) -> None:
    """Add an environment from outside this package, under its ``spec.name``.

    It is then known to :func:`pearl_marl.parallel_env` and :func:`pearl_marl.make_vec`, to
    ``pettingzoo.make`` as ``"pearl/Name-v0"`` and to ``gymnasium.make_vec`` as ``"Pearl/Name-v0"``.
    A second registration of the same name replaces the first, with a warning.
    """
    if not isinstance(spec, EnvSpec):
        raise ArgumentError(f"register() takes an EnvSpec, not {type(spec).__name__}")
    if _key(spec.name) in _specs():
        warnings.warn(f"environment {spec.name!r} was registered before and is replaced", stacklevel=2)
    _specs()[_key(spec.name)] = spec
    register_elsewhere(spec)


def register_elsewhere(spec: EnvSpec) -> None:
    """Make an environment known to the registries of PettingZoo and Gymnasium."""
    arguments = {"env_id": spec.name}
    for kind, entry_point in (("parallel", "parallel_env"), ("aec", "env")):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # PettingZoo warns of every replacement; register() has done so
            pettingzoo.register(
                kind, f"pearl/{spec.id}", f"pearl_marl.parallel_env:{entry_point}", kwargs=arguments
            )
    gymnasium.registry.pop(f"Pearl/{spec.id}", None)
    gymnasium.register(
        f"Pearl/{spec.id}", vector_entry_point="pearl_marl.vector_env:make_vec", kwargs=arguments
    )
