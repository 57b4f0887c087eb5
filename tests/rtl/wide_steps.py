"""Environments of wide and signed words: golden functions of whose text simulators know less than synthesis.

Words have up to 64 bits, with a sign or without. They are cut, divided, compared with each other as they are,
and their upper bits and signs read tables.
"""

from __future__ import annotations

import itertools
import random
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl.compiler.straight_line import golden_functions
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, Field, Golden

TABLES = {
    "PAIR": np.array([5, -3]),
    "FOUR": np.array([16, 0, 0, 127]),
    "EIGHT": np.array([3, -1, 4, -1, 5, -9, 2, -6]),
    "LONG": np.array([(k * k * 2654435761) % 1000 - 500 for k in range(16)]),
    "ODD": np.array([7, -100, 70000, 1, 0]),
}

PATTERNS = [
    "{} + {}",
    "{} - {}",
    "-{}",
    "~{}",
    "{} & {}",
    "{} | {}",
    "{} ^ {}",
    "{} + {c}",
    "{c} - {}",
    "{} == {}",
    "{} < {}",
    "{} >= {}",
    "{} < {c}",
    "{} >> {n}",
    "np.int32({}) * {c}",
    "(np.int16({}) * np.int16({})) >> {n}",
    "{} // {d}",
    "{} % {d}",
    "({} % {d}) & 1",
    "(({} // {d}) & 7) * 6 & 4",
    "({} >> {n}) // {d}",
    "({} - {}) % {d}",
    "np.int32({}) // {d} - {}",
    "{} >> ({} & 63)",
    "np.int32({}) << (({} >> {n}) & 15)",
    "(np.int8({}) >> ({} & 7)) < {}",
    "np.where({} < {}, {}, {})",
    "np.where({} & 1 == 1, {}, {c})",
    "np.where({} == {}, {} >> {n}, -1)",
    "np.minimum({}, {})",
    "np.maximum({}, {c})",
    "PAIR[({} >> {n}) & 1]",
    "PAIR[({} < 0) & ({} > {c})]",
    "FOUR[({} >> {n}) & 3]",
    "FOUR[np.where({} < {}, {} >> 6, {} >> 5) & 3]",
    "FOUR[(~{} >> {n}) & 3] - {}",
    "EIGHT[(np.int8({}) >> ({} & 7)) & 7]",
    "EIGHT[np.int8({}) // 32 + 4]",
    "EIGHT[(({} & 3) - 2) & 7]",
    "EIGHT[np.where({} < 0, -1, 2) & 7]",
    "EIGHT[({} & 1) * 4 + ({} >> {n} & 1) * 2 + ({} % 2)]",
    "LONG[({} - {}) & 15] * FOUR[({} >> {n}) & 3]",
    "LONG[np.int64({}) >> 60 & 15]",
    "ODD[{} % 5]",
    "ODD[FOUR[({} >> {n}) & 3] % 5] + {}",
    "np.int8({}) - np.int8({}) < {c}",
    "(np.int8({}) ^ np.uint8({})) >> {n}",
    "np.int8({} >> {n})",
    "np.int32({})",
    "np.uint32({} >> {n})",
]

CASTS = "np.int64", "np.int32", "np.int8", "np.uint64", ""

Word = tuple[str, int, bool]
"""A field of the state: its name, bits, and whether it has a sign."""

X, Y, WIDE = ("x", 8, True), ("y", 8, True), ("x", 64, True)
FIXED: list[tuple[list[Word], str]] = [
    ([X], "x, FOUR[(x >> 7) & 3], 0"),  # a table's index with a sign
    ([X, Y], "y, x, FOUR[np.where(action < 2, x >> 7, y >> 6) & 3], 0"),
    ([("x", 64, False)], "(x % 10) & 1, 0, 0"),  # a sum of which no term is left
    ([X], "x, EIGHT[(x >> action) & 7], EIGHT[x // 64 & 7] < 0"),
    ([("x", 3, True), Y], "x ^ 1, y, EIGHT[x + 4], EIGHT[x & 7] < 0"),
    ([WIDE], "(x >> 1) ^ -1, PAIR[(x >> 63) & 1], x < 0"),
    ([WIDE], "(x % 10) & 1, ((x // 3) * 8 + 5) & 7, (x * 2) & 1"),
    ([("x", 64, False)], "x ^ (x % 6 & 1), (x * 6 + 4 * action) & 3, 0"),
    ([WIDE], "-1, 3, 1"),  # nothing but constants
    ([WIDE, Y], "x, y, y, 0"),  # nothing but wires
    ([WIDE, ("y", 63, False)], "np.where(x < y, y, 1), (x ^ y) & 1023, x < y, (y < 3) ^ (x == y)"),
    ([X, ("soft", 8, False), ("soft_", 8, True)], "soft_, np.uint8(x), np.int8(soft), soft & 63, x < soft_"),
]
"""What has gone wrong, and its relatives: the state, and the results of a step."""


def wrapped(word: str, field: Field) -> str:
    """Return an expression that is a word of the field, whatever the word is."""
    half = int(field.signed) << field.bits - 1
    low = f"({word}) & {(1 << field.bits) - 1}"
    return f"(({low}) ^ {half}) - {half}" if half else low


def operations(chance: random.Random, words: list[str], count: int) -> list[str]:
    """Return assignments of so many operations to ``v0``, ``v1`` and so on."""
    lines = []
    for k in range(count):
        pattern = chance.choice(PATTERNS)
        values = [chance.choice(words + words[-2:]) for _ in range(pattern.count("{}"))]
        numbers = {
            "c": chance.choice([-300, -7, -1, 1, 3, 100, 5_000, 2**31 - 1]),
            "n": chance.choice([0, 1, 2, 3, 5, 6, 7, 15, 31, 62, 63]),
            "d": chance.choice([2, 3, 5, 7, 10, 12, 64, 100, 641, 1_000]),
        }
        value = pattern.format(*values, **numbers)
        # Words of more bits than a kernel can hold are refused.
        lines.append(
            f"    v{k} = {chance.choice(['np.int64', 'np.int32', 'np.int8', 'np.uint64', ''])}({value})"
        )
        words = [*words, f"v{k}"]
    return lines


def random_source(chance: random.Random, fields: list[Field], reward: Field) -> str:
    """Return the text of three golden functions over a state of these fields."""
    names, count = [f.name for f in fields], chance.randint(2, 7)
    every = [f"v{k}" for k in range(count)]
    moved = ", ".join(wrapped(chance.choice([*every, *names]), f) for f in fields)
    first, second = operations(chance, names, 2), operations(chance, ["draw"], 2)
    fresh = ", ".join(wrapped(chance.choice(["v0", "v1", "draw"]), f) for f in fields)
    return "\n".join(
        [
            f"def step({', '.join(names)}, action, draw):",
            *operations(chance, [*names, *names, "action", "draw"], count),
            f"    return {moved}, {wrapped(every[-1], reward)}, {wrapped(every[-2], Field('end', 1))}",
            *("def initial(draw):", *second, f"    return {fresh}"),
            *(f"def observe({', '.join(names)}):", *first, "    return np.int32(v0), np.int32(v1)", ""),
        ]
    )


def fixed_source(state: list[Word], results: str) -> str:
    """Return the text of three golden functions, of the results of a step."""
    names = ", ".join(name for name, *_ in state)
    return "\n".join(
        [
            f"def step({names}, action, draw):\n    return {results}",
            f"def initial(draw):\n    return {', '.join('draw & 3' for _ in state)}",
            f"def observe({names}):\n    return {state[0][0]} & 0xFFFF, {state[-1][0]} < 0\n",
        ]
    )


def spec_with(text: str, fields: list[Field], reward: Field) -> EnvSpec:
    """Return an environment of these golden functions."""
    scope: dict[str, Any] = {"np": np, **TABLES}
    exec(compile(text, "<a wide step>", "exec"), scope)
    return EnvSpec(
        name="Wide",
        version=0,
        summary=text,
        state=tuple(fields),
        action=Field("action", 2),
        observation=(Field("first", 32, signed=True), Field("second", 32, signed=True)),
        reward=reward,
        rewards=None,
        observation_space=Box(-(2**31), 2**31 - 1, (2,), np.int32),
        action_space=Discrete(4),
        golden=Golden(scope["initial"], scope["step"], scope["observe"]),
        reset_draws=1,
        step_draws=1,
    )


def wide_spec(number: int) -> EnvSpec:
    """Return an environment: the fixed ones first, and then one of a random step, always the same."""
    if number < len(FIXED):
        state, results = FIXED[number]
        spec = spec_with(fixed_source(state, results), [Field(*word) for word in state], REWARD)
        golden_functions(spec)
        return spec
    for attempt in itertools.count():
        chance = random.Random(f"{number} {attempt}")
        bits = [chance.choice([1, 3, 8, 8, 13, 32, 63, 64, 64]) for _ in range(chance.randint(1, 3))]
        fields = [Field(f"word_{k}", b, signed=chance.random() < 0.6) for k, b in enumerate(bits)]
        reward = Field("reward", chance.randint(2, 20), chance.random() < 0.7, chance.randint(0, 3))
        try:
            spec = spec_with(random_source(chance, fields, reward), fields, reward)
            golden_functions(spec)
        except ArgumentError:  # a word of more bits than a kernel has
            continue
        return spec
    raise AssertionError


REWARD = Field("reward", 8, signed=True)
