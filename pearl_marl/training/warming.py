"""Compiling the trainers' loops before they are needed."""

from __future__ import annotations

from typing import Any

from pearl_marl.devices.warming import compiled_by
from pearl_marl.envs import get_spec
from pearl_marl.training.run import ALGORITHMS, settings_for

RUNS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    # Small minibatches are learned in one loop, and large ones each by itself.
    *(("ppo", env_id, {"minibatch": size}) for env_id in ("CartPole", "Pendulum") for size in (64, 4096)),
    ("ppo", "Breakout", {}),
    ("ppo", "CartPole", {"memory": "gru"}),
    ("pqn", "CartPole", {}),
    ("dqn", "CartPole", {"warm_up": 0}),
)
"""Algorithm, environment and settings by which every loop is called with every type that it knows."""


def warm_training() -> int:
    """Run every compiled loop once, so that the cache has it; return how many functions were compiled."""
    return compiled_by(_learn_a_little)


def _learn_a_little() -> None:
    for algorithm, env_id, changes in RUNS:
        settings = settings_for(algorithm, env_id, {"n_agents": 2, **changes})
        ALGORITHMS[algorithm](get_spec(env_id), "native", settings).iterate()
