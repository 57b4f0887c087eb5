"""SimpleSpread against MPE2's ``simple_spread_v3``."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.envs import particles_oracle
from pearl_marl.errors import ArgumentError
from pearl_marl.testing import compare_pictures, compare_steps

from ..sampling import sampled
from .particles import crowded, errors_in_play, errors_of, oracle

CASES: dict[str, dict[str, Any]] = {
    "default": {},
    "two": {"N": 2, "local_ratio": 0.0},
    "five": {"N": 5, "local_ratio": 1.0},
    "continuous": {"continuous_actions": True},
}
ULP = {"place": 0.6, "v": 3.0, "observation": 3.0, "reward": 4.0, "terminated": 0.0}
"""The greatest errors of a step, as :func:`errors_of` has them."""


def spec_of(case: str) -> EnvSpec:
    return pearl_marl.get_spec("SimpleSpread").with_options(**CASES[case])


def made(spec: EnvSpec) -> Any:
    return particles_oracle.made("simple_spread", **spec.options)


@pytest.mark.parametrize("steps", [20, pytest.param(1600, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("case", sampled(CASES, ("default",)))
def test_follows_the_oracle(case: str, steps: int) -> None:
    """Whole episodes, 102,400 transitions in the long form; MPE takes each step from where ours stands."""
    spec = spec_of(case)
    worst = errors_in_play(spec, made(spec), steps)
    print(f"{case}, in units of the last place: {dict(worst)}")
    assert worst <= Counter(ULP)


@pytest.mark.parametrize("n", [200, pytest.param(20_000, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("case", sampled(CASES, ("default",)))
def test_step_in_a_crowd(case: str, n: int) -> None:
    """One step from states where most discs touch, on the CPU device, too."""
    spec = spec_of(case)
    move = compare_steps(spec, oracle(spec, made(spec)), crowded(spec, n, 0.8), tolerance=math.inf)
    worst = Counter(errors_of(spec, move))
    print(f"{case}, in units of the last place: {dict(worst)}")
    assert worst <= Counter(ULP)
    assert np.mean(move.outcome.undecided) < 0.001
    hits = np.diff(np.sort(move.outcome.rewards))
    assert (hits > 0.1).any() == (spec.options["local_ratio"] > 0)


def test_starts_are_uniform() -> None:
    spec = spec_of("default")
    env = pearl_marl.parallel_env("SimpleSpread", 3 * 20_000)
    env.reset_batch(seed=7)
    for field, values in zip(spec.state, env.state().T, strict=True):
        if field.name[-2] == "v":
            assert not values.any()
        else:
            assert stats.kstest(values, stats.uniform(-1, 2).cdf).pvalue > 0.001, field.name


def test_the_space_is_mpes() -> None:
    for case in CASES:
        spec = spec_of(case)
        game = made(spec)
        assert spec.observation_space == game.observation_space("agent_0")
        assert spec.action_space == game.action_space("agent_0")
        assert (spec.agents, spec.max_cycles) == (len(game.possible_agents), game.max_cycles)


def test_pictures_are_mpes() -> None:
    spec = spec_of("default")
    game = made(spec)

    def drawn(state: Any) -> Any:
        particles_oracle.pose(game, state)
        return game.render()

    compare_pictures(spec, "rgb_array", drawn, [(1, 2, 3), (4, 4, 0), (4, 1, 2)], 3, device="reference")


@pytest.mark.parametrize(
    ("sentence", "options"),
    [
        ("N is 7; it must be an integer from 2 to 6", {"N": 7}),
        ("local_ratio is 1.5; it must be a number from 0 to 1", {"local_ratio": 1.5}),
        ("continuous_actions is 1; it must be True or False", {"continuous_actions": 1}),
    ],
)
def test_what_is_refused(sentence: str, options: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError, match=sentence):
        pearl_marl.get_spec("SimpleSpread").with_options(**options)
