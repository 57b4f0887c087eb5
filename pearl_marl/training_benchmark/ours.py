"""Our own trainers."""

from __future__ import annotations

from typing import Any

from pearl_marl.registry import get_spec
from pearl_marl.training.run import ALGORITHMS

from .tasks import Task
from .watch import Watch


def train(task: Task, settings: Any, watch: Watch) -> None:
    """Train until the watch says that it is over."""
    trainer = ALGORITHMS[task.algorithm](get_spec(task.env_id), "native", settings)
    watch.start()
    while trainer.done < settings.iterations:
        trainer.iterate()
        if watch(trainer.agent_steps, trainer.policy.choose):
            return
