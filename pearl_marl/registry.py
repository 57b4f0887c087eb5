"""From a name to an environment's spec.

An environment of this package is a folder under ``envs/`` whose ``spec.py`` defines ``SPEC``;
being there is all the registration it needs. Other packages call :func:`pearl_marl.register` when they are
imported, and ``"my_package:MyEnv"`` imports them.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import pkgutil
import warnings

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

    ``"my_package:MyEnv"`` imports ``my_package`` first, where ``MyEnv`` is registered.

    Raises
    ------
    ArgumentError
        There is none of that name, and the message lists the near ones; or no such module.
    """
    if not isinstance(name, str):
        raise ArgumentError(f"an environment's name is a string, not {name!r}")
    module, colon, plain = name.rpartition(":")
    if colon:
        _import(module, name)
    spec = _specs().get(_key(plain))
    if spec is None:
        near = difflib.get_close_matches(_key(plain), _specs(), n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(repr(_specs()[k].name) for k in near)}?" if near else ""
        missing = f"module {module!r} registers no environment {plain!r}" if colon else ""
        raise ArgumentError(
            f"{missing or f'there is no environment {name!r}'}; {hint or 'there are ' + ', '.join(names())}"
        )
    return spec


def _import(module: str, name: str) -> None:
    """Import the module that stands before the colon of an environment's name."""
    if not all(part.isidentifier() for part in module.split(".")):
        raise ArgumentError(f"{name!r} names no module before its colon; write 'my_package:MyEnv'")
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        # What the module itself fails to import is its own affair, and told by the traceback.
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise
        raise ArgumentError(
            f"there is no module {error.name!r} for {name!r}; install the package (pip install -e .), or add "
            "its folder to PYTHONPATH"
        ) from None


def register(spec: EnvSpec) -> None:
    """Add an environment under its ``spec.name``; one of the same name is replaced, with a warning."""
    if not isinstance(spec, EnvSpec):
        raise ArgumentError(f"register() takes an EnvSpec, not {type(spec).__name__}")
    if _key(spec.name) in _specs():
        warnings.warn(f"environment {spec.name!r} was registered before and is replaced", stacklevel=3)
    _specs()[_key(spec.name)] = spec
