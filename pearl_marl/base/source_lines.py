"""How messages name a line of an author's file."""

from __future__ import annotations

import os
import sys
import types
from collections.abc import Callable
from typing import Any


def source_line(file: str, line: int) -> str:
    """Return a file, with its folder, and a line."""
    return f"{os.sep.join(file.split(os.sep)[-2:])}, line {line}"


def is_of_a_library(module: str) -> bool:
    """Return whether a module is Python's own or NumPy's."""
    package = module.partition(".")[0]
    return package == "numpy" or package in sys.stdlib_module_names


def last_line_of_an_author(error: BaseException, is_authors: Callable[[str], bool]) -> str | None:
    """Return where an author's code was at work when it failed; ``None`` where none of it was.

    ``is_authors`` says whether a module is an author's, by its name.
    """
    found, trace_back = None, error.__traceback__
    while trace_back is not None:
        frame = trace_back.tb_frame
        # A dataclass has methods that Python wrote.
        if is_authors(frame.f_globals.get("__name__", "")) and frame.f_code.co_filename != "<string>":
            found = source_line(frame.f_code.co_filename, trace_back.tb_lineno)
        trace_back = trace_back.tb_next
    return found


def is_an_authors(module: str) -> bool:
    """Return whether a module is neither of this package, but for its environments, nor a library's."""
    own = module.startswith("pearl_marl.") and not module.startswith("pearl_marl.envs.")
    return not own and not is_of_a_library(module)


def author_of(function: Any) -> types.FunctionType:
    """Return the function that an author wrote, of one that calls it with words."""
    author: types.FunctionType = getattr(function, "author", function)
    return author
