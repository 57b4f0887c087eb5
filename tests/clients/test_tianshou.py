"""tianshou: its wrapper of PettingZoo's AEC form and its collectors, as they are."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import pearl_marl

pytest.importorskip("tianshou", reason="tianshou is not installed: make test-clients")
from tianshou.algorithm import MARLRandomDiscreteMaskedOffPolicyAlgorithm
from tianshou.algorithm.multiagent.marl import MultiAgentOffPolicyAlgorithm
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv, PettingZooEnv, SubprocVectorEnv

pytestmark = pytest.mark.filterwarnings("ignore")


def made(name: str) -> PettingZooEnv:
    return PettingZooEnv(pearl_marl.env(name, max_cycles=20))


@pytest.mark.parametrize("name", ["ConnectFour", "CoinGame"])
def test_a_game(name: str) -> None:
    env = made(name)
    observation, _ = env.reset(seed=0)
    generator = np.random.default_rng(0)
    agents = set()
    for _ in range(100):
        agents.add(observation["agent_id"])
        action = int(generator.choice(np.flatnonzero(observation["mask"])))
        observation, rewards, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break
    assert terminated or truncated
    assert agents == {"agent_0", "agent_1"}
    assert len(rewards) == 2


@pytest.mark.parametrize("vector", [DummyVectorEnv, pytest.param(SubprocVectorEnv, marks=pytest.mark.slow)])
def test_collecting(vector: type[DummyVectorEnv]) -> None:
    envs = vector([partial(made, "ConnectFour") for _ in range(2)])
    env = made("ConnectFour")
    players = [MARLRandomDiscreteMaskedOffPolicyAlgorithm(action_space=env.action_space) for _ in env.agents]
    algorithm = MultiAgentOffPolicyAlgorithm(algorithms=players, env=env)
    collector = Collector(algorithm, envs, VectorReplayBuffer(400, 2))
    collector.reset()
    result = collector.collect(n_episode=4)
    assert result.n_collected_episodes == 4
    assert all(sorted(returns) in ([-1, 1], [0, 0]) for returns in result.returns.tolist())
    envs.close()
