"""Environments of wide and signed words: golden functions of whose text simulators know less than synthesis.

Words have up to 64 bits, with a sign or without. They are cut, divided, compared with each other as they are,
and their upper bits and signs read tables. Later ones are narrowed down where it is known what they are,
which a compiler finds out from branches.
"""

from __future__ import annotations

import hashlib
import itertools
import random
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl.compiler.straight_line import golden_functions
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import i8, i16, i32, i64, u8, u32, u64
from pearl_marl.layout import Bits, Signed
from pearl_marl.spec import EnvSpec, Field, Golden

try:
    from .programs import defined
except ImportError:  # in a simulator, which finds modules in this folder
    from programs import defined

TABLES = {
    "PAIR": [5, -3],
    "FOUR": [16, 0, 0, 127],
    "EIGHT": [3, -1, 4, -1, 5, -9, 2, -6],
    "LONG": [(k * k * 2654435761) % 1000 - 500 for k in range(16)],
    "ODD": [7, -100, 70000, 1, 0],
    "FIVE": [7, -100, 7000, 1, 12],
    "SMALL": [1, 2, 3, 0, 2, 1, 3, 0],
    "FAR": [k * k * 2654435761 % 2**30 for k in range(40)],
    "NEXT": [0, *(k * k * 2654435761 % 2**30 + 1 for k in range(40))],
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
    "i32({}) * {c}",
    "(i16({}) * i16({})) >> {n}",
    "{} // {d}",
    "{} % {d}",
    "({} % {d}) & 1",
    "(({} // {d}) & 7) * 6 & 4",
    "({} >> {n}) // {d}",
    "({} - {}) % {d}",
    "i32({}) // {d} - {}",
    "{} >> ({} & 63)",
    "i32({}) << (({} >> {n}) & 15)",
    "(i8({}) >> ({} & 7)) < {}",
    "{} if {} < {} else {}",
    "{} if {} & 1 == 1 else {c}",
    "{} >> {n} if {} == {} else -1",
    "min({}, {})",
    "max({}, {c})",
    "PAIR[({} >> {n}) & 1]",
    "PAIR[({} < 0) & ({} > {c})]",
    "FOUR[({} >> {n}) & 3]",
    "FOUR[({} >> 6 if {} < {} else {} >> 5) & 3]",
    "FOUR[(~{} >> {n}) & 3] - {}",
    "EIGHT[(i8({}) >> ({} & 7)) & 7]",
    "EIGHT[i8({}) // 32 + 4]",
    "EIGHT[(({} & 3) - 2) & 7]",
    "EIGHT[(-1 if {} < 0 else 2) & 7]",
    "EIGHT[({} & 1) * 4 + ({} >> {n} & 1) * 2 + ({} % 2)]",
    "LONG[({} - {}) & 15] * FOUR[({} >> {n}) & 3]",
    "LONG[i64({}) >> 60 & 15]",
    "ODD[{} % 5]",
    "ODD[FOUR[({} >> {n}) & 3] % 5] + {}",
    "i8({}) - i8({}) < {c}",
    "(i8({}) ^ u8({})) >> {n}",
    "i8({} >> {n})",
    "i32({})",
    "u32({} >> {n})",
]

FIVE, SMALL, FAR, NEXT = (TABLES[name] for name in ("FIVE", "SMALL", "FAR", "NEXT"))


def entry(x: Any) -> Any:
    """Return an entry of a table that is a few numbers, of one that is a number, and of one in memory."""
    near = FIVE[x - 1] if 0 < x < 6 else 0
    near += SMALL[x - 1] if 0 < x < 9 else 0
    return near + (FAR[x - 5] if 4 < x < 45 else 0)


def quotient(a: Any, by: Any) -> Any:
    """Divide by what may be anything, if it is 1 or more."""
    return a // by if by > 0 else a


def rest(a: Any, by: Any) -> Any:
    """Divide by a number that is known to be small where it is looked at, and negative elsewhere."""
    return a % by if 2 < by < 9 else 3


def shifted(a: Any, by: Any) -> Any:
    """Shift by what would be too far elsewhere."""
    right = a >> by if 0 <= by < 40 else 1
    return right + (i16(a) << by if 2 < by < 9 else 0)


def flags(x: Any, y: Any) -> Any:
    """Choose among flags of which some are anything elsewhere: one is no flag there."""
    known = 1 < x < 4
    flag = x - 2 if known else 1
    both = (x - 2 if known else 0) if y & 1 else 0
    return flag * 4 + both * 2 + (x == 3 if known else y > 0)


def same(x: Any, y: Any) -> Any:
    """Find out in a branch what is found out behind it too, where the branch's word is anything."""
    inside = ((y & 7) - NEXT[x]) + (FAR[x - 1] + 10) if 0 < x < 41 else 9
    return inside * 5 + ((y & 7) + 9)


HELPERS = {f.__name__: f for f in (entry, quotient, rest, shifted, flags, same)}

NARROWED = [
    "entry({})",
    "entry({} & 127)",
    "entry(i8({}))",
    "quotient({}, {})",
    "quotient({}, i8({}))",
    "quotient({}, i16({} >> {n}))",
    "quotient({c}, {} & 15)",
    "rest({}, {})",
    "rest({}, {} & 15)",
    "shifted({}, {})",
    "shifted({}, i8({}))",
    "shifted({}, {} & 63)",
    "flags({}, {})",
    "flags({} & 7, {})",
    "flags(i8({}), {}) ^ {}",
    "same({}, {})",
    "same({} & 7, {})",
    "{} // max({}, 1)",
    "{} % max({}, 1)",
    "{} // (({} & 15) + 1)",
    "{} % max(i16({} >> {n}), {d})",
    "{c} // max(i8({}), 1)",
    "i16({}) % max({}, 1)",
]
"""Words narrowed down, and divisions by words."""
PLAIN = 528
"""From this number on environments have those, too."""

DRAWN = "    draw = draws.bits()"
CASTS = {"u8": u8, "u32": u32, "u64": u64, "i8": i8, "i16": i16, "i32": i32, "i64": i64}

Word = tuple[str, int, bool]
"""A field of the state: its name, bits, and whether it has a sign."""

X, Y, WIDE = ("x", 8, True), ("y", 8, True), ("x", 64, True)
FIXED: list[tuple[list[Word], str]] = [
    ([X], "x, FOUR[(x >> 7) & 3], 0"),  # a table's index with a sign
    ([X, Y], "y, x, FOUR[(x >> 7 if action < 2 else y >> 6) & 3], 0"),
    ([("x", 64, False)], "(x % 10) & 1, 0, 0"),  # a sum of which no term is left
    ([X], "x, EIGHT[(x >> action) & 7], EIGHT[x // 64 & 7] < 0"),
    ([("x", 3, True), Y], "x ^ 1, y, EIGHT[x + 4], EIGHT[x & 7] < 0"),
    ([WIDE], "(x >> 1) ^ -1, PAIR[(x >> 63) & 1], x < 0"),
    ([WIDE], "(x % 10) & 1, ((x // 3) * 8 + 5) & 7, (x * 2) & 1"),
    ([("x", 64, False)], "x ^ (x % 6 & 1), (x * 6 + 4 * action) & 3, 0"),
    ([WIDE], "-1, 3, 1"),  # nothing but constants
    ([WIDE, Y], "x, y, y, 0"),  # nothing but wires
    ([WIDE, ("y", 63, False)], "y if x < y else 1, (x ^ y) & 1023, x < y, (y < 3) ^ (x == y)"),
    ([("x", 8, False)], "x ^ action, (FIVE[x - 1] if 0 < x < 6 else 0) & 63, 0"),
    ([X, Y], "quotient(x, y), x, rest(x, y) + flags(y, x), entry(x) & 1"),
    ([WIDE, Y], "quotient(x, y), y, rest(x, y), shifted(x, y) & 1"),
    (
        [("x", 32, True), ("y", 16, False)],
        "x // max(y, 1), x % (y | 1), entry(y) & 63, y < 9",
    ),
    ([("x", 3, False), Y], "x, i8(entry(x)), i8(entry(y)) ^ flags(x, y), rest(x, y) & 1"),
    ([X, Y], "i8(same(x, y)), y, 0, 0"),
    ([X, ("soft", 8, False), ("soft_", 8, True)], "soft_, u8(x), i8(soft), soft & 63, x < soft_"),
]
"""What has gone wrong, and its relatives: the state, and the results of a step."""


def wrapped(word: str, field: Field) -> str:
    """Return an expression that is a word of the field, whatever the word is."""
    half = int(field.signed) << field.bits - 1
    low = f"({word}) & {(1 << field.bits) - 1}"
    return f"(({low}) ^ {half}) - {half}" if half else low


def operations(chance: random.Random, words: list[str], count: int, patterns: list[str]) -> list[str]:
    """Return assignments of so many operations to ``v0``, ``v1`` and so on."""
    lines = []
    for k in range(count):
        pattern = chance.choice(patterns)
        values = [chance.choice(words + words[-2:]) for _ in range(pattern.count("{}"))]
        numbers = {
            "c": chance.choice([-300, -7, -1, 1, 3, 100, 5_000, 2**31 - 1]),
            "n": chance.choice([0, 1, 2, 3, 5, 6, 7, 15, 31, 62, 63]),
            "d": chance.choice([2, 3, 5, 7, 10, 12, 64, 100, 641, 1_000]),
        }
        value = pattern.format(*values, **numbers)
        # Words of more bits than a kernel can hold are refused.
        lines.append(f"    v{k} = {chance.choice(['i64', 'i32', 'i8', 'u64', ''])}({value})")
        words = [*words, f"v{k}"]
    return lines


def random_source(chance: random.Random, fields: list[Field], reward: Field, patterns: list[str]) -> str:
    """Return the text of three golden functions over a state of these fields."""
    names, count = [f.name for f in fields], chance.randint(2, 7)
    given = [f"    {name} = state.{name}" for name in names]
    every = [f"v{k}" for k in range(count)]
    moved = ", ".join(wrapped(chance.choice([*every, *names]), f) for f in fields)
    first, second = operations(chance, names, 2, patterns), operations(chance, ["draw"], 2, patterns)
    fresh = ", ".join(wrapped(chance.choice(["v0", "v1", "draw"]), f) for f in fields)
    return "\n".join(
        [
            *("def step(state, action, draws):", *given, DRAWN),
            *operations(chance, [*names, *names, "action", "draw"], count, patterns),
            f"    return State({moved}), {wrapped(every[-1], reward)}, {wrapped(every[-2], Field('end', 1))}",
            *("def initial(draws):", DRAWN, *second, f"    return State({fresh})"),
            *("def observe(state):", *given, *first, "    return i32(v0), i32(v1)", ""),
        ]
    )


def fixed_source(state: list[Word], results: str) -> str:
    """Return the text of three golden functions, of the results of a step."""
    names = [name for name, *_ in state]
    return "\n".join(
        [
            *("def step(state, action, draws):", *(f"    {name} = state.{name}" for name in names), DRAWN),
            f"    every = {results}\n    return State(*every[:{len(names)}]), *every[{len(names)}:]",
            f"def initial(draws):\n{DRAWN}\n    return State({', '.join('draw & 3' for _ in state)})",
            f"def observe(state):\n    return state.{names[0]} & 0xFFFF, state.{names[-1]} < 0\n",
        ]
    )


def spec_with(text: str, fields: list[Field], reward: Field) -> EnvSpec:
    """Return an environment of these golden functions."""
    kinds: list[tuple[str, Any]] = [(f.name, (Signed if f.signed else Bits)[f.bits]) for f in fields]
    state = NamedTuple("State", kinds)  # type: ignore[misc]
    scope: dict[str, Any] = {**CASTS, **TABLES, **HELPERS, "State": state}
    defined(text, scope, f"<a wide step, {hashlib.sha256(text.encode()).hexdigest()}>")
    return EnvSpec(
        name="Wide",
        version=0,
        summary=text,
        action=Field("action", 2),
        observation=(Field("first", 32, signed=True), Field("second", 32, signed=True)),
        reward=reward,
        rewards=None,
        observation_space=Box(-(2**31), 2**31 - 1, (2,), np.int32),
        action_space=Discrete(4),
        golden=Golden(state, scope["initial"], scope["step"], scope["observe"]),
    )


def renamed(spec: EnvSpec, names: Iterable[str]) -> EnvSpec:
    """Return a spec with these names of state fields, some of which no class of Python's can have."""
    result = replace(spec)
    result.layout.fields = tuple(replace(f, name=name) for f, name in zip(spec.state, names, strict=True))
    return result


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
            patterns = PATTERNS if number < PLAIN else PATTERNS[::2] + NARROWED
            spec = spec_with(random_source(chance, fields, reward, patterns), fields, reward)
            golden_functions(spec)
        except ArgumentError:  # a word of more bits than a kernel has
            continue
        return spec
    raise AssertionError


REWARD = Field("reward", 8, signed=True)
