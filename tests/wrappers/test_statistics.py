"""Running normalisation: Gymnasium's numbers, but for what its wrappers carry over into the next episode."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers.utils import RunningMeanStd
from gymnasium.wrappers.vector import NormalizeObservation, NormalizeReward

import pearl_marl
from pearl_marl import wrappers
from pearl_marl.batch.actions import random_actions
from pearl_marl.errors import ArgumentError
from pearl_marl.testing.case import assert_same_trajectory, trajectory

pytestmark = pytest.mark.usefixtures("toys")

N = 30


def actions(steps: int, seed: int = 0) -> Any:
    return random_actions(pearl_marl.get_spec("Drift"), np.random.default_rng(seed), N * steps).reshape(
        steps, N
    )


@pytest.mark.parametrize("limit", [5, 0])
def test_observations_as_gymnasium_has_them(limit: int) -> None:
    ours, theirs = (
        kind(pearl_marl.make_vec("Drift", N, autoreset_mode="NextStep", max_cycles=limit))
        for kind in (wrappers.normalize_observation_v0, NormalizeObservation)
    )
    assert ours.single_observation_space == theirs.single_observation_space
    np.testing.assert_allclose(ours.reset(seed=1)[0], theirs.reset(seed=1)[0], rtol=2e-4, atol=2e-5)
    for t, act in enumerate(actions(50)):
        if t == 30:
            ours.transform.updates = theirs.update_running_mean = False
        mine, other = ours.step(act), theirs.step(act)
        assert mine[0].dtype == other[0].dtype == np.float32
        np.testing.assert_allclose(mine[0], other[0], rtol=2e-4, atol=2e-5)
        np.testing.assert_array_equal(mine[1:4], other[1:4])
    statistics = ours.transform.statistics()
    np.testing.assert_allclose(statistics["mean"], theirs.obs_rms.mean, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(statistics["variance"], theirs.obs_rms.var, rtol=1e-4)
    assert statistics["count"] == pytest.approx(theirs.obs_rms.count) == 31 * N + 1e-4


newer = pytest.mark.skipif(
    tuple(map(int, gymnasium.__version__.split(".")[:2])) < (1, 4),
    reason="Gymnasium before 1.4 counts the steps that reset, and starts no new sum in SAME_STEP mode",
)


@newer
@pytest.mark.parametrize("limit", [5, 0])
def test_rewards_as_gymnasium_has_them(limit: int) -> None:
    ours, theirs = (
        kind(pearl_marl.make_vec("Drift", N, max_cycles=limit), gamma=0.9)
        for kind in (wrappers.normalize_reward_v0, NormalizeReward)
    )
    ours.reset(seed=1)
    theirs.reset(seed=1)
    ends = 0
    for t, act in enumerate(actions(50)):
        if t == 30:
            ours.transform.updates = theirs.update_running_mean = False
        mine, other = ours.step(act), theirs.step(act)
        np.testing.assert_allclose(mine[1], other[1], rtol=1e-5)
        ends += int(np.sum(mine[2]))
    assert ends > N // 2


@newer
def test_next_step_mode_gives_the_rewards_of_same_step_mode() -> None:
    """Gymnasium's wrapper starts an episode with the sum of the one before, if that resets in a step."""
    slots = np.arange(N)
    for kind, alike in ((wrappers.normalize_reward_v0, True), (NormalizeReward, False)):
        same, after = (
            kind(pearl_marl.make_vec("CliffWalking", N, max_cycles=6, autoreset_mode=mode))
            for mode in ("SameStep", "NextStep")
        )
        same.reset(seed=0)
        after.reset(seed=0)
        expected, got = [], []
        for t in range(35):
            act = (slots + t) % 4
            got.append(after.step(act)[1])
            if t % 7 != 6:  # every seventh step resets
                expected.append(same.step(act)[1])
        got = [rewards for t, rewards in enumerate(got) if t % 7 != 6]
        assert np.allclose(got, expected, rtol=1e-5) == alike


def test_agents_that_left_do_not_count() -> None:
    env = pearl_marl.parallel_env("Drift", N, autoreset=False, max_cycles=20)
    plain = pearl_marl.parallel_env("Drift", N, autoreset=False, max_cycles=20)
    env = wrappers.normalize_reward_v0(wrappers.normalize_observation_v0(env), gamma=0)
    env.reset(seed=3)
    seen, rewards = list(plain.reset(seed=3)[0].values()), []
    for act in actions(30):
        env.step(act)
        obs, reward, *_ = plain.step(act)
        seen.extend(obs.values())
        rewards.extend(reward.values())
        if not plain.agents:
            break
    for transform, numbers in ((env.env.transform, np.array(seen)), (env.transform, np.array(rewards))):
        statistics = transform.statistics()
        assert statistics["count"] == pytest.approx(len(numbers), abs=0.01)
        np.testing.assert_allclose(np.ravel(statistics["mean"]), np.atleast_1d(numbers.mean(0)), rtol=1e-3)
        np.testing.assert_allclose(np.ravel(statistics["variance"]), np.atleast_1d(numbers.var(0)), rtol=1e-2)


def test_disabled_mode_counts_what_is_seen() -> None:
    env, plain = (pearl_marl.make_vec("Drift", N, autoreset_mode="Disabled", max_cycles=4) for _ in range(2))
    env = wrappers.normalize_observation_v0(env)
    env.reset(seed=3)
    seen = [plain.reset(seed=3)[0]]
    for act in actions(12):
        _, _, terms, truncs, _ = env.step(act)
        seen.append(plain.step(act)[0])
        if (ended := terms | truncs).any():
            env.reset(options={"reset_mask": ended})
            seen.append(plain.reset(options={"reset_mask": ended})[0][ended])
    rows = np.concatenate(seen)
    statistics = env.transform.statistics()
    assert statistics["count"] == pytest.approx(len(rows), abs=0.01)
    np.testing.assert_allclose(statistics["mean"], rows.mean(0), rtol=1e-3, atol=1e-4)


def test_statistics_far_from_zero() -> None:
    """They are kept in double precision, whatever the observations' dtype."""
    env = pearl_marl.make_vec("Drift", N)
    env = wrappers.observation_lambda_v0(env, lambda obs, space: obs * np.float32(1e-3) + np.float32(1000))
    plain, env = copy.deepcopy(env), wrappers.normalize_observation_v0(env)
    expected = RunningMeanStd(shape=(3,))
    env.reset(seed=0)
    expected.update(plain.reset(seed=0)[0].astype(np.float64))
    for act in actions(10):
        env.step(act)
        expected.update(plain.step(act)[0].astype(np.float64))
    statistics = env.transform.statistics()
    np.testing.assert_allclose(statistics["mean"], expected.mean, rtol=1e-12)
    np.testing.assert_allclose(statistics["variance"], expected.var, rtol=1e-9)


def test_statistics_of_training_for_evaluation() -> None:
    training = wrappers.normalize_observation_v0(pearl_marl.parallel_env("Drift", N))
    training.reset(seed=0)
    trajectory(training, actions(20))
    statistics = training.transform.statistics()
    evaluation = wrappers.normalize_observation_v0(pearl_marl.parallel_env("Drift", N))
    evaluation.transform.set_statistics(statistics)
    evaluation.transform.updates = False
    training.transform.updates = False
    np.testing.assert_array_equal(training.reset_batch(5), evaluation.reset_batch(5))
    assert_same_trajectory(*(trajectory(env, actions(20)) for env in (training, evaluation)))
    np.testing.assert_equal(evaluation.transform.statistics(), statistics)
    evaluation.transform.updates = True
    trajectory(evaluation, actions(1))
    assert evaluation.transform.statistics()["count"] > statistics["count"]
    for bad in ({}, {**statistics, "mean": np.zeros(2)}):
        with pytest.raises(ArgumentError, match="mean"):
            evaluation.transform.set_statistics(bad)
