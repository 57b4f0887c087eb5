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


def author_of(function: Any) -> types.FunctionType:
    """Return the function that an author wrote, of one that calls it with words."""
    author: types.FunctionType = getattr(function, "author", function)
    return author
