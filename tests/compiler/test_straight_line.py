"""The operations that kernels are made of, run as plain Python against the golden functions themselves."""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from gymnasium.spaces import Discrete, MultiBinary

from pearl_marl.compiler import llvm_words, scalar_words, straight_line
from pearl_marl.compiler.straight_line import golden_functions, maskers, observers, orders
from pearl_marl.devices import BatchConfig, Lockstep
from pearl_marl.envs import get_spec, names
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import Draws, Word, call_reference
from pearl_marl.layout import Array, Bits, Flag
from pearl_marl.spec import EnvSpec, Field, Golden

from ..rtl.random_steps import random_spec
from ..rtl.wide_steps import FIXED, PLAIN, wide_spec
from ..sampling import KINDS, sampled
from .plain import returning

CASES = 25


def within_the_width(name: str, shift: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Return a shift that refuses what is undefined to LLVM."""
    bits = int(name.partition("_")[0].lstrip("uint"))

    def checked(a: Any, by: Any) -> Any:
        assert 0 <= by < bits, f"{name}({a}, {by})"
        return shift(a, by)

    return checked


def functions(spec: EnvSpec) -> dict[str, Any]:
    scope: dict[str, Any] = {"np": np, "inlined": lambda function: function, **scalar_words.operations()}
    shifts = {name: f for name, f in scope.items() if name.endswith(("_left", "_right"))}
    scope |= {name: within_the_width(name, shift) for name, shift in shifts.items()}
    exec("\n".join(golden_functions(spec)), scope)
    return scope


def word(chance: random.Random, field: Field) -> Any:
    """Return a word, one of the least and greatest and those near 0 more often than others."""
    low, high = int(field.low), int(field.high)
    near = min(max(low, chance.randint(-2, 9)), high)
    return field.dtype.type(chance.choice([low, high, near, *(chance.randint(low, high) for _ in range(2))]))


def compiled(spec: EnvSpec) -> dict[str, Any]:
    """Return the functions as LLVM has them, which is how kernels of a CPU call them."""
    scope: dict[str, Any] = {"np": np, "inlined": lambda function: function, **llvm_words.operations()}
    exec("\n".join(golden_functions(spec)), scope)
    names = "initial", "golden_step", *observers(spec), *maskers(spec)
    return {name: returning(scope[name]) for name in names}


def assert_means_the_golden_functions(
    spec: EnvSpec, chance: random.Random, functions: Callable[[EnvSpec], dict[str, Any]] = functions
) -> None:
    found = functions(spec)
    draws = [Field(f"draw_{k}", 32) for k in range(spec.reset_draws + spec.step_draws)]
    # Words, whatever they stand for.
    state = [replace(f, fraction=0) for f in spec.state]
    actions = [replace(f, fraction=0) for f in spec.each_agent(*spec.action_fields)]
    steps = [*state, *actions, *draws[spec.reset_draws :]]
    calls: list[tuple[str, Any, list[Field], tuple[int, ...]]] = [
        ("initial", spec.positional.initial, draws[: spec.reset_draws], ()),
        ("golden_step", spec.positional.step, steps, ()),
    ]
    views = (observers(spec), spec.positional.observe), (maskers(spec), spec.positional.masks)
    for names_, golden in views:
        if names_:
            agents = zip(names_, spec.views, strict=True)
            calls += [(name, golden, state, agent) for name, agent in agents]
    of_state = orders(spec)
    for name, golden, fields, agent in calls:
        for _ in range(CASES):
            words = [word(chance, field) for field in fields]
            with np.errstate(over="ignore", divide="raise"):
                given = [words[k] for k in of_state[agent[0]]] if agent else words
                result = found[name](*given)
            results = result if isinstance(result, tuple) else (result,)
            due = call_reference(golden, words, *agent)
            assert [int(x) for x in results] == [int(x) for x in due], f"{name}{tuple(words)}"


@pytest.mark.parametrize("env", sampled(names(), KINDS))
def test_environments(env: str) -> None:
    assert_means_the_golden_functions(get_spec(env), random.Random(0))


CROWD = {"players": 12, "max_num_food": 12, "sight": 2}
"""As many foods as players, so that names alone do not tell which of the two change places."""


def test_agents_of_a_crowd_share_functions() -> None:
    spec = get_spec("LevelBasedForaging").with_options(**CROWD)
    assert set(observers(spec)) == {"observe_0"}
    assert set(maskers(spec)) == {"find_masks_0"}
    assert_means_the_golden_functions(spec, random.Random(0), compiled)


@pytest.mark.exhaustive  # takes five seconds; the one above finds which functions are shared, too
def test_agents_of_a_crowd_that_are_not_alike_have_functions_of_their_own() -> None:
    spec = get_spec("LevelBasedForaging").with_options(**CROWD)

    def observe(state: Any, agent: int) -> Any:
        foods, players = spec.golden.observe(state, agent)
        return foods, [(row, column, level * (agent != 5)) for row, column, level in players]

    other = replace(spec, golden=spec.golden._replace(observe=observe))
    assert observers(other) == [f"observe_{5 if k == 5 else 0}" for k in range(12)]
    assert_means_the_golden_functions(other, random.Random(0))


@pytest.mark.parametrize("seed", sampled(range(60), range(6)))
def test_random_golden_functions(seed: int) -> None:
    assert_means_the_golden_functions(random_spec(seed), random.Random(seed))


@pytest.mark.parametrize("env", sampled(names(), KINDS))
def test_environments_in_llvm(env: str) -> None:
    assert_means_the_golden_functions(get_spec(env), random.Random(0), compiled)


@pytest.mark.parametrize("env", ["RobotWarehouse", "ConnectFour"])
def test_many_results_in_turn_are_those_at_once(env: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """And what the first results are made of is all that is computed before them."""
    monkeypatch.setattr(straight_line, "MANY", 8)
    spec = replace(get_spec(env))  # one that nothing is known of yet
    at_once = functions(spec)
    scope = dict(at_once)
    exec("\n".join(golden_functions(spec, in_turn=True)), scope)
    chance = random.Random(1)
    for _ in range(CASES):
        state = [word(chance, field) for field in spec.state]
        for name in (*observers(spec), *maskers(spec)):
            results = at_once[name](*state)
            if len(results) < 8:
                continue
            in_turn = scope[name](*state)
            assert inspect.isgenerator(in_turn)
            assert next(in_turn) == results[0]
            known = len(in_turn.gi_frame.f_locals)
            assert (*results[:1], *in_turn) == results
            assert known < len(at_once[name].__code__.co_varnames) / 2


@pytest.mark.parametrize("seed", sampled(range(15), range(6)))
def test_random_golden_functions_in_llvm(seed: int) -> None:
    assert_means_the_golden_functions(random_spec(seed), random.Random(seed), compiled)


@pytest.mark.parametrize("seed", sampled(range(30), range(8)))
def test_divisions_by_words(seed: int) -> None:
    assert_means_the_golden_functions(random_spec(seed, divided=True), random.Random(seed))


@pytest.mark.parametrize("seed", range(8))
def test_divisions_by_words_in_llvm(seed: int) -> None:
    assert_means_the_golden_functions(random_spec(seed, divided=True), random.Random(seed), compiled)


@pytest.mark.parametrize("seed", sampled(range(20), range(6)))
def test_reals(seed: int) -> None:
    assert_means_the_golden_functions(random_spec(seed, reals=True), random.Random(seed))


@pytest.mark.parametrize("seed", range(20, 28))
def test_reals_in_llvm(seed: int) -> None:
    assert_means_the_golden_functions(random_spec(seed, reals=True), random.Random(seed), compiled)


WIDE = range(720)
"""Whose cores and netlists are compared with the golden functions in ``tests/rtl/test_wide_steps.py``."""


@pytest.mark.parametrize("number", sampled(WIDE, (*WIDE[: len(FIXED) + 8], *WIDE[PLAIN : PLAIN + 16])))
def test_wide_words(number: int) -> None:
    assert_means_the_golden_functions(wide_spec(number), random.Random(number))


@pytest.mark.parametrize("number", sampled(WIDE, (*WIDE[4:7], *WIDE[11:17], *WIDE[PLAIN : PLAIN + 8])))
def test_wide_words_in_llvm(number: int) -> None:
    assert_means_the_golden_functions(wide_spec(number), random.Random(number), compiled)


def test_divisions_and_tables_in_llvm() -> None:
    """Rounded down, below 0 too; a large table is read from memory."""
    table = np.random.default_rng(0).integers(-(2**30), 2**30, 256)

    def observe(state: Wide) -> Any:
        word, by = state
        less = (word & 0xFFFF) - 0x8000
        return (less // 7) & 0xFFFFFF, (table[word & 255] + less % 100 + by // 5 + by % 3) & 0x7F

    assert_means_the_golden_functions(wide(observe), random.Random(0), compiled)


class Wide(NamedTuple):
    """A word that is as wide as they come, and a narrow one."""

    word: Bits[64]
    by: Bits[7]


def wide(observe: Callable[[Wide], Any]) -> EnvSpec:
    """Return an environment of a word of 64 bits and one of 7, observed as two numbers."""

    def initial(draws: Draws) -> Wide:
        return Wide(0, 0)

    def step(state: Wide, action: Word, draws: Draws) -> tuple[Wide, Word, Word]:
        return state, 0, 0

    return replace(random_spec(0), golden=Golden(Wide, initial, step, observe))


def test_bits_beyond_a_words_range() -> None:
    def observe(state: Wide) -> Any:
        small, other = state.word & 31, state.by & 127
        chosen = (other if other & 1 else small) >> 5
        return (small & 40) + ((small ^ other) >> 5), ((small + (other << 5)) & 0xE7) + chosen

    assert_means_the_golden_functions(wide(observe), random.Random(0))


@pytest.mark.parametrize("made", [functions, compiled])
def test_a_division_that_no_processor_can(made: Callable[[EnvSpec], dict[str, Any]]) -> None:
    """Where nobody looks, of the least word by 0 or -1."""
    number = next(k for k, (_, results) in enumerate(FIXED) if results.startswith("quotient(x, y), y"))
    step = made(wide_spec(number))["golden_step"]
    for x in (-(1 << 63), -1, 7):
        for by in (-128, -1, 0, 1, 127):
            with np.errstate(over="raise", divide="raise"):
                quotient, *_ = step(np.int64(x), np.int8(by), np.uint8(0), np.uint32(0))
            assert int(quotient) == (x // by if by > 0 else x)


def test_bits_beyond_a_word_that_is_narrowed_down() -> None:
    def observe(state: Wide) -> Any:
        by = state.by
        near = by & 31
        if 64 < by < 70 and 0 < near < 6:
            return near * 3, by - 64
        return 40, 9

    found = functions(wide(observe))["observe"]
    for by in range(128):
        due = (by - 64) * 3 if 64 < by < 70 else 40, by - 64 if 64 < by < 70 else 9
        assert tuple(map(int, found(np.uint64(0), np.uint8(by)))) == due


@pytest.mark.parametrize("by", [0, 7, 63, 64, 1 << 63, (1 << 64) - 1])
def test_shifts_by_any_number(by: int) -> None:
    spec = wide(lambda state: (((state.word | 1) >> state.word) & 255, 0))
    found = functions(spec)["observe"](np.uint64(by), np.uint8(0))
    assert int(found[0]) == ((by | 1) >> by) & 255


def test_shifts_by_more_than_the_width() -> None:
    def observe(state: Wide) -> Any:
        word, by = state
        return (word >> by) & 0xFFFFFF, ((word << (by & 15)) & 0xFF) < 200

    assert_means_the_golden_functions(wide(observe), random.Random(0))


def test_a_word_that_no_kernel_can_hold() -> None:
    def observe(state: Wide) -> Any:
        square = state.word * state.word
        return (square >> 100) & 1, state.by

    with pytest.raises(ArgumentError, match=r"test_straight_line\.py, line \d+: square takes 101 bits here"):
        golden_functions(wide(observe))


class Many(NamedTuple):
    flags: Array[Flag, 300]


def test_a_step_and_an_observer_of_many_results() -> None:
    """In a kernel, where they come one after the other."""

    def initial(draws: Draws) -> Many:
        bits = draws.bits(30)
        return Many([bits >> k % 30 & 1 for k in range(300)])

    def step(state: Many, action: Word, draws: Draws) -> tuple[Many, Word, Word]:
        flags = [flag ^ (action & 1) for flag in state.flags[1:]]
        return Many([*flags, state.flags[0]]), action & 1, state.flags[7] & state.flags[9]

    spec = EnvSpec(
        name="Many",
        version=0,
        summary="More flags than a function returns at once",
        rewards=(0.0, 1.0),
        observation_space=MultiBinary(300),
        action_space=Discrete(2),
        golden=Golden(Many, initial, step, lambda state: state.flags),
    )
    device = Lockstep("native", "reference")
    device.open(BatchConfig(spec=spec, n_envs=70, max_cycles=5))
    device.reset(seed=1)
    chance = np.random.default_rng(0)
    for _ in range(9):
        device.step(chance.integers(2, size=70))
    device.close()
