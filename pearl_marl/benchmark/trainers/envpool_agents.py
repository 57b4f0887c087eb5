"""EnvPool's environments, a row for each agent, as Gymnasium's vector environments."""

from __future__ import annotations

from typing import Any

import envpool
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.benchmark.peers import quiet_spaces

NAMES = {"CartPole": "CartPole-v1", "MountainCar": "MountainCar-v0", "FrozenLake": "FrozenLake-v1"}
"""EnvPool's names of environments that have one agent, by ours."""


class Foraging:
    """EnvPool's foraging: worlds of two agents, with Jumanji's rules. Agents observe which one they are."""

    agents = 2

    def __init__(self, n: int, seed: int) -> None:
        self._envs = envpool.make(
            "LevelBasedForaging-v0", env_type="gymnasium", num_envs=n // self.agents, seed=seed
        )
        with quiet_spaces():
            size = self._envs.observation_space["agents_view"].shape[-1] + self.agents
            actions = int(self._envs.action_space.high.max()) + 1
        self.observation_space = Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space = Discrete(actions)

    def reset(self, agents: npt.NDArray[Any] | None = None) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Reset all worlds, or those of some agents, which have to be all agents of their worlds."""
        worlds = () if agents is None else (agents[:: self.agents] // self.agents,)
        obs, infos = self._envs.reset(*worlds)
        return self._observations(obs, infos["env_id"].argsort()), {}

    def step(self, actions: npt.NDArray[Any]) -> tuple[Any, ...]:
        """Step all; return what Gymnasium's environments do."""
        obs, rewards, terminations, truncations, infos = self._envs.step(actions.reshape(-1, self.agents))
        order = infos["env_id"].argsort()  # worlds may come back in any
        results = (array[order].repeat(self.agents) for array in (rewards, terminations, truncations))
        return self._observations(obs, order), *results, {}

    def _observations(self, obs: Any, order: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        views = obs["agents_view"][order].astype(np.float32)
        number = np.broadcast_to(
            np.eye(self.agents, dtype=np.float32), (len(views), self.agents, self.agents)
        )
        return np.concatenate((views, number), 2).reshape(len(views) * self.agents, -1)

    def close(self) -> None:
        """Close them."""
        self._envs.close()


def environments(env_id: str, n: int, seed: int) -> Any:
    """Return EnvPool's form of an environment of ours, of ``n`` agents."""
    if env_id == "LevelBasedForaging":
        return Foraging(n, seed)
    return envpool.make(NAMES.get(env_id, env_id), env_type="gymnasium", num_envs=n, seed=seed)
