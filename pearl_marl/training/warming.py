"""Compiling the trainers' loops before they are needed."""

from __future__ import annotations

import contextlib
import io
from typing import Any

from numba.core import event

from pearl_marl.registry import get_spec
from pearl_marl.training.run import ALGORITHMS, settings_for

RUNS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("ppo", "CartPole", {}),
    ("ppo", "Pendulum", {}),
    ("dqn", "CartPole", {"warm_up": 0}),
)
"""Algorithm, environment and settings by which every loop is called with every type that it knows."""


def warm_training() -> int:
    """Run every compiled loop once, so that the cache has it; return how many functions were compiled."""
    with event.install_recorder("numba:compile") as compiled, contextlib.redirect_stderr(io.StringIO()):
        for algorithm, env_id, given in RUNS:
            few: dict[str, Any] = {"n_agents": 2, **given}
            ALGORITHMS[algorithm](get_spec(env_id), "native", settings_for(algorithm, env_id, few)).iterate()
    return sum(moment.is_start for _, moment in compiled.buffer)
