"""Observations of many flags, which kernels write in runs, whatever their dtype and what is between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from pearl_marl.compiler.flag_runs import FlagRun, runs
from pearl_marl.devices import BatchConfig, Lockstep
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Bits
from pearl_marl.spec import EnvSpec, Field, Golden

LONG = [Field(f"flag_{k}", 1) for k in range(19)]
MIXED = [
    Field("level", 5),
    *LONG,
    Field("sign", 1, signed=True),
    Field("half", 1, fraction=1),
    *(Field(f"more_{k}", 1) for k in range(9)),
    Field("last", 4, signed=True),
]
"""Runs of 8, 8 and 3 flags, of 8 and 1, and what is no flag before, between and after them."""


class State(NamedTuple):
    """Two words of random bits."""

    first: Bits[32]
    second: Bits[32]


def initial(draws: Draws) -> State:
    return State(draws.bits(), draws.bits())


def step(state: State, actions: list[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
    first, second = state
    flipped = first ^ (first << 13 & 0xFFFFFFFF)
    return State(second, flipped ^ (flipped >> 17) ^ actions[0]), [0, 0], [first & 1, second & 1]


def spec(fields: list[Field], dtype: type, masks: bool) -> EnvSpec:
    """Return a world of two agents who see the bits of the state, and lack some of the actions by turns."""

    def observe(state: State, agent: int) -> list[Word]:
        word, words, at = state[agent], [], 0
        for field in fields:
            bits = word >> at & (1 << field.bits) - 1
            words.append(bits - (1 << field.bits - 1) if field.signed else bits)
            at = (at + field.bits) % 25
        return words

    def allowed(state: State, agent: int) -> tuple[Word, ...]:
        return 1, state.first & 1, (state.first >> 1 & 1) ^ agent

    low, high = (0, 1) if dtype is np.bool_ else (-16, 31)
    return EnvSpec(
        name="Bits",
        version=0,
        summary="Look at the bits of two words",
        observation=tuple(fields),
        reward=Field("reward", 1),
        rewards=None,
        observation_space=Box(low, high, (len(fields),), dtype),  # type: ignore[arg-type]
        action_space=Discrete(3),
        golden=Golden(State, initial, step, observe, allowed if masks else None),
        agents=2,
        max_cycles=5,
    )


def test_runs() -> None:
    sizes = [run.size for run in runs(spec(MIXED, np.float32, masks=False))]
    assert sizes == [1, 8, 8, 3, 1, 1, 8, 1, 1]
    assert runs(spec(LONG[:16], np.float32, masks=False)) == []
    few = spec(LONG[:16], np.float32, masks=True)
    assert runs(few) == [FlagRun(True, 0, 16, 3)]


@pytest.mark.parametrize(
    ("fields", "dtype", "masks"),
    [
        (MIXED, np.float32, True),
        pytest.param(LONG, np.bool_, False, marks=pytest.mark.exhaustive),
        (LONG, np.int16, True),
    ],
)
def test_they_are_what_the_golden_functions_say(fields: list[Field], dtype: type, masks: bool) -> None:
    n = 2_100  # more than a block
    device = Lockstep("native", "reference")
    device.open(BatchConfig(spec=spec(fields, dtype, masks), n_envs=n))
    device.reset(seed=0)
    generator = np.random.default_rng(0)
    ended = 0
    for _ in range(7):
        ended += int(device.step(generator.integers(3, size=2 * n).astype(np.uint8)).truncations.sum())
    device.close()
    assert ended
