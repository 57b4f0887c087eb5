"""Who trains: this package and its peers, each a module beside this one; or why somebody cannot."""

from __future__ import annotations

import importlib.util
from typing import NamedTuple

from .tasks import Task

OURS = "PEARL-MARL"
SB3 = "SB3 on EnvPool"
CLEANRL = "CleanRL's PPO on EnvPool"
PUREJAXRL = "PureJaxRL's PPO on gymnax"
PUFFERLIB = "PufferLib"

ENVPOOL_COUNTS = {
    "Seaquest": "stepped by MinAtar itself, in Python: EnvPool's Seaquest is Atari's, another game",
    "LevelBasedForaging": "Jumanji's rules: two foods, 100 steps",
}
"""What EnvPool's form of an environment differs in from ours."""


class Contender(NamedTuple):
    """A trainer: a module with ``train(task, settings, watch)``, and the packages that it needs."""

    name: str
    module: str | None
    tasks: str  # what the names of its tasks begin with
    needs: tuple[str, ...]
    envs: tuple[str, ...] | None = None  # that it has; None for all
    problem: str | None = None  # why nobody can run it

    def missing(self, task: Task) -> str | None:
        """Return why it cannot run here, or None if it can."""
        if self.problem is not None:
            return self.problem
        if self.envs is not None and task.env_id not in self.envs:
            return f"gymnax has no {task.env_id}"
        absent = [package for package in self.needs if importlib.util.find_spec(package) is None]
        if absent:
            return f"{', '.join(absent)} not installed: make bench-peers, or pip install '.[peers]'"
        return None

    def counts(self, task: Task) -> str:
        """Return what a figure of it includes."""
        text = "rollout and learning; evaluations, imports and compilation not counted"
        if "envpool" in self.needs and task.env_id in ENVPOOL_COUNTS:
            return f"{text}; {ENVPOOL_COUNTS[task.env_id]}"
        return text


CONTENDERS = (
    Contender(OURS, "ours", "", ("torch",)),
    Contender(SB3, "sb3", "", ("stable_baselines3", "envpool")),
    Contender(CLEANRL, "cleanrl", "PPO", ("torch", "envpool")),
    Contender(
        PUREJAXRL,
        "purejaxrl",
        "PPO",
        ("jax", "gymnax", "optax"),
        ("CartPole", "MountainCar", "FrozenLake", "Seaquest"),
    ),
    Contender(
        PUFFERLIB,
        None,
        "PPO CartPole",
        (),
        problem="no trainer of it is here: PufferLib 3.0.0 does not install from PyPI alone; its build "
        "downloads raylib from elsewhere, which failed where this was written",
    ),
)
