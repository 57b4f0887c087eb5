"""imitation: demonstrations, cloning, learned rewards and GAIL on ``sb3_vec_env``, as they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.wrappers import sb3_vec_env

pytest.importorskip("imitation", reason="imitation is not installed: make test-clients")
from imitation.algorithms.adversarial.gail import GAIL
from imitation.algorithms.bc import BC
from imitation.data import rollout
from imitation.data.wrappers import BufferingWrapper, RolloutInfoWrapper  # noqa: F401
from imitation.rewards.reward_nets import BasicRewardNet
from imitation.rewards.reward_wrapper import RewardVecEnvWrapper
from stable_baselines3 import PPO

N = 4


def made(max_cycles: int = 10) -> Any:
    return sb3_vec_env(pearl_marl.parallel_env("CartPole", N, max_cycles=max_cycles))


def learner(env: Any) -> PPO:
    return PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0)


def demonstrations(env: Any) -> Any:
    generator = np.random.default_rng(0)
    until = rollout.make_sample_until(min_timesteps=None, min_episodes=8)
    return rollout.rollout(learner(env), env, until, rng=generator, unwrap=False)


def test_demonstrations_are_episodes() -> None:
    episodes = demonstrations(made())
    assert len(episodes) >= 8
    for episode in episodes:
        assert len(episode.acts) == len(episode.obs) - 1 <= 10
        np.testing.assert_array_equal(episode.rews, 1)
        # From one observation to the next in one episode: no jump to the start of another.
        assert (abs(np.diff(episode.obs[:, 0])) < 0.1).all()


def test_cloning() -> None:
    env = made()
    transitions = rollout.flatten_trajectories(demonstrations(env))
    cloned = BC(
        observation_space=env.observation_space,
        action_space=env.action_space,
        demonstrations=transitions,
        rng=np.random.default_rng(0),
        batch_size=8,
    )
    cloned.train(n_batches=4, progress_bar=False)


def test_each_slot_gets_its_own_reward() -> None:
    """Its wrapper writes into the infos of every slot."""
    env = RewardVecEnvWrapper(made(), lambda obs, actions, next_obs, dones: obs[:, 0].astype(np.float64))
    before = env.reset()
    for _ in range(12):
        observations, rewards, _, infos = env.step(np.ones(N, np.int64))
        np.testing.assert_array_equal(rewards, before[:, 0].astype(np.float64))
        assert [info["original_env_rew"] for info in infos] == [1.0] * N
        before = observations


def test_gail() -> None:
    env = made()
    trainer = GAIL(
        demonstrations=demonstrations(env),
        demo_batch_size=8,
        venv=env,
        gen_algo=learner(env),
        reward_net=BasicRewardNet(env.observation_space, env.action_space),
        allow_variable_horizon=True,
    )
    trainer.train(64)
