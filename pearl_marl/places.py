"""How messages name a line of an author's file."""

from __future__ import annotations

import os
import sys
import types
from typing import Any


def place_of(file: str, line: int) -> str:
    """Return a file, with its folder, and a line."""
    return f"{os.sep.join(file.split(os.sep)[-2:])}, line {line}"


def is_librarys(module: str) -> bool:
    """Return whether a module is Python's own or NumPy's."""
    package = module.partition(".")[0]
    return package == "numpy" or package in sys.stdlib_module_names


def author_line(error: BaseException) -> str | None:
    """Return where an author's code was at work when it failed; ``None`` where none of it was."""
    found, trace_back = None, error.__traceback__
    while trace_back is not None:
        frame = trace_back.tb_frame
        if not _is_ours(frame):
            found = place_of(frame.f_code.co_filename, trace_back.tb_lineno)
        trace_back = trace_back.tb_next
    if isinstance(error, SyntaxError) and error.filename and error.lineno:
        return place_of(error.filename, error.lineno)
    return found


def _is_ours(frame: types.FrameType) -> bool:
    module = frame.f_globals.get("__name__", "")
    own = module.startswith("pearl_marl.") and not module.startswith("pearl_marl.envs.")
    # A dataclass has methods that Python wrote.
    return own or is_librarys(module) or frame.f_code.co_filename == "<string>"


def author_of(function: Any) -> types.FunctionType:
    """Return the function that an author wrote, of one that calls it with words."""
    author: types.FunctionType = getattr(function, "author", function)
    return author
