"""Environments that nobody wrote: golden functions of random statements, to be compiled and compared."""

from __future__ import annotations

import hashlib
import math
import random
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl.golden import i8, i16, i32, u8
from pearl_marl.layout import Array, Bits, Real, Signed
from pearl_marl.spec import EnvSpec, Field, Golden

try:
    from .programs import NUMBERS, Program, defined
except ImportError:  # in a simulator, which finds modules in this folder
    from programs import NUMBERS, Program, defined

TABLES = {
    "TABLE": [3, 1, 4, 1, 5, 9, 2, 6],
    "FAR": [-3, 1, -7, 9, 4, -8, 2, 6],
    "HIGH": [70000, 70003, 70001, 70007, 70002, 70006, 70004, 70005],
}
PATTERNS = [
    *NUMBERS,
    "{} << {n}",
    "u8({})",
    "i16({})",
    "i16({}) * u8({})",
    "u8({}) >> (u8({}) & 7)",
    "i16({}) >> ({} & 7)",
    "({} >> ({} & 3)) ^ {}",
    "u8({} << ({} & 15))",
    "(i16({}) << ({} & 3)) - {}",
    "u8({}) < u8({})",
    "(-1 if {} < 0 else 1) * (i16({}) - u8({})) + {}",
    "TABLE[{} & 7] * TABLE[{} % 8] + {}",
    "TABLE[u8({}) % 7]",
    "-1 * (3 - ({} & 3)) + {}",
    "(i16({}) * i16({}) + {c}) >> {n}",
    "({} << 7) * {c}",
    "FAR[{} & 7]",
    "HIGH[{} & 7] - {}",
    "({} & 31) & {c}",
    "(({} & 31) ^ {}) >> {n}",
    "{} + {c}",
    "({} & {}) | ({} ^ {c})",
]

DIVISIONS = [
    "{} // max({}, 1)",
    "{} % max({}, 1)",
    "{} // (({} & 7) + 1)",
    "{} % (({} & 31) + 1)",
    "{} // max({} >> {n}, {n} + 1)",
    "{} - {} % max(i16({}), {n} + 1)",
    "i16({}) // ((u8({}) & 15) | 1)",
    "u8({}) % ((u8({}) & 15) | 1)",
    "{c} // (({} & 7) + 2)",
    "{c} % max(i16({}), 1)",
    "TABLE[{} % (({} & 7) + 1)]",
]
"""By words."""

REALS = [
    "{r} + {r}",
    "{r} - {r}",
    "{r} * {r}",
    "-{r}",
    "abs({r})",
    "0.3 * {r} - 1.25",
    "{r} / (0.5 + abs({r}))",
    "1 / (1.5 - math.sin({r}))",
    "{r} / 3",
    "{r} * ({} & 7)",
    "({} & 3) * 0.1 + {r}",
    "min({r}, {r}, 1.5)",
    "max({r}, {r})",
    "np.clip({r}, -0.75, 1)",
    "({r} if {?} else {r})",
    "({r} if {?} else -0.5)",
    "(2.5 if {?} else -1.0) * {r}",
    "math.sin({r})",
    "math.cos({r})",
    "math.sqrt(abs({r}))",
    "math.exp(-abs({r}))",
    "math.tanh({r})",
    "({r}) ** 2",
    "({r} + 1) % 2.5",
    "[{r}, {r}, {r}][{} % 3]",
    "sum(places)",
]
OF_REALS = ["(round({r} * 8) & 255)", "(math.floor({r}) & 7)", "(int({r} * 3) & 31)", "({r} < {r})"]
REAL_FLAGS = ["{r} < {r}", "{r} >= 0.5", "-1 < {r} <= {r}", "{r} > ({} & 3)", "{r} == {r}"]


class Steps(Program):
    """Writes golden functions, whose words have up to 32 bits where they are used."""

    def __init__(self, chance: random.Random, patterns: list[str]) -> None:
        super().__init__(chance, patterns)

    def word(self) -> str:
        return f"i32({super().word()})"

    def value(self) -> str:
        return self.number() if self.chance.random() < 0.6 else super().value()

    def part(self, kind: str, depth: int) -> str:
        match kind:
            case "c":
                return str(self.chance.randint(-300, 300))
            case "n":
                return str(self.chance.randint(0, 9))
        # What is put together of several operations may be too wide for a kernel.
        part = super().part(kind, depth)
        return part if kind or part.startswith("i32(") else f"i32{part}"


class RealSteps(Steps):
    """Writes statements about reals among the others: of two names and the places of a list."""

    def part(self, kind: str, depth: int) -> str:
        if kind != "r":
            return super().part(kind, depth)
        if depth > 0 and self.chance.random() < 0.5:
            return f"({self.real(depth - 1)})"
        return self.chance.choice([*self.reals(), "0.125"])

    def reals(self) -> list[str]:
        return ["x", "y", f"places[{self.index(3)}]"]

    def real(self, depth: int = 1) -> str:
        return self.filled(self.chance.choice(REALS), depth)

    def number(self, depth: int = 1) -> str:
        if self.chance.random() < 0.2:
            return self.filled(self.chance.choice(OF_REALS), depth)
        return super().number(depth)

    def flag(self, depth: int = 1) -> str:
        if self.chance.random() < 0.3:
            return self.filled(self.chance.choice(REAL_FLAGS), depth)
        return super().flag(depth)

    def assignment(self) -> None:
        if self.chance.random() < 0.5:
            return super().assignment()
        # A helper would have names of its own if it assigned to them.
        targets = self.reals()[2 if self.elsewhere else 0 :]
        return self.write(f"{self.chance.choice(targets)} = np.clip({self.real(2)}, -4, 4)")


def source(chance: random.Random, fields: list[Field], steps: Steps, reals: list[str]) -> str:
    """Return the text of three golden functions over a state of these fields, and of these reals."""
    names = [f.name for f in fields]

    def fitted(field: Field) -> str:
        word, half = chance.choice([*steps.words, steps.word()]), int(field.signed) << field.bits - 1
        return f"(({word} + {half}) & {(1 << field.bits) - 1}) - {half}"

    def state() -> str:
        return f"State({', '.join([*map(fitted, fields), *reals])})"

    def outcome() -> str:
        return f"{state()}, u8({steps.word()}), ({steps.words[-1]} & 3) == 0"

    words = [f"{name} = state.{name}" for name in names]
    drawn = ["draw = draws.bits()"]
    steps.before = [f"{name} = state.{name}" for name in reals]
    steps.function(
        "step", ["state", "action", "draws"], [*words, "action", *drawn], chance.randint(3, 12), outcome
    )
    if reals:
        steps.before = ["x, y = draws.uniform(-4, 4), draws.uniform(0, 1)", "places = [x, y, 0.5]"]
    steps.function("initial", ["draws"], drawn, 1, state)
    steps.before = [f"{name} = state.{name}" for name in reals]
    steps.function("observe", ["state"], words, 2, lambda: f"{steps.word()}, {steps.word()}")
    return "\n".join(steps.lines) + "\n"


def random_spec(seed: int | random.Random, divided: bool = False, reals: bool = False) -> EnvSpec:
    """Return an environment of random golden functions; of one seed always the same.

    Where words are ``divided`` by words, every other operation is such a division. With ``reals``,
    a state has some, and statements are about them.
    """
    chance = random.Random(seed) if isinstance(seed, int) else seed
    fields = [
        Field(f"word_{k}", chance.choice([1, 2, 3, 5, 8, 13, 16]), signed=chance.random() < 0.4)
        for k in range(chance.randint(1, 4))
    ]
    kinds: list[tuple[str, Any]] = [(f.name, (Signed if f.signed else Bits)[f.bits]) for f in fields]
    if reals:
        kinds += [("x", Real[-4, 4]), ("y", Real[-1, 3.5]), ("places", Array[Real[-2, 2], 3])]
    state = NamedTuple("State", kinds)  # type: ignore[misc]
    half = len(PATTERNS) // len(DIVISIONS)
    steps = (RealSteps if reals else Steps)(chance, PATTERNS + DIVISIONS * half if divided else PATTERNS)
    text = source(chance, fields, steps, ["x", "y", "places"] if reals else [])
    scope: dict[str, Any] = {
        **TABLES,
        "State": state,
        "u8": u8,
        "i8": i8,
        "i16": i16,
        "i32": i32,
        "math": math,
        "np": np,
    }
    defined(text, scope, f"<a random step, {hashlib.sha256(text.encode()).hexdigest()}>")
    return EnvSpec(
        name="Random",
        version=0,
        summary=text,
        action=Field("action", 2),
        observation=(Field("first", 32, signed=True), Field("second", 32, signed=True)),
        reward=Field("reward", 8),
        rewards=None,
        observation_space=Box(-(2**31), 2**31 - 1, (2,), np.int32),
        action_space=Discrete(4),
        golden=Golden(state, scope["initial"], scope["step"], scope["observe"]),
    )
