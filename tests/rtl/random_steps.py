"""Environments that nobody wrote: golden functions of random operations, to be compiled and compared."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl.spec import EnvSpec, Field, Golden

TABLE = np.array([3, 1, 4, 1, 5, 9, 2, 6])
FAR = np.array([-3, 1, -7, 9, 4, -8, 2, 6])
HIGH = np.array([70000, 70003, 70001, 70007, 70002, 70006, 70004, 70005])
PATTERNS = [
    "{} + {}",
    "{} - {}",
    "{} & {}",
    "{} | {}",
    "{} ^ {}",
    "{} == {}",
    "{} < {}",
    "{} >= {}",
    "np.minimum({}, {})",
    "np.maximum({}, {})",
    "np.where({} > {}, {}, {})",
    "np.where({} != {}, {c}, {})",
    "np.where({} <= {}, {}, 0)",
    "np.where({}, {}, {})",
    "~{}",
    "-{}",
    "{} << {n}",
    "{} >> {n}",
    "{} // {d}",
    "{} % {d}",
    "np.uint8({})",
    "np.int16({})",
    "TABLE[{} & 7]",
    "np.int16({}) * np.uint8({})",
    "np.int32({}) * {c}",
    "np.uint8({}) >> (np.uint8({}) & 7)",
    "np.int16({}) >> ({} & 7)",
    "({} >> ({} & 3)) ^ {}",
    "np.uint8({} << ({} & 15))",
    "(np.int16({}) << ({} & 3)) - {}",
    "np.uint8({}) < np.uint8({})",
    "np.where({} < 0, -1, 1) * ({} - {}) + {}",
    "TABLE[{} & 7] * TABLE[{} % 8] + {}",
    "TABLE[np.uint8({}) % 7]",
    "-1 * (3 - ({} & 3)) + {}",
    "(np.int16({}) * np.int16({}) + {c}) >> {n}",
    "({} << 7) * {c}",
    "FAR[{} & 7]",
    "HIGH[{} & 7] - {}",
    "({} & 31) & {c}",
    "(({} & 31) ^ {}) >> {n}",
    "{} + {c}",
    "({} & {}) | ({} ^ {c})",
]

DIVISIONS = [
    "{} // np.maximum({}, 1)",
    "{} % np.maximum({}, 1)",
    "{} // (({} & 7) + 1)",
    "{} % (({} & 31) + 1)",
    "{} // np.maximum({} >> {n}, {d})",
    "{} - {} % np.maximum(np.int16({}), {d})",
    "np.int16({}) // ((np.uint8({}) & 15) | 1)",
    "np.uint8({}) % ((np.uint8({}) & 15) | 1)",
    "{c} // (({} & 7) + 2)",
    "{c} % np.maximum(np.int16({}), 1)",
    "TABLE[{} % (({} & 7) + 1)]",
]
"""By words."""


def operations(chance: random.Random, words: list[str], count: int, patterns: list[str]) -> list[str]:
    """Return assignments of so many operations to ``v0``, ``v1`` and so on."""
    lines = []
    for k in range(count):
        pattern = chance.choice(patterns)
        # Recent words more often, so that chains get long.
        known = words + words[-3:] * 2
        values = [f"np.int32({chance.choice(known)})" for _ in range(pattern.count("{}"))]
        numbers = {"c": chance.randint(-300, 300), "n": chance.randint(0, 9), "d": chance.randint(1, 20)}
        lines.append(f"    v{k} = {pattern.format(*values, **numbers)}")
        words = [*words, f"v{k}"]
    return lines


def source(chance: random.Random, fields: list[Field], patterns: list[str]) -> str:
    """Return the text of three golden functions over a state of these fields."""
    names = [f.name for f in fields]
    state = ", ".join(names)

    def result(field: Field) -> str:
        word, half = chance.choice([*names, *every]), int(field.signed) << field.bits - 1
        return f"(({word} + {half}) & {(1 << field.bits) - 1}) - {half}"

    count = chance.randint(4, 14)
    every = [f"v{k}" for k in range(count)]
    step = operations(chance, [*names, "action", "draw"], count, patterns)
    moved = ", ".join(result(f) for f in fields)
    end = f"np.uint8(({every[-1]} & 3) == 0)"
    text = [f"def step({state}, action, draw):", *step, f"    return {moved}, np.uint8({every[-1]}), {end}"]
    every = ["v0", "v1"]
    names = []
    fresh = ", ".join(result(f) for f in fields)
    text += ["def initial(draw):", *operations(chance, ["draw"], 2, patterns), f"    return {fresh}"]
    seen = operations(chance, [f.name for f in fields], 2, patterns)
    text += [f"def observe({state}):", *seen, "    return np.int32(v0), np.int32(v1)"]
    return "\n".join(text) + "\n"


def random_spec(seed: int | random.Random, divided: bool = False) -> EnvSpec:
    """Return an environment of random golden functions; of one seed always the same.

    Where words are ``divided`` by words, every other operation is such a division.
    """
    chance = random.Random(seed) if isinstance(seed, int) else seed
    fields = [
        Field(f"word_{k}", chance.choice([1, 2, 3, 5, 8, 13, 16]), signed=chance.random() < 0.4)
        for k in range(chance.randint(1, 4))
    ]
    scope: dict[str, Any] = {"np": np, "TABLE": TABLE, "FAR": FAR, "HIGH": HIGH}
    often = len(PATTERNS) // len(DIVISIONS)
    text = source(chance, fields, PATTERNS + DIVISIONS * often if divided else PATTERNS)
    exec(compile(text, "<a random step>", "exec"), scope)
    number = Field("first", 32, signed=True), Field("second", 32, signed=True)
    return EnvSpec(
        name="Random",
        version=0,
        summary=text,
        state=tuple(fields),
        action=Field("action", 2),
        observation=number,
        reward=Field("reward", 8),
        rewards=None,
        observation_space=Box(-(2**31), 2**31 - 1, (2,), np.int32),
        action_space=Discrete(4),
        golden=Golden(scope["initial"], scope["step"], scope["observe"]),
        reset_draws=1,
        step_draws=1,
    )
