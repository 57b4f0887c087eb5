"""One training in a process of its own. Its argument is JSON, and so is the last line that it prints."""

from __future__ import annotations

import importlib
import json
import sys
import time

from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.benchmark.watch import Watch


def main(text: str) -> None:
    """Train, and print the figures."""
    job = json.loads(text)
    task = TrainingTask(**job["task"])
    began = time.perf_counter()
    trainer = importlib.import_module(f".{job['module']}", __package__)
    watch = Watch(task)
    trainer.train(task, task.settings(job["seed"]), watch)
    seconds, agent_steps = watch.points[-1]
    figures = {
        "agent_steps_per_second": watch.rate,
        "seconds_to_goal": watch.reached,
        "agent_steps_to_goal": watch.reached_steps,
        "agent_steps": agent_steps,
        "training_seconds": seconds,
        "best_return": watch.best,
        "preparing_seconds": watch.started - began,
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main(sys.argv[1])
