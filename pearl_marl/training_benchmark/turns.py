"""All trainings, one after the other: of each seed and task everybody in turn, each in a process of its own.

A machine that slows down or speeds up does so for all of them.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

from .contenders import CONTENDERS, OURS, Contender
from .tasks import TASKS, Task

SEEDS = (0, 1, 2)

Row = dict[str, Any]
"""``task``, ``contender``, ``seed``, ``what_counts``; and either ``agent_steps_per_second``,
``seconds_to_goal`` (None if the goal was not reached), ``wall`` and what else the process said; or
``missing``, the reason why there is nothing."""


def tasks_of(env_id: str | None, quick: bool) -> tuple[Task, ...]:
    """Return the tasks of an environment, or all; with ``quick`` a few iterations of each."""
    chosen = (task for task in TASKS if env_id in (None, task.env_id))
    return tuple(task.shorter() if quick else task for task in chosen)


def entries(tasks: Sequence[Task], seeds: Sequence[int]) -> list[tuple[Task, Contender, int]]:
    """Return all trainings, in the order in which they are run."""
    return [
        (task, contender, seed)
        for seed in seeds
        for task in tasks
        for contender in CONTENDERS
        if task.name.startswith(contender.tasks)
    ]


def run(work: Sequence[tuple[Task, Contender, int]]) -> Iterator[Row]:
    """Run trainings; yield a row of each."""
    for task, contender, seed in work:
        row: Row = {"task": task.name, "contender": contender.name, "seed": seed}
        row["what_counts"] = contender.counts(task)
        missing = contender.missing(task)
        yield {**row, "missing": missing} if missing else {**row, **_train(task, contender, seed)}


def _train(task: Task, contender: Contender, seed: int) -> Row:
    given = json.dumps({"module": contender.module, "task": task._asdict(), "seed": seed})
    command = [sys.executable, "-m", f"{__package__}.child", given]
    began = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True)
    wall = time.perf_counter() - began
    if done.returncode:
        *_, last = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        return {"missing": f"it failed: {last}"}
    figures: Row = json.loads(done.stdout.splitlines()[-1])
    return {**figures, "wall": wall}


def compared(rows: Sequence[Row]) -> list[Row]:
    """Return a row for each task and contender, of all seeds, with how it compares with ours.

    ``rate_ratio`` and ``time_ratio`` are how many times as fast, and how many times sooner at the goal, ours
    was: the median over seeds, with the least and the most. Seeds that did not reach the goal are left out.
    """
    found = []
    for task, contender in dict.fromkeys((row["task"], row["contender"]) for row in rows):
        own = {row["seed"]: row for row in rows if (row["task"], row["contender"]) == (task, contender)}
        first = next(iter(own.values()))
        summary: Row = {"task": task, "contender": contender, "what_counts": first["what_counts"]}
        own = {seed: row for seed, row in own.items() if "missing" not in row}
        if not own:
            found.append({**summary, "missing": first["missing"]})
            continue
        ours = {
            row["seed"]: row
            for row in rows
            if (row["task"], row["contender"]) == (task, OURS) and "missing" not in row
        }
        both = [(ours[seed], row) for seed, row in own.items() if seed in ours]
        reached = [row["seconds_to_goal"] for row in own.values() if row["seconds_to_goal"] is not None]
        rates = [mine["agent_steps_per_second"] / row["agent_steps_per_second"] for mine, row in both]
        times = [
            row["seconds_to_goal"] / mine["seconds_to_goal"]
            for mine, row in both
            if row["seconds_to_goal"] is not None and mine["seconds_to_goal"] is not None
        ]
        summary |= {
            "seeds": len(own),
            "reached": len(reached),
            "agent_steps_per_second": statistics.median(
                row["agent_steps_per_second"] for row in own.values()
            ),
            "seconds_to_goal": statistics.median(reached) if reached else None,
            "rate_ratio": _spread(rates),
            "time_ratio": _spread(times),
        }
        found.append(summary)
    return found


def _spread(ratios: list[float]) -> list[float] | None:
    """Return median, least and most."""
    return [statistics.median(ratios), min(ratios), max(ratios)] if ratios else None
