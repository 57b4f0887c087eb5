"""Containers that are filled when somebody looks, and are plain ones from then on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def fill_first(unfilled: type[Any], plain: type[Any], *names: str) -> None:
    """Give a container that is not filled yet methods of a plain one that fill it, and its like, first.

    ``unfilled`` has a method ``fill``, which makes the object one of another class.
    """
    for name in names:
        setattr(unfilled, name, _filled_first(unfilled, getattr(plain, name)))


def _filled_first(unfilled: type[Any], plain: Callable[..., Any]) -> Callable[..., Any]:
    def method(self: Any, *args: Any, **kwargs: Any) -> Any:
        for lazy in (self, *args):
            if isinstance(lazy, unfilled):
                lazy.fill()
        return plain(self, *args, **kwargs)

    method.__name__ = plain.__name__
    method.__doc__ = plain.__doc__
    return method
