"""What an object of somebody else's class holds: data, generators of random numbers, and the rest."""

from __future__ import annotations

import enum
import random
import types
from collections.abc import Callable, Hashable, Iterator
from typing import Any

import numpy as np

SCALARS = (bool, int, float, str, bytes, type(None), np.generic, enum.Enum, complex)
PARTS = (list, tuple, dict, set, frozenset)
SEEDS = "_np_random_seed"
"""Where Gymnasium's environments keep what they were seeded with."""
DEEPEST = 8
"""How many objects inside one another are looked into."""


def is_generator(value: object) -> bool:
    """Return whether a value makes random numbers."""
    return isinstance(value, (np.random.Generator, np.random.RandomState, random.Random)) or getattr(
        value, "makes_random_numbers", False
    )


def is_group(value: object) -> bool:
    """Return whether a value is an object whose attributes are data of the environment's own."""
    kind = type(value)
    if isinstance(value, (*SCALARS, *PARTS, np.ndarray, type, types.ModuleType)) or callable(value):
        return False
    if is_generator(value) or not hasattr(value, "__dict__"):
        return False
    return kind.__module__.partition(".")[0] not in ("pygame", "builtins", "matplotlib", "weakref") and not (
        kind.__module__.startswith(("gymnasium.spaces", "gymnasium.envs.registration", "numpy."))
    )


def frozen(value: Any, inside: tuple[int, ...] = ()) -> Hashable:
    """Return what tells two contents apart: equal for equal data, without generators and windows."""
    if isinstance(value, np.ndarray):
        if value.dtype == object:
            return ("array", value.shape, frozen(value.tolist(), inside))
        return ("array", value.shape, value.dtype.str, value.tobytes())
    if isinstance(value, enum.Enum):
        return (type(value).__name__, value.name)
    if isinstance(value, np.generic):
        return value.item()  # type: ignore[no-any-return]
    if isinstance(value, SCALARS):
        return value
    if len(inside) > DEEPEST or id(value) in inside:
        return None
    inside = (*inside, id(value))
    if isinstance(value, (list, tuple)):
        return (len(value), *(frozen(part, inside) for part in value))
    if isinstance(value, dict):
        return ("dict", frozenset((frozen(key), frozen(part, inside)) for key, part in value.items()))
    if isinstance(value, (set, frozenset)):
        return frozenset(frozen(part, inside) for part in value)
    if is_group(value):
        parts = ((key, part) for key, part in sorted(vars(value).items()) if key != SEEDS)
        return (type(value).__name__, *((key, frozen(part, inside)) for key, part in parts))
    return None


def elements(seen: Any) -> tuple[float, ...]:
    """Return an observation as numbers, one a field."""
    return tuple(map(float, np.ravel(seen)))


def _objects(root: Any) -> Iterator[Any]:
    """Yield what an object holds that is no number or text, itself first, each once."""
    waiting, met = [root], {id(root)}
    while waiting:
        value = waiting.pop()
        yield value
        parts: Any = ()
        if isinstance(value, dict):
            parts = value.values()
        elif isinstance(value, PARTS):
            parts = value
        elif is_group(value):
            parts = vars(value).values()
        for part in parts:
            if not isinstance(part, (*SCALARS, np.ndarray)) and id(part) not in met:
                met.add(id(part))
                waiting.append(part)


def kept(root: Any) -> dict[int, Any]:
    """Return the memo of a deep copy that shares what is no data, such as windows and spaces."""
    copied = (*PARTS, np.random.Generator, np.random.RandomState, random.Random)
    return {id(v): v for v in _objects(root) if not isinstance(v, copied) and not is_group(v)}


def reseeded(generator: Any, seed: int) -> Any:
    """Return a generator of the same kind with a seed."""
    if isinstance(generator, np.random.RandomState):
        return np.random.RandomState(seed)
    return random.Random(seed) if isinstance(generator, random.Random) else np.random.default_rng(seed)


def replaced(root: Any, other: Callable[[Any], Any]) -> None:
    """Put another generator of random numbers, made for it, wherever an object has one."""
    for value in list(_objects(root)):
        if is_group(value):
            for key, part in list(vars(value).items()):
                if is_generator(part):
                    setattr(value, key, other(part))


def leaves_of(root: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield the attributes that are data, by their paths: ``"game.ball"``."""
    for key, value in vars(root).items():
        path = f"{prefix}{key}"
        if key == SEEDS:
            continue
        if isinstance(value, (*SCALARS, *PARTS, np.ndarray)):
            yield path, value
        elif is_group(value) and depth < 3:
            yield from leaves_of(value, f"{path}.", depth + 1)
