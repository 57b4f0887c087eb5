"""Stable-Baselines3 and sb3-contrib: their wrappers and algorithms on ``sb3_vec_env``, as they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.wrappers import sb3_vec_env

pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed")
from stable_baselines3 import A2C, DQN, PPO, SAC
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecCheckNan, VecFrameStack, VecMonitor, VecNormalize

N = 4


def made(name: str) -> Any:
    return sb3_vec_env(pearl_marl.parallel_env(name, N, max_cycles=10))


ALGORITHMS: dict[str, Any] = {
    "A2C": lambda env: A2C("MlpPolicy", env, n_steps=4, seed=0),
    "PPO": lambda env: PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0),
    "DQN": lambda env: DQN("MlpPolicy", env, learning_starts=8, batch_size=8, train_freq=2, seed=0),
    "SAC": lambda env: SAC("MlpPolicy", env, learning_starts=8, batch_size=8, train_freq=8, seed=0),
}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_learning_and_loading(algorithm: str, tmp_path: Path) -> None:
    env = VecMonitor(VecCheckNan(made("Pendulum" if algorithm == "SAC" else "CartPole")))
    model = ALGORITHMS[algorithm](env)
    model.learn(96, callback=EvalCallback(made(env.get_attr("spec")[0].name), eval_freq=40, verbose=0))
    assert {info["l"] for info in model.ep_info_buffer} <= set(range(1, 11))
    model.save(tmp_path / "model")
    again = type(model).load(tmp_path / "model", env=made(env.get_attr("spec")[0].name))
    observations = env.reset()
    np.testing.assert_array_equal(
        again.predict(observations, deterministic=True)[0], model.predict(observations, deterministic=True)[0]
    )
    assert len(evaluate_policy(again, again.get_env(), 5, return_episode_rewards=True)[0]) == 5


def test_wrappers(tmp_path: Path) -> None:
    env = VecNormalize(VecFrameStack(made("CartPole"), 3))
    PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0).learn(64)
    env.save(str(tmp_path / "statistics"))
    again = VecNormalize.load(str(tmp_path / "statistics"), VecFrameStack(made("CartPole"), 3))
    np.testing.assert_array_equal(again.obs_rms.mean, env.obs_rms.mean)
    env.venv.set_attr("max_cycles", 2)
    env.reset()
    assert [env.step(np.zeros(N, np.int64))[2].all() for _ in range(4)] == [False, True, False, True]


def test_masks() -> None:
    contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    env = sb3_vec_env(pearl_marl.parallel_env("LevelBasedForaging", 4, max_cycles=10))
    contrib.MaskablePPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0).learn(64)


def test_memory() -> None:
    contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    model = contrib.RecurrentPPO("MlpLstmPolicy", made("CartPole"), n_steps=8, batch_size=16, n_epochs=1)
    model.learn(64)
