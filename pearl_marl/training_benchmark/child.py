"""One training in a process of its own: ``python -m`` this module, with what to train as JSON.

The last line that it prints is what came of it.
"""

from __future__ import annotations

import importlib
import json
import sys
import time

from .tasks import Task
from .watch import Watch


def main(text: str) -> None:
    """Train, and print the figures."""
    given = json.loads(text)
    task = Task(**given["task"])
    began = time.perf_counter()
    trainer = importlib.import_module(f".{given['module']}", __package__)
    watch = Watch(task)
    settings = task.settings(given["seed"])
    trainer.train(task, settings, watch)
    spent = watch.points[-1]
    figures = {
        "agent_steps_per_second": watch.rate,
        "seconds_to_goal": watch.reached,
        "agent_steps": spent[1],
        "training_seconds": spent[0],
        "best_return": watch.best,
        "preparing_seconds": watch.started - began,
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main(sys.argv[1])
