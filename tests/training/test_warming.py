"""The trainers' loops, compiled ahead."""

from __future__ import annotations

from typing import Any

import pytest
from numba.core import event

from pearl_marl.envs import get_spec
from pearl_marl.training.run import ALGORITHMS, settings_for
from pearl_marl.training.warming import warm_training


@pytest.mark.parametrize(
    ("algorithm", "env_id", "given"),
    [
        ("ppo", "CartPole", {"rollout_length": 2}),
        ("ppo", "Pendulum", {"rollout_length": 2}),
        ("ppo", "Pendulum", {"rollout_length": 2, "minibatch": 64}),
        ("ppo", "LevelBasedForaging", {"rollout_length": 2}),
        ("mappo", "LevelBasedForaging", {"rollout_length": 2}),
        ("ppo", "LevelBasedForaging", {"rollout_length": 2, "memory": "gru", "chunk_length": 1}),
        ("pqn", "Blackjack", {"rollout_length": 2}),
        ("dqn", "Blackjack", {"warm_up": 0}),
        ("ppo", "Seaquest", {}),
    ],
)
def test_what_is_warm_is_not_compiled_again(algorithm: str, env_id: str, given: dict[str, Any]) -> None:
    warm_training()
    assert warm_training() == 0
    settings = settings_for(algorithm, env_id, {"n_agents": 4, **given})
    trainer = ALGORITHMS[algorithm](get_spec(env_id), "native", settings)
    with event.install_recorder("numba:compile") as compiled:
        trainer.iterate()
    loops = {moment.data["dispatcher"].__module__ for _, moment in compiled.buffer}
    assert not [name for name in loops if "dense" in name or "adam" in name]
