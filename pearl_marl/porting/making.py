"""The package that follows an original: whole, of tables, where that is finite; else a skeleton."""

from __future__ import annotations

from typing import Any, NamedTuple

from pearl_marl.errors import ArgumentError, one_line
from pearl_marl.porting.attributes import observed
from pearl_marl.porting.finite import NotFiniteError, finite
from pearl_marl.porting.originals import Original
from pearl_marl.porting.package import of_tables, options_on_a_command
from pearl_marl.porting.skeleton import of_skeleton
from pearl_marl.porting.tables import tables


class Package(NamedTuple):
    """Files, and what they are."""

    files: dict[str, str | bytes]
    """By their paths in the package's folder."""
    whole: bool
    """Whether nothing is to be filled in."""
    why: str | None
    """Why it is not whole, as a clause about the original."""
    said: str
    """What was made, as a sentence."""
    against: str
    """The original, as ``pearl verify --against`` takes it."""


def made(name: str, original_name: str, options: dict[str, Any], rules: bool = False) -> Package:
    """Return the package of an environment that follows an original; with ``rules`` no tables are made.

    Raises
    ------
    ArgumentError
        There is no such original, or this platform has no such spaces.
    """
    original = Original(original_name, **options)
    against = original_name + options_on_a_command(options, "--original-option")
    why: str | None = None
    if not rules:
        try:
            found = finite(original)
            files = of_tables(name, original, found, tables(found))
            said = (
                f"All {found.states:,} states of {original_name} with their transitions are in tables, "
                f"with {found.width} outcome{'s' * (found.width > 1)} of an action at most."
            )
            return Package(files, True, None, said, against)
        except NotFiniteError as error:
            why = str(error)
        except Exception as error:  # of the original, run with what it does not expect
            why = f"it cannot be run in every state: {type(error).__name__}: {one_line(error)}"
        original = Original(original_name, **options)
    try:
        seen = observed(original)
    except Exception as error:  # of the original's own
        raise ArgumentError(
            f"{original_name} fails when random actions run it: {type(error).__name__}: {one_line(error)}"
        ) from error
    reason = f"No tables were made of {original_name}, as {why}; t" if why else "T"
    said = f"{reason}he skeleton was written instead, after {seen.steps:,} steps of it."
    if not why:
        said = f"The skeleton was written after {seen.steps:,} steps of {original_name}."
    return Package(of_skeleton(name, original, seen, why), False, why, said, against)
