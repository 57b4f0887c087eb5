"""The environments, a folder each with ``spec.py``, ``step.py`` and ``README.md``; and from a name to a spec.

Being there, with a ``SPEC`` in its ``spec.py``, is all the registration that an environment needs. Other
packages call :func:`pearl_marl.register` when they are imported, and ``"my_package:MyEnv"`` imports them.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import pkgutil
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from pearl_marl.base.source_lines import is_of_a_library, last_line_of_an_author, source_line
from pearl_marl.errors import ArgumentError, brief

if TYPE_CHECKING:
    from pearl_marl.spec import EnvSpec


def _key(name: str) -> str:
    return name.replace("_", "").lower()


@functools.cache
def _folders() -> dict[str, str]:
    """Return the folders of this package's environments, by the keys of their names."""
    return {_key(module.name): module.name for module in pkgutil.iter_modules(__path__) if module.ispkg}


_specs: dict[str, EnvSpec] = {}
"""Those that somebody has asked for, or registered, by the keys of their names."""


def ids() -> dict[str, str]:
    """Return the ids of all environments, as in ``"CliffWalking-v0"``, by their names in alphabetical order.

    An environment of this package has its folder's name and, as a test holds all to, version 0: nothing is
    imported to list them.
    """
    folders = ("".join(map(str.capitalize, folder.split("_"))) for folder in _folders().values())
    known = {name: f"{name}-v0" for name in folders if _key(name) not in _specs}
    return dict(sorted((known | {spec.name: spec.id for spec in _specs.values()}).items()))


def names() -> list[str]:
    """Return the names of all environments, in alphabetical order."""
    return list(ids())


def get_spec(name: str) -> EnvSpec:
    """Return the spec of an environment by its name, whatever its case, or by its id: ``"CliffWalking-v0"``.

    ``"my_package:MyEnv"`` imports ``my_package`` first, where ``MyEnv`` is registered.

    Raises
    ------
    ArgumentError
        There is none of that name, and the message lists the near ones; or no such module.
    """
    if not isinstance(name, str):
        raise ArgumentError(f"an environment's name is a string, not {name!r}")
    module, colon, plain = name.rpartition(":")
    if not colon:
        return registered_spec(name)
    _import(module, name)
    return _spec(plain, f"module {module!r} registers no environment {plain!r}")


def registered_spec(name: str) -> EnvSpec:
    """Return the spec of an environment as :func:`get_spec` does, and import no package for its name.

    Names that stand in a file are looked up here: others may have written them.
    """
    return _spec(name, f"there is no environment {brief(name)}")


def _spec(name: str, missing: str) -> EnvSpec:
    """Return the spec of that name or id; else raise ArgumentError, which begins with ``missing``."""
    plain, versioned, version = name.partition("-v")
    key = _key(plain)
    if key not in _specs and key in _folders():
        _specs[key] = importlib.import_module(f"{__name__}.{_folders()[key]}.spec").SPEC
    spec = _specs.get(key)
    if spec is not None and versioned and version != str(spec.version):
        raise ArgumentError(f"there is no environment {name!r}; {spec.name} has the id {spec.id!r}")
    if spec is None:
        known = {_key(other): other for other in names()}
        near = difflib.get_close_matches(key, known, n=3)
        hint = f"did you mean {' or '.join(repr(known[k]) for k in near)}?" if near else ""
        raise ArgumentError(f"{missing}; {hint or 'there are ' + ', '.join(names())}")
    return spec


def _import(module: str, name: str) -> None:
    """Import the module that stands before the colon of an environment's name."""
    if not all(part.isidentifier() for part in module.split(".")):
        raise ArgumentError(f"{name!r} names no module before its colon; write 'my_package:MyEnv'")
    package = module.partition(".")[0]
    if not is_of_a_library(package):
        _packages.add(package)
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        # What the module itself fails to import is its own affair.
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise
        folder = _folder_of(package) if error.name == package else None
        raise ArgumentError(
            f"there is no module {error.name!r} for {name!r}; install the package (pip install -e .), or add "
            f"{folder or 'its folder'} to PYTHONPATH"
        ) from None
    except SystemExit as error:  # which would be taken for the end of the caller
        raise ArgumentError(f"the module {module!r} ends Python when it is imported") from error


_packages: set[str] = set()
"""The packages of authors that names of environments have led to."""


def authors_mistake(error: Exception) -> str | None:
    """Return an exception as a sentence with the line of an author's package; ``None`` if none failed."""
    place = last_line_of_an_author(error, lambda module: module.partition(".")[0] in _packages)
    if _packages and isinstance(error, SyntaxError) and error.filename and error.lineno:
        return f"{source_line(error.filename, error.lineno)}: {type(error).__name__}: {error.msg}"
    told = ": ".join([type(error).__name__, *str(error).splitlines()[:1]])
    return f"{place}: {told}" if place else None


def _folder_of(package: str) -> Path | None:
    """Return the folder that a package is in, if that is the current one or the one around it."""
    here = Path.cwd()
    found = (
        f
        for f in (here, here.parent)
        if (f / package / "__init__.py").exists() or (f / f"{package}.py").exists()
    )
    return next(found, None)


ARGUMENTS = {
    *("env_id", "n_agents", "num_envs", "device", "autoreset", "autoreset_mode", "max_cycles", "rewards"),
    *("initial_states", "render_mode", "copy", "observations"),
}
"""What ``parallel_env`` and ``make_vec`` take for themselves: no option can have such a name."""


def register(spec: EnvSpec) -> None:
    """Add an environment under its ``spec.name``; one of the same name is replaced, with a warning.

    Raises
    ------
    ArgumentError
        It is no spec, or an option has the name of an argument of ``parallel_env`` or ``make_vec``.
    """
    from pearl_marl.spec import EnvSpec
    from pearl_marl.spec.pickling import found_by

    if not isinstance(spec, EnvSpec):
        raise ArgumentError(f"register() takes an EnvSpec, not {type(spec).__name__}")
    if hidden := ARGUMENTS & {*spec.options}:
        raise ArgumentError(
            f"{spec.name} has an option {min(hidden)!r}, which parallel_env() and make_vec() take for "
            "themselves: give it another name"
        )
    if _key(spec.name) in {**_folders(), **_specs}:
        warnings.warn(f"environment {spec.name!r} was registered before and is replaced", stacklevel=3)
    _specs[_key(spec.name)] = spec
    found_by(spec.id, registered_spec)
