"""Our own trainers."""

from __future__ import annotations

from typing import Any

from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.benchmark.watch import Watch
from pearl_marl.training.run import ALGORITHMS

FIRST = {"dqn": 11}
"""Iterations after which a trainer has run all of its code, the warm-up of DQN included; of others, 1."""


def train(task: TrainingTask, settings: Any, watch: Watch) -> None:
    """Train until the watch says that it is over."""
    make: Any = ALGORITHMS[task.algorithm]
    spec = task.spec
    # A first trainer, which is thrown away, compiles or loads all kernels.
    before = make(spec, "native", settings)
    while before.done < FIRST.get(task.algorithm, 1):
        before.iterate()
    trainer = make(spec, "native", settings)
    watch.start()
    while trainer.done < settings.iterations:
        trainer.iterate()
        if watch(trainer.agent_steps, trainer.policy.function):
            return
