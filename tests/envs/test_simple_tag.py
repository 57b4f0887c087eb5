"""SimpleTag against MPE2's ``simple_tag_v3``."""

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
    "two good": {"num_good": 2, "num_adversaries": 2, "num_obstacles": 1, "terminate_on_success": True},
    "one on one": {"num_adversaries": 1, "terminate_on_success": True},
    "continuous": {"continuous_actions": True, "num_good": 3},
}
ULP = {"place": 0.6, "v": 3.0, "observation": 3.0, "reward": 22.0, "terminated": 0.0}
"""The greatest errors of a step, as :func:`errors_of` has them.

A place outside has a price with a slope of up to 20 on each axis: half a unit of it makes 10 of a reward.
"""


def spec_of(case: str) -> EnvSpec:
    return pearl_marl.get_spec("SimpleTag").with_options(**CASES[case])


def made(spec: EnvSpec) -> Any:
    return particles_oracle.made("simple_tag", **spec.options)


@pytest.mark.parametrize("steps", [20, pytest.param(1600, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("case", sampled(CASES, ("default",)))
def test_follows_the_oracle(case: str, steps: int) -> None:
    """Whole episodes, 102,400 transitions in the long form; MPE takes each step from where ours stands."""
    spec = spec_of(case)
    worst = errors_in_play(spec, made(spec), steps, obstacles=True)
    print(f"{case}, in units of the last place: {dict(worst)}")
    assert worst <= Counter(ULP)


@pytest.mark.parametrize("n", [100, pytest.param(20_000, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("case", sampled(CASES, ("default",)))
def test_step_in_a_crowd(case: str, n: int) -> None:
    """One step from states where most discs touch, on the CPU device, too."""
    spec = spec_of(case)
    move = compare_steps(spec, oracle(spec, made(spec)), crowded(spec, n, 0.6), tolerance=math.inf)
    worst = Counter(errors_of(spec, move, obstacles=True))
    print(f"{case}, in units of the last place: {dict(worst)}")
    assert worst <= Counter(ULP)
    assert np.mean(move.outcome.undecided) < 0.001
    assert (move.outcome.rewards[:, 0] > 0).any()
    assert move.ended.any() == spec.options["terminate_on_success"]


def test_who_leaves_pays() -> None:
    """States at the edge and far beyond it, where the price is a line, an exponential and its limit."""
    spec = spec_of("default")
    move = compare_steps(spec, oracle(spec, made(spec)), crowded(spec, 200, 5.0), tolerance=math.inf)
    assert errors_of(spec, move, obstacles=True)["reward"] <= ULP["reward"]
    price = -move.outcome.rewards[:, -1]
    assert all(((low < price) & (price < high)).any() for low, high in ((0, 1), (1, 5), (5, 20)))


def test_starts_are_uniform() -> None:
    spec = spec_of("default")
    env = pearl_marl.parallel_env("SimpleTag", 4 * 20_000)
    env.reset_batch(seed=7)
    for field, values in zip(spec.state, env.state().T, strict=True):
        if field.name[-2] == "v":
            assert not values.any()
        else:
            end = 1.0 if field.name.startswith("agents") else 0.9
            assert stats.kstest(values, stats.uniform(-end, 2 * end).cdf).pvalue > 0.001, field.name


def test_the_spaces_are_mpes() -> None:
    """Of both roles: good agents' observations are shorter."""
    for case in CASES:
        spec = spec_of(case)
        game = made(spec)
        for name, role in zip(game.possible_agents, spec.roles, strict=True):
            assert name.rpartition("_")[0] == role.name
            assert role.observation_space == game.observation_space(name)
            assert role.action_space == game.action_space(name)
        assert spec.observation_space == spec.roles[0].observation_space
        assert (spec.agents, spec.max_cycles) == (len(game.possible_agents), game.max_cycles)


def test_pictures_are_mpes() -> None:
    spec = spec_of("default")
    game = made(spec)

    def drawn(state: Any) -> Any:
        particles_oracle.pose(game, state)
        return game.render()

    compare_pictures(
        spec, "rgb_array", drawn, [(1, 2, 3, 4), (4, 4, 0, 1), (4, 1, 2, 2)], 3, device="reference"
    )


@pytest.mark.parametrize(
    ("sentence", "options"),
    [
        ("num_good is 5; it must be an integer from 1 to 4", {"num_good": 5}),
        ("num_adversaries is 0; it must be an integer from 1 to 4", {"num_adversaries": 0}),
        ("terminate_on_success is 1; it must be True or False", {"terminate_on_success": 1}),
    ],
)
def test_what_is_refused(sentence: str, options: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError, match=sentence):
        pearl_marl.get_spec("SimpleTag").with_options(**options)
