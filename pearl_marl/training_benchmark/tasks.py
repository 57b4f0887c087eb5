"""What is learned: environment, algorithm, goal. Everybody is given the settings of our preset."""

from __future__ import annotations

from typing import Any, NamedTuple

from pearl_marl.registry import get_spec
from pearl_marl.training.run import settings_for


class Task(NamedTuple):
    """A training.

    It ends at the first evaluation that reaches the goal, but not before ``least`` iterations, by which the
    rate is measured; in any case at the end of the preset's iterations, and after ``seconds`` of training.
    Without a goal it ends after ``least`` iterations. An iteration is an update of PPO, or a step of DQN with
    its updates.
    """

    name: str
    algorithm: str
    env_id: str
    goal: float | None
    least: int
    every: int = 1  # iterations between evaluations
    seconds: float = 40.0

    def settings(self, seed: int) -> Any:
        """Return the settings of our preset."""
        agents = get_spec(self.env_id).agents
        return settings_for(self.algorithm, self.env_id, {"seed": seed}, agents=agents)

    def shorter(self) -> Task:
        """Return a few iterations of it, without a goal."""
        return self._replace(goal=None, least=2 * self.every)


TASKS = (
    Task("PPO CartPole", "ppo", "CartPole", 475.0, least=20),
    Task("PPO MountainCar", "ppo", "MountainCar", -115.0, least=10),
    Task("PPO FrozenLake", "ppo", "FrozenLake", 0.70, least=10),
    Task("PPO Seaquest", "ppo", "Seaquest", None, least=4, seconds=20.0),
    Task("PPO LevelBasedForaging", "ppo", "LevelBasedForaging", None, least=12),
    Task("DQN CartPole", "dqn", "CartPole", 475.0, least=200, every=20),
)
"""Seaquest takes minutes to its goal, and EnvPool's foraging has other rules: of these only the rate is
measured."""
