"""How messages name a line of an author's file."""

from __future__ import annotations

import os
import types
from typing import Any


def place_of(file: str, line: int) -> str:
    """Return a file, with its folder, and a line."""
    return f"{os.sep.join(file.split(os.sep)[-2:])}, line {line}"


def author_of(function: Any) -> types.FunctionType:
    """Return the function that an author wrote, of one that calls it with words."""
    author: types.FunctionType = getattr(function, "author", function)
    return author
