"""Stable-Baselines3 through our bridge: conventions, buffers, algorithms, and what SuperSuit does instead."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiDiscrete, Tuple

import pearl_marl
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.errors import ActionError, ArgumentError, OrderError
from pearl_marl.wrappers import clip_reward_v0, flatten_v0, frame_stack_v1, observation_lambda_v0, sb3_vec_env

pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed: pip install '.[train]'")

import torch
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.callbacks import EvalCallback, StopTrainingOnRewardThreshold
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecMonitor, VecNormalize

from ..toy import ENVIRONMENTS

pytestmark = pytest.mark.usefixtures("toys", "one_thread")

MAKERS = {
    "parallel": lambda name, n, **arguments: pearl_marl.parallel_env(name, n, **arguments),
    "vector": lambda name, n, **arguments: pearl_marl.make_vec(name, n, **arguments),
}


@pytest.fixture(params=MAKERS)
def make(request: pytest.FixtureRequest) -> Callable[..., Any]:
    """Make an environment of either interface."""
    return MAKERS[request.param]


def monitored(name: str, n: int, max_cycles: int) -> DummyVecEnv:
    """Return SB3's own chain around Gymnasium's environment."""

    def one() -> Any:
        return Monitor(gymnasium.make(name, max_episode_steps=max_cycles))

    return DummyVecEnv([one] * n)


def test_cliff_walking_is_what_sb3_makes_of_gymnasiums(make: Callable[..., Any]) -> None:
    """Step for step the same observations, rewards, dones and infos, types included."""
    n, limit = 6, 7
    theirs = monitored("CliffWalking-v1", n, limit)
    ours = sb3_vec_env(make("CliffWalking", n, max_cycles=limit))
    assert (ours.num_envs, ours.observation_space, ours.action_space) == (
        theirs.num_envs,
        theirs.observation_space,
        theirs.action_space,
    )
    generator = np.random.default_rng(0)
    for first in (ours.reset(), theirs.reset()):
        assert first.dtype == np.int64
        np.testing.assert_array_equal(first, [36] * n)
    ends = 0
    for _ in range(30):
        actions = generator.integers(4, size=n)
        mine, other = ours.step(actions), theirs.step(actions)
        for a, b in zip(mine[:3], other[:3], strict=True):
            assert (type(a), a.dtype, a.shape) == (type(b), b.dtype, b.shape)
            np.testing.assert_array_equal(a, b)
        for done, info, expected in zip(mine[2], mine[3], other[3], strict=True):
            if not done:
                assert info == {}
                continue
            ends += 1
            assert info["terminal_observation"] == expected["terminal_observation"]
            assert info["TimeLimit.truncated"] is expected["TimeLimit.truncated"] is True
            assert info["episode"]["r"] == expected["episode"]["r"]
            assert info["episode"]["l"] == expected["episode"]["l"] == limit
            assert {name: type(value) for name, value in info["episode"].items()} == {
                "r": float,
                "l": int,
                "t": float,
            }
    assert ends == 4 * n


def test_a_goal_in_the_last_step_is_no_truncation() -> None:
    """Both flags are set then, and SB3 must not bootstrap from beyond a terminal state."""
    path = [0] + [1] * 11 + [2]
    theirs = monitored("CliffWalking-v1", 1, len(path))
    ours = sb3_vec_env(pearl_marl.parallel_env("CliffWalking", 1, max_cycles=len(path)))
    for env in (ours, theirs):
        env.reset()
        for action in path:
            _, _, dones, infos = env.step(np.array([action]))
        assert dones[0]
        assert infos[0]["TimeLimit.truncated"] is False
        assert infos[0]["terminal_observation"] == 47


def test_cart_pole_has_the_shapes_and_types_of_gymnasiums() -> None:
    """Numbers differ: ours are fixed point."""
    ours, theirs = (
        sb3_vec_env(pearl_marl.parallel_env("CartPole", 5)),
        monitored("CartPole-v1", 5, 500),
    )
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    ended = False
    pairs = [(ours.reset(), theirs.reset())]
    for _ in range(40):
        mine, other = ours.step(np.ones(5, np.int64)), theirs.step(np.ones(5, np.int64))
        pairs += list(zip(mine[:3], other[:3], strict=True))
        for info, expected, done in zip(mine[3], other[3], mine[2] & other[2], strict=True):
            if done:
                ended = True
                assert info.keys() == expected.keys()
                for a, b in ((i["terminal_observation"] for i in (info, expected)),):
                    assert (a.dtype, a.shape) == (b.dtype, b.shape)
    assert ended
    for a, b in pairs:
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
    rewards = ours.step(np.ones(5, np.int64))[1]
    rewards[2] += 0.5  # as SB3 does where it bootstraps
    assert rewards[2] == 1.5


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_every_environment(name: str, make: Callable[..., Any]) -> None:
    """What comes out is in the spaces, and equals a plain batch of the same seed."""
    n = 10
    if make is MAKERS["vector"] and pearl_marl.get_spec(name).agents > 1:
        pytest.skip("a VectorEnv cannot represent worlds of several agents")
    env = sb3_vec_env(make(name, n, max_cycles=5))
    plain = pearl_marl.parallel_env(name, n, max_cycles=5)
    assert isinstance(env.observation_space, (Box, Discrete, MultiDiscrete))
    env.seed(4)
    obs = env.reset()
    np.testing.assert_array_equal(obs, plain.reset_batch(4))
    assert all(env.observation_space.contains(row) for row in obs)
    env.action_space.seed(0)
    for _ in range(12):
        masks = [None] * n if plain.action_masks is None else env.env_method("action_masks")
        actions = np.stack([env.action_space.sample(mask) for mask in masks])
        obs, rewards, dones, infos = env.step(actions)
        step = plain.step_batch(actions)
        np.testing.assert_array_equal(obs, step.obs)
        np.testing.assert_array_equal(rewards, step.rewards)
        np.testing.assert_array_equal(dones, step.ended)
        assert (rewards.dtype, dones.dtype) == (np.float32, np.bool_)
        assert all(env.observation_space.contains(row) for row in obs)
        for slot, info in enumerate(infos):
            assert bool(info) == dones[slot]
            if info:
                np.testing.assert_array_equal(info["terminal_observation"], step.final_obs[slot])
                assert env.observation_space.contains(info["terminal_observation"])
                assert info["TimeLimit.truncated"] is bool(
                    step.truncations[slot] and not step.terminations[slot]
                )
    env.close()
    with pytest.raises(OrderError, match=r"after close\(\)"):
        env.reset()


def test_what_is_written_into_an_info_stays_there() -> None:
    """Neither other slots see it nor later steps, and what was kept of earlier steps keeps it."""
    env = sb3_vec_env(pearl_marl.parallel_env("CliffWalking", 100, max_cycles=2))
    env.reset()
    kept = []
    for _ in range(4):
        infos = env.step(np.zeros(100, np.int64))[3]
        assert not any("mine" in info for info in infos)
        for slot, info in enumerate(infos):
            info["mine"] = slot
        kept.append(infos)
    assert all([info["mine"] for info in infos] == list(range(100)) for infos in kept)


def test_evaluation_counts_no_episode_that_staggering_cut() -> None:
    env = sb3_vec_env(pearl_marl.parallel_env("CliffWalking", 5, max_cycles=10), staggered=True)
    model = PPO("MlpPolicy", env, n_steps=2, batch_size=10, n_epochs=1, seed=0)
    _, lengths = evaluate_policy(model, env, n_eval_episodes=10, return_episode_rewards=True)
    assert lengths == [10] * 10


def test_films_go_by_the_environments_frame_rate() -> None:
    env = pearl_marl.parallel_env("CartPole", 2)
    assert sb3_vec_env(env).metadata["render_fps"] == env.metadata["render_fps"] == 50


def test_episode_statistics_are_those_of_sb3s_own_monitor() -> None:
    ours = sb3_vec_env(pearl_marl.parallel_env("Drift", 40))
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        twin = VecMonitor(sb3_vec_env(pearl_marl.parallel_env("Drift", 40)))
    generator = np.random.default_rng(0)
    episodes = 0
    for seed in (1, 2):
        for env in (ours, twin):
            env.seed(seed)
            env.reset()
        for _ in range(30):
            actions = generator.integers(5, size=40)
            mine, other = ours.step(actions)[3], twin.step(actions)[3]
            for a, b in zip(mine, other, strict=True):
                if a:
                    episodes += 1
                    assert a["episode"]["l"] == b["episode"]["l"]
                    np.testing.assert_allclose(a["episode"]["r"], b["episode"]["r"], rtol=1e-5, atol=1e-4)
    assert episodes > 100


@pytest.mark.parametrize("copy", [True, False])
def test_observations_outlive_the_next_step(make: Callable[..., Any], copy: bool) -> None:
    """SB3 stores a step's observation when it has taken the next, and final ones at any time."""
    env = sb3_vec_env(make("Drift", 20, max_cycles=3, copy=copy))
    generator = np.random.default_rng(0)
    last = env.reset()
    held, finals = last.copy(), []
    for _ in range(10):
        obs, _, _, infos = env.step(generator.integers(5, size=20))
        np.testing.assert_array_equal(last, held)
        last, held = obs, obs.copy()
        finals += [(i["terminal_observation"], i["terminal_observation"].copy()) for i in infos if i]
    assert finals
    for late, early in finals:
        np.testing.assert_array_equal(late, early)


def test_wrapped_environments(make: Callable[..., Any]) -> None:
    env = sb3_vec_env(frame_stack_v1(make("Drift", 8, max_cycles=2), 2))
    assert env.observation_space.shape == (6,)
    plain = sb3_vec_env(make("Drift", 8, max_cycles=2))
    for e in (env, plain):
        e.seed(0)
        e.reset()
    for _ in range(2):
        stacked, single = env.step(np.full(8, 3)), plain.step(np.full(8, 3))
    assert stacked[2].all()
    final, expected = (s[3][0]["terminal_observation"] for s in (stacked, single))
    np.testing.assert_array_equal(final[3:], expected)
    np.testing.assert_array_equal(stacked[0][:, :3], 0)  # nothing of the old episode
    np.testing.assert_array_equal(stacked[0][:, 3:], single[0])


def test_discrete_spaces_that_do_not_begin_at_0() -> None:
    moved = observation_lambda_v0(
        pearl_marl.parallel_env("CliffWalking", 3, max_cycles=1),
        lambda obs, space: obs + 5,
        lambda space: Discrete(48, start=5),
    )
    env = sb3_vec_env(moved)
    assert env.observation_space == Discrete(48)
    np.testing.assert_array_equal(env.reset(), 36)
    obs, _, _, infos = env.step(np.zeros(3, np.int64))
    np.testing.assert_array_equal(obs, 36)
    assert infos[0]["terminal_observation"] == 24


def test_a_tuple_becomes_multi_discrete() -> None:
    assert isinstance(pearl_marl.get_spec("Ladder").observation_space, Tuple)
    env = sb3_vec_env(pearl_marl.parallel_env("Ladder", 4, max_cycles=6))
    assert env.observation_space == MultiDiscrete([10, 2])
    PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0).learn(64)


@pytest.mark.parametrize("name", ["Seaquest", "Slide"])
def test_pictures_of_bools_are_learned_from_as_they_are(name: str) -> None:
    """``MlpPolicy`` flattens them; buffers keep a byte an element."""
    env = sb3_vec_env(pearl_marl.parallel_env(name, 4))
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0).learn(64)
    assert model.rollout_buffer.observations.dtype == np.bool_
    assert model.rollout_buffer.observations.any()
    flat = sb3_vec_env(flatten_v0(pearl_marl.parallel_env(name, 4)))
    assert flat.observation_space.shape == (np.prod(env.observation_space.shape),)


def test_sb3s_own_wrappers_go_around_it() -> None:
    env = VecFrameStack(VecNormalize(sb3_vec_env(pearl_marl.parallel_env("CartPole", 4, max_cycles=9))), 3)
    model = A2C("MlpPolicy", env, seed=0).learn(200)
    assert model.ep_info_buffer


# What is refused


@pytest.mark.parametrize(
    ("env", "words"),
    [
        (lambda: pearl_marl.parallel_env("CliffWalking", 2, autoreset=False), "autoreset=True"),
        (lambda: pearl_marl.make_vec("CliffWalking", 2, autoreset_mode="NextStep"), "NEXT_STEP.*'SameStep'"),
        (lambda: pearl_marl.make_vec("CliffWalking", 2, autoreset_mode="Disabled"), "DISABLED.*'SameStep'"),
        (lambda: gymnasium.make_vec("CartPole-v1", 2), "SyncVectorEnv|CartPoleVectorEnv"),
    ],
)
def test_environments_that_start_over_otherwise_are_refused(env: Callable[[], Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        sb3_vec_env(env())


def test_other_refusals() -> None:
    env = sb3_vec_env(pearl_marl.parallel_env("CliffWalking", 3))
    with pytest.raises(OrderError, match="step_async"):
        env.step_wait()
    env.reset()
    with pytest.raises(ActionError, match=r"agent_1.*9"):
        env.step(np.array([0, 9, 0]))
    np.testing.assert_array_equal(env.step(np.zeros(3, np.int64))[0], 24)
    env.set_options({})
    env.set_options([{}, {}, {}])
    with pytest.raises(ArgumentError, match="'low'"):
        env.set_options({"low": 1})
    with pytest.raises(ArgumentError, match=r"\[1\].*all 3"):
        env.set_attr("max_cycles", 4, indices=[1])
    with pytest.raises(ArgumentError, match="env_method"):
        env.env_method("state", indices=0)
    with pytest.raises(ArgumentError, match="has none"):
        sb3_vec_env(pearl_marl.parallel_env("CliffWalking", 3, max_cycles=0), staggered=True)
    with pytest.raises(ArgumentError, match="'yes'"):
        sb3_vec_env(pearl_marl.parallel_env("CliffWalking", 3, max_cycles=5), staggered="yes")
    with pytest.raises(OrderError, match="rgb_array"):
        env.get_images()


def test_attributes_and_methods() -> None:
    env = sb3_vec_env(pearl_marl.parallel_env("CliffWalking", 3))
    env.reset()
    assert env.get_attr("render_mode") == [None] * 3
    assert env.get_attr("max_cycles", indices=[0, 2]) == [0, 0]
    assert not env.has_attr("nonsense")
    env.set_attr("max_cycles", 2)
    assert env.env.max_cycles == 2
    over = sb3_vec_env(clip_reward_v0(pearl_marl.make_vec("CliffWalking", 3)))
    over.set_attr("max_cycles", 2)
    assert over.get_attr("max_cycles") == [2] * 3
    for one in (env, over):
        one.reset()
        assert [one.step(np.zeros(3, np.int64))[2].any() for _ in range(4)] == [False, True, False, True]
    states = env.env_method("state")
    assert len(states) == 3
    assert states[0].shape[0] == 3
    assert env.env_is_wrapped(Monitor) == [True] * 3
    assert env.env_is_wrapped(gymnasium.Wrapper, indices=[1]) == [False]
    wrapped = sb3_vec_env(frame_stack_v1(pearl_marl.parallel_env("CliffWalking", 3), 2))
    assert wrapped.env_is_wrapped(type(wrapped.env)) == [True] * 3


def test_pictures_of_the_first_slots() -> None:
    pytest.importorskip("pygame", reason="Gymnasium draws with pygame")
    env = sb3_vec_env(pearl_marl.parallel_env("CliffWalking", 20, render_mode="rgb_array"))
    env.reset()
    assert len(env.get_images()) == 16
    image = env.render()
    assert image is not None
    assert image.shape[2] == 3


# Seeds


def by_step(array: np.ndarray, steps: int) -> np.ndarray:
    """Return a rollout buffer's array, which training has left slot by slot, with a row a step."""
    return array.reshape(-1, steps, *array.shape[1:]).swapaxes(0, 1).copy()


def rollout_of(seed: int | None, make: Callable[..., Any]) -> np.ndarray:
    model = PPO("MlpPolicy", sb3_vec_env(make("CartPole", 8)), n_steps=16, batch_size=64, seed=seed)
    model.learn(128)
    return by_step(model.rollout_buffer.observations, 16)


def test_a_seed_given_to_an_algorithm_repeats_its_training(make: Callable[..., Any]) -> None:
    first = rollout_of(1, make)
    np.testing.assert_array_equal(first, rollout_of(1, make))
    assert (first != rollout_of(2, make)).any()
    assert len(np.unique(first[0], axis=0)) == 8, "every slot starts in a state of its own"


def test_seed_holds_for_one_reset() -> None:
    env = sb3_vec_env(pearl_marl.parallel_env("CartPole", 8))
    assert env.seed(7) == [7] * 8
    first = env.reset()
    assert (env.reset() != first).any()
    env.seed(7)
    np.testing.assert_array_equal(env.reset(), first)
    np.random.seed(0)  # noqa: NPY002
    drawn = env.seed()
    np.random.seed(0)  # noqa: NPY002
    assert env.seed() == drawn
    env.seed(-3)
    with pytest.raises(ArgumentError, match="-3"):
        env.reset()


# Staggered first episodes


def test_staggered_first_episodes_end_at_different_steps(make: Callable[..., Any]) -> None:
    n, limit = 60, 12
    env = sb3_vec_env(make("CliffWalking", n, max_cycles=limit), staggered=True)
    plain = sb3_vec_env(make("CliffWalking", n, max_cycles=limit))
    for _ in range(2):  # every reset does
        np.testing.assert_array_equal(env.reset(), plain.reset())
        ends = []
        for _ in range(3 * limit):
            obs, _, dones, infos = env.step(np.zeros(n, np.int64))
            ends.append(int(dones.sum()))
            for info in (i for i in infos if i):
                assert info["TimeLimit.truncated"]
                if "episode" in info:  # the cut ones are not counted
                    assert info["episode"]["l"] == -info["episode"]["r"] == limit
        assert ends == [n // limit] * (3 * limit)
        assert all(info["episode"]["l"] == limit for info in infos if info)
    assert len(np.unique(obs)) > 1


def test_staggering_changes_nothing_but_when_episodes_end() -> None:
    envs = [
        sb3_vec_env(frame_stack_v1(pearl_marl.parallel_env("CartPole", 6), 2), staggered=staggered)
        for staggered in (True, False)
    ]
    for env in envs:
        env.seed(3)
    first, second = (env.reset() for env in envs)
    np.testing.assert_array_equal(first, second)
    first, second = (env.step(np.ones(6, np.int64)) for env in envs)
    np.testing.assert_array_equal(first[0], second[0])


# Buffers


def test_replay_buffers_hold_the_true_transitions() -> None:
    """What DQN keeps after many steps is what every slot, stepped on its own, goes through."""
    n, steps, limit = 3, 100, 18
    env = sb3_vec_env(pearl_marl.parallel_env("CartPole", n, max_cycles=limit))
    model = DQN("MlpPolicy", env, buffer_size=n * steps, learning_starts=10_000, seed=5)
    model.learn(n * steps)
    buffer = model.replay_buffer
    assert buffer is not None
    terminated = truncated = 0
    for slot in range(n):
        spec = pearl_marl.get_spec("CartPole")
        alone = Native().open(BatchConfig(spec=spec, n_envs=1, first_slot=slot, max_cycles=limit))
        obs = alone.reset(seed=5)
        for t in range(steps):
            step = alone.step(buffer.actions[t, slot].astype(np.uint8))
            where = f"slot {slot}, step {t}"
            np.testing.assert_array_equal(buffer.observations[t, slot], obs[0], where)
            np.testing.assert_array_equal(buffer.next_observations[t, slot], step.arrivals()[0], where)
            assert buffer.rewards[t, slot] == step.rewards[0]
            assert buffer.dones[t, slot] == step.ended[0]
            assert buffer.timeouts[t, slot] == (step.truncations[0] and not step.terminations[0])
            terminated += int(step.terminations[0])
            truncated += int(buffer.timeouts[t, slot])
            obs = step.obs.copy()
    assert terminated
    assert truncated


def test_rollouts_bootstrap_where_only_the_time_limit_ended_an_episode() -> None:
    """The rewards in PPO's buffer have the value of the true last observation added there, and there only."""
    n, limit = 4, 3
    model = PPO(
        "MlpPolicy",
        sb3_vec_env(pearl_marl.parallel_env("CartPole", n, max_cycles=limit)),
        n_steps=6,
        batch_size=24,
        n_epochs=1,
        learning_rate=0.0,
        seed=2,
    )
    model.learn(24)
    buffer = model.rollout_buffer
    plain = pearl_marl.parallel_env("CartPole", n, max_cycles=limit)
    plain.reset_batch(2)
    for t in range(6):
        actions = by_step(buffer.actions, 6)[t, :, 0].astype(np.int64)
        step = plain.step_batch(actions)
        assert step.truncations.all() == (t % limit == limit - 1)
        expected = step.rewards.copy()
        if step.truncations.any():
            values = model.policy.predict_values(torch.from_numpy(step.final_obs)).detach().numpy()
            expected += model.gamma * values[:, 0]
        np.testing.assert_allclose(buffer.rewards[t], expected, rtol=1e-6)


# Learning: budgets of seconds, one seed, and settings that were tried on it. Thresholds tell a bridge that
# works from one that loses what is learned from, not how well an algorithm does on an environment.


def native(name: str, n: int, **arguments: Any) -> Any:
    return sb3_vec_env(pearl_marl.parallel_env(name, n, device=Native(threads=1), **arguments))


def mean_return(model: Any, env: Any) -> float:
    env.seed(123)
    return float(evaluate_policy(model, env, n_eval_episodes=20)[0])


@pytest.mark.slow
def test_ppo_learns_cart_pole() -> None:
    model = PPO(
        "MlpPolicy",
        native("CartPole", 64),
        n_steps=32,
        batch_size=256,
        n_epochs=10,
        learning_rate=1e-3,
        gamma=0.98,
        gae_lambda=0.8,
        seed=0,
    )
    assert mean_return(model.learn(60_000), native("CartPole", 10)) > 400  # of 500


@pytest.mark.exhaustive
def test_ppo_learns_cliff_walking() -> None:
    model = PPO(
        "MlpPolicy",
        # A fall costs ten steps, not a hundred: with a hundred most settings tried ended at -200.
        native("CliffWalking", 1024, max_cycles=60, rewards=[-0.1, -1.0]),
        n_steps=32,
        batch_size=4096,
        n_epochs=10,
        learning_rate=3e-3,
        gamma=0.97,
        ent_coef=0.01,
        policy_kwargs={"net_arch": [64]},
        seed=0,
    )
    assert mean_return(model.learn(400_000), native("CliffWalking", 4, max_cycles=200)) >= -20  # best: -13


@pytest.mark.exhaustive
def test_dqn_learns_cart_pole() -> None:
    model = DQN(
        "MlpPolicy",
        native("CartPole", 16),
        learning_rate=5e-4,
        buffer_size=100_000,
        learning_starts=1000,
        batch_size=64,
        train_freq=1,
        gradient_steps=8,
        target_update_interval=1000,
        exploration_fraction=0.2,
        exploration_final_eps=0.04,
        seed=0,
    )
    # What DQN has learned of CartPole it forgets again now and then, on any environment.
    tested = native("CartPole", 10)
    tested.seed(123)
    enough = StopTrainingOnRewardThreshold(195)  # at random: 22
    best = EvalCallback(tested, callback_on_new_best=enough, eval_freq=250, n_eval_episodes=20, verbose=0)
    model.learn(60_000, callback=best)
    assert best.best_mean_reward > 195


@pytest.mark.exhaustive
def test_dqn_learns_cliff_walking() -> None:
    model = DQN(
        "MlpPolicy",
        native("CliffWalking", 64, max_cycles=200),
        learning_rate=1e-3,
        buffer_size=50_000,
        learning_starts=5000,
        batch_size=256,
        train_freq=1,
        gradient_steps=2,
        target_update_interval=64,
        exploration_fraction=0.5,
        policy_kwargs={"net_arch": [64]},
        seed=0,
    )
    assert mean_return(model.learn(100_000), native("CliffWalking", 4, max_cycles=200)) >= -17  # best: -13


def test_the_rollout_experiment_runs(tmp_path: Path) -> None:
    script = Path(__file__).parents[2] / "experiments" / "sb3_rollout.py"
    arguments = ["--n-agents", "16", "--steps", "4", "--rounds", "1", "--out", str(tmp_path)]
    done = subprocess.run([sys.executable, script, *arguments], capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads((tmp_path / "sb3_rollout.json").read_text())
    assert [(row["name"], row["n_agents"]) for row in figures] == [("ours", 16), ("SuperSuit", 16)]
    assert all(0 < row["stepping"] < row["rollout"] for row in figures)


# SuperSuit's faults: first its answer, then ours


def supersuit_chain(env: Any) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it tells of its successor
        supersuit = pytest.importorskip("supersuit", reason="SuperSuit is not installed")
        env = supersuit.pettingzoo_env_to_vec_env_v1(env)
        return supersuit.concat_vec_envs_v1(env, 1, num_cpus=1, base_class="stable_baselines3")


def both(n: int, **arguments: Any) -> tuple[Any, Any]:
    """Return SuperSuit's chain and ours around CartPole; neither has begun."""
    theirs, ours = (pearl_marl.parallel_env("CartPole", n, **arguments) for _ in range(2))
    return supersuit_chain(theirs), sb3_vec_env(ours)


def until_one_ends(env: Any, alone: bool) -> tuple[np.ndarray, np.ndarray, list[dict[str, Any]]]:
    """Push to one side in slot 0, both in turn in the others, until slot 0 ends alone, or all end."""
    env.reset()
    for t in range(600):
        obs, _, dones, infos = env.step(np.array([1, t % 2, t % 2]))
        if dones[0] and (not dones[1:].any() if alone else dones.all()):
            return obs, dones, infos
    raise AssertionError("never")


def test_supersuit_loses_truncation() -> None:
    theirs, ours = both(3, max_cycles=4)
    assert not any("TimeLimit.truncated" in info for info in until_one_ends(theirs, alone=False)[2])
    assert all(info["TimeLimit.truncated"] for info in until_one_ends(ours, alone=False)[2])


def test_supersuit_has_no_terminal_observation_where_one_ends() -> None:
    theirs, ours = both(3)
    assert "terminal_observation" not in until_one_ends(theirs, alone=True)[2][0]
    obs, _, infos = until_one_ends(ours, alone=True)
    assert abs(infos[0]["terminal_observation"][2]) > 0.2  # the pole has fallen
    assert abs(obs[0][2]) <= 0.05  # and stands again


def test_supersuits_terminal_observation_is_that_of_the_reset() -> None:
    """Where all end at once: twice reset, and the episode begun first is thrown away."""
    theirs, ours = both(3, max_cycles=4)
    _, _, infos = until_one_ends(theirs, alone=False)
    assert all(abs(info["terminal_observation"][1]) <= 0.05 for info in infos)  # nobody has pushed yet
    _, _, infos = until_one_ends(ours, alone=False)
    assert abs(infos[0]["terminal_observation"][1]) > 0.5  # four pushes to one side


def test_supersuit_crashes_on_a_seed() -> None:
    theirs, ours = both(3)
    with pytest.raises(AttributeError, match="seed"):
        PPO("MlpPolicy", theirs, seed=0)
    PPO("MlpPolicy", ours, seed=0)


def test_supersuit_cannot_be_asked_for_its_attributes() -> None:
    theirs, ours = both(3)
    with pytest.raises(AttributeError):
        theirs.get_attr("max_cycles")
    assert ours.get_attr("max_cycles") == [500] * 3
