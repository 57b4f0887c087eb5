"""What the state of an original is: the attributes that a reset or a step changes, found by running it."""

from __future__ import annotations

import copy
import keyword
import math
import re
import time
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.porting.contents import elements, frozen, leaves_of
from pearl_marl.porting.originals import Original

EPISODES, STEPS, SECONDS = 30, 200, 3.0
"""How long it is run: at most so many seeds, each for so many steps, and for this time."""

LOOKS_AT_DICTS = 50
"""How often it is looked into a dict, which may be a large table that never changes."""

MOST = 1e6
"""The greatest bound of a real that is proposed."""

RESERVED = ("elapsed", "ended", *keyword.kwlist)

MOST_PARTS = 1024
"""Numbers of an array that a skeleton gives a state."""


class Attribute(NamedTuple):
    """One attribute that changes."""

    path: str
    """From the environment on: ``"game.ball"``."""
    name: str
    """What the State calls it."""
    kind: str | None
    """The annotation that is proposed; ``None`` where none fits."""
    real: bool
    note: str
    """What was seen."""


class Seen(NamedTuple):
    """What running an original showed."""

    attributes: list[Attribute]
    steps: int
    random_starts: bool
    """Whether different seeds begin in different states."""
    random_steps: bool
    """Whether a step depends on a seed."""
    rewards: tuple[float, ...]
    """The different rewards, at most 17."""
    observed: tuple[Any, Any]
    """The least and the greatest observation, element by element."""
    whole: bool
    """Whether observations are integers."""

    @property
    def reals(self) -> bool:
        """Whether the state has reals."""
        return any(attribute.real and attribute.kind for attribute in self.attributes)


def observed(original: Original) -> Seen:
    """Run an original by random actions from some seeds; return what changed, and how."""
    values: dict[str, dict[Any, Any]] = {}
    rewards: dict[float, None] = {}
    rows: list[Any] = []
    firsts = set()
    random_steps = False
    rng = np.random.default_rng(0)
    until, steps, looks = time.monotonic() + SECONDS, 0, 0

    def look() -> None:
        nonlocal looks
        looks += 1
        for path, value in leaves_of(original.env):
            if isinstance(value, dict) and looks > LOOKS_AT_DICTS:
                continue
            of_path = values.setdefault(path, {})
            if len(of_path) < 4096:
                of_path.setdefault(frozen(value), copy.copy(value))
        rows.extend(elements(seen) for seen in original.observations if seen is not None)

    for seed in range(EPISODES):
        original.reset(seed)
        look()
        firsts.add(tuple(frozen(v) for _, v in leaves_of(original.env) if not isinstance(v, dict)))
        for k, actions in enumerate(islice(original.habits(rng, seed), STEPS)):
            if k < 5 and seed < 5:
                random_steps |= _depends_on_chance(original, actions)
            outcome = original.step(actions)
            steps += 1
            for reward in outcome.rewards:
                if len(rewards) < 17:
                    rewards.setdefault(reward)
            look()
            if outcome.over or time.monotonic() > until:
                break
        if time.monotonic() > until and seed > 1:
            break
    changed = [(path, list(of_path.values())) for path, of_path in values.items() if len(of_path) > 1]
    taken: set[str] = set()
    attributes = [_attribute(path, all_values, taken) for path, all_values in changed]
    matrix = np.array(rows)
    return Seen(
        attributes,
        steps,
        len(firsts) > 1,
        random_steps,
        tuple(rewards),
        (matrix.min(0), matrix.max(0)),
        bool(np.array_equal(matrix, np.rint(matrix))),
    )


def _depends_on_chance(original: Original, actions: list[Any]) -> bool:
    """Return whether two seeds make a difference to a step."""
    results = []
    for seed in (1, 2, 3, 4):
        other = original.copied()
        other.reseed(seed)
        outcome = other.step(actions)
        results.append((frozen(other.env), tuple(outcome.rewards), tuple(outcome.terminated)))
    return len(set(results)) > 1


def _attribute(path: str, values: list[Any], taken: set[str]) -> Attribute:
    """Return what is proposed for an attribute with these values."""
    parts = [re.sub(r"\W|^(?=\d)", "_", part).strip("_") or "value" for part in path.split(".")]
    names = ["_".join(parts[k:]) for k in range(len(parts) - 1, -1, -1)]  # the shortest that is free
    free = (name for name in names if name not in taken and name not in RESERVED)
    name = next(free, f"{names[-1]}_{len(taken)}")
    taken.add(name)
    there = [value for value in values if value is not None]
    kinds = sorted({type(value).__name__ for value in there})
    arrays = [np.asarray(v) for v in there if _is_regular(v)]
    none = "None, or " if len(there) < len(values) else ""
    if len(arrays) < len(there) or not arrays:
        return Attribute(path, name, None, False, f"{none}{_values_found(there, kinds)}")
    shapes = {array.shape for array in arrays}
    low, high = min(a.min() for a in arrays), max(a.max() for a in arrays)
    real = any(a.dtype.kind == "f" and not np.array_equal(a, np.rint(a)) for a in arrays)
    floats = any(a.dtype.kind == "f" for a in arrays)
    span = f"{low:.6g} to {high:.6g}"
    if len(shapes) == 1 and arrays[0].ndim and real and arrays[0].size <= 8:
        all_rows = np.stack([a.ravel() for a in arrays])
        ends = zip(all_rows.min(0), all_rows.max(0), strict=True)
        span = ", ".join(f"{least:.4g} to {most:.4g}" for least, most in ends)
    if len(shapes) > 1:
        lengths = sorted(shape[0] for shape in shapes)
        kind = kind_of(low, high, real)
        note = (
            f"{none}a list of {lengths[0]} to {lengths[-1]} numbers, {span}: keep one of the longest, "
            f"`Array[{kind}, {max(lengths[-1], 1)}]`, and its length"
        )
        return Attribute(path, name, None, real, note)
    (shape,) = shapes
    if none or int(np.prod(shape)) > MOST_PARTS:
        what = f"{none}{span}" + (f", of shape {shape}" if shape else "")
        return Attribute(path, name, None, real, what)
    kind = kind_of(low, high, real)
    if shape:
        kind = f"Array[{kind}, {', '.join(map(str, shape))}]"
    what = "real, " if real else "whole numbers in floats, " if floats else ""
    return Attribute(path, name, kind, real, f"{what}seen {span}")


def _is_regular(value: Any) -> bool:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    return array.dtype.kind in "biuf" and array.size > 0


def kind_of(low: Any, high: Any, real: bool) -> str:
    """Return the annotation that is proposed for numbers of a range."""
    if real or not np.isfinite([low, high]).all():
        if low < 0 < high:
            low, high = min(low, -high), max(high, -low)
        return f"Real[{_outward(min(low, 0))}, {_outward(max(high, 0))}]"
    low, high = int(low), int(high)
    if low >= 0 and high <= 1:
        return "Flag"
    if low >= 0 and high & (high + 1) == 0:
        return f"Bits[{high.bit_length()}]"
    return f"Range[{min(low, 0)}, {high}]"


def _outward(end: float) -> str:
    """Return the first of 1, 2 and 5 times powers of ten that is as far from 0 as a number, or farther."""
    most = min(abs(float(end)), MOST) if math.isfinite(end) else 1000.0
    if most == 0:
        return "0"
    power = 10.0 ** math.floor(math.log10(most))
    found = next(step * power for step in (1, 2, 5, 10) if step * power >= most)
    return f"{math.copysign(found, end):g}".replace("e+06", "_000_000")


def _values_found(values: list[Any], kinds: list[str]) -> str:
    if all(isinstance(value, str) for value in values) and values:
        some = sorted(set(values))
        return "one of " + ", ".join(map(repr, some[:6])) + (" ..." if len(some) > 6 else "")
    return f"{' or '.join(kinds)}: nothing that a field holds" if kinds else "None"
