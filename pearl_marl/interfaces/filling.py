"""Containers that are filled when somebody looks, and are plain ones from then on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

FEW = 16
"""Up to so many elements a container is filled when it is made: that takes a few microseconds."""


class _Unread:
    """What a container holds until it is filled: neither a name nor a number to code that reads memory."""

    def __repr__(self) -> str:
        return "<not filled yet: take dict(...) or list(...) of the whole>"

    def __reduce__(self) -> str:
        raise TypeError(f"no result can be pickled while it is {self}")


UNREAD = _Unread()


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
