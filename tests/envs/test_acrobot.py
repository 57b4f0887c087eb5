"""Acrobot against Gymnasium's ``Acrobot-v1``, by either of its equations."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl.envs.acrobot.step import DT, STAGE_1, STAGE_2, dsdt, rk4
from pearl_marl.errors import ArgumentError
from pearl_marl.porting.oracle import Outcome, Rules, compare, one_by_one
from pearl_marl.testing import assert_same_play, compare_pictures, compare_steps, first_episodes
from pearl_marl.testing.oracles import random_actions_of

from .fixed import Array, drawing

SPEC = pearl_marl.get_spec("Acrobot")
NAMES = [field.name for field in SPEC.state]
ULP = 2.0**-26
REACHED = dict(zip(NAMES, np.array([1, 1, 3, 5]) * ULP, strict=True))
"""The greatest errors of a step from states that random play reaches."""
ANY = np.array([15, 25, 45, 70])
"""The same from any state, over 1 and :func:`growth`, which is in the thousands at the highest speeds."""
FREE = dict.fromkeys(NAMES, math.inf)


def oracle(spec: pearl_marl.EnvSpec) -> Rules:
    """Return Gymnasium's own step, from states of ours."""
    assert spec.oracle is not None
    env: Any = gymnasium.make(spec.oracle, **spec.options).unwrapped
    nips = spec.options["book_or_nips"] == "nips"

    def step(state: Any, actions: list[int], draws: list[int]) -> Outcome:
        env.state = np.array(state)
        _, reward, ended, _, _ = env.step(actions[0])
        after = env.state
        # Gymnasium's speeds within a step have no bound, and an angle jumps at half a turn.
        known = not beyond(state, actions[0] - 1, nips)
        sure = [known and math.pi - abs(theta) > 1e-3 for theta in after[:2]] + [known] * 2
        height = -math.cos(after[0]) - math.cos(after[0] + after[1])
        due = {name: x if is_sure else math.nan for name, x, is_sure in zip(NAMES, after, sure, strict=True)}
        return Outcome(
            rewards=reward, terminated=ended, state=due, undecided=not known or abs(height - 1) < 1e-4
        )

    return one_by_one(spec, step)


def beyond(state: Any, torque: float, nips: bool) -> bool:
    """Return whether a step has speeds inside of it that ours binds."""
    k: tuple[Any, ...] = (0.0,) * 4
    for dt in (0.0, DT / 2, DT / 2, DT):
        stage = [y + dt * change for y, change in zip(state, k, strict=True)]
        if abs(stage[2]) > STAGE_1 or abs(stage[3]) > STAGE_2:
            return True
        k = dsdt(stage, torque, nips)
    return False


def growth(states: Array, torques: Array, nips: bool) -> Array:
    """Return how much a step in float64 changes each number, at most, with all of its start, per change."""
    small, total = 2.0**-20, np.zeros(states.shape)
    for change in small * np.eye(len(NAMES))[:, :, None]:
        ends = [np.array(rk4(list(states + by), torques, nips)) for by in (change, -change)]
        total += np.abs(ends[0] - ends[1]) / (2 * small)
    return total


@pytest.mark.parametrize("book_or_nips", ["book", "nips"])
@pytest.mark.parametrize("n", [200, pytest.param(50_000, marks=pytest.mark.exhaustive)])
def test_step(n: int, book_or_nips: str) -> None:
    """One step from each of many states, on the CPU device, too: state, reward and end."""
    spec, generator = SPEC.with_options(book_or_nips=book_or_nips), np.random.default_rng(1)
    states = [generator.integers(*field.range, size=n, endpoint=True) for field in spec.state]
    move = compare_steps(spec, oracle(spec), states, tolerance=FREE)
    errors = np.stack([move.errors[name][:, 0] for name in NAMES]) / ULP
    torques = move.actions.ravel() - 1.0
    relative = errors / (1 + growth(np.stack(states) * ULP, torques, book_or_nips == "nips"))
    bound = np.isnan(errors[2]).mean()
    print(f"{book_or_nips}, in units of the last place: {np.nanmax(errors, 1).round(1)} at worst,")
    print(f"    {np.nanmax(relative, 1).round(1)} over 1 + growth; {bound:.2%} with speeds that are bound")
    assert (np.nanmax(relative, 1) < ANY).all()
    assert bound <= (0 if book_or_nips == "nips" else 0.02)
    assert np.mean(move.outcome.undecided) < 0.03
    assert 0.1 < move.ended.mean() < 0.5
    # So that a common error is far below the greatest.
    assert (np.nanmedian(errors, 1) < 4).all()


@pytest.mark.parametrize("book_or_nips", ["book", "nips"])
@pytest.mark.parametrize("steps", [60, pytest.param(200, marks=pytest.mark.exhaustive)])
def test_follows_the_oracle(steps: int, book_or_nips: str) -> None:
    """Whole runs: at each step the oracle starts from where ours stands."""
    spec = SPEC.with_options(book_or_nips=book_or_nips)
    moves = compare(spec, oracle(spec), 10, steps, seed=5, posed=True, tolerance=REACHED)
    errors = np.array([[np.nanmax(move.errors[name]) for name in NAMES] for move in moves])
    print("at worst, in units of the last place:", (errors.max(0) / ULP).round(2))


def test_the_equations_differ() -> None:
    """Or a test of either is one of both."""
    spec = SPEC.with_options(book_or_nips="nips")
    with pytest.raises(AssertionError, match="dtheta"):
        list(compare(spec, oracle(SPEC), 10, 20, posed=True, tolerance=REACHED))


def test_observations_are_gymnasiums() -> None:
    original: Any = gymnasium.make("Acrobot-v1").unwrapped
    env = pearl_marl.parallel_env("Acrobot", 10)
    env.reset_batch(seed=3)
    for action in (0, 0, 2, 2, 2):
        step = env.step_batch(np.full(10, action))
    for row, words in zip(step.obs, env.state(), strict=True):
        original.state = np.array(words)
        np.testing.assert_allclose(row, original._get_ob(), atol=2e-7)


def test_starts_are_uniform() -> None:
    env = pearl_marl.parallel_env("Acrobot", 43_008)
    env.reset_batch(seed=7)
    p_values = [stats.kstest(column, stats.uniform(-0.1, 0.2).cdf).pvalue for column in env.state().T]
    print("starts: p =", np.round(p_values, 3))
    assert min(p_values) > 0.001


@pytest.mark.exhaustive
def test_episodes_of_a_random_policy() -> None:
    """200 episodes of each: lengths and returns have one distribution."""
    ours = first_episodes(SPEC, 2_000, 1, random_actions_of(SPEC))
    lengths, returns = np.zeros(200), np.zeros(200)
    env, generator = gymnasium.make("Acrobot-v1", max_episode_steps=500), np.random.default_rng(2)
    for k in range(200):
        env.reset(seed=k)
        ended = False
        while not ended:
            _, reward, terminated, truncated, _ = env.step(int(generator.integers(3)))
            lengths[k] += 1
            returns[k] += float(reward)
            ended = terminated or truncated
    assert_same_play(ours, (lengths, returns))


def test_pictures_are_gymnasiums() -> None:
    env = drawing(SPEC)

    def drawn(state: Any) -> Array:
        env.unwrapped.state = np.array(state)
        picture: Array = env.render()
        return picture

    compare_pictures(SPEC, "rgb_array", drawn, [0, *[2] * 5, *[0] * 5], different=8)


@pytest.mark.parametrize("value", ["paper", None, 1])
def test_bad_equations(value: Any) -> None:
    with pytest.raises(ArgumentError, match=r"book_or_nips is .*book.*nips"):
        SPEC.with_options(book_or_nips=value)
