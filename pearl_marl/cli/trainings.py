"""``pearl bench --training``: whole trainings beside those of other packages, as tables."""

from __future__ import annotations

import datetime
import os
from pathlib import Path
from typing import Any

from rich import box
from rich.markup import escape

from pearl_marl.benchmark.machine import machine
from pearl_marl.benchmark.measure import duration, rate
from pearl_marl.cli import common
from pearl_marl.cli.common import console
from pearl_marl.errors import ArgumentError
from pearl_marl.registry import get_spec


def show(env_id: str | None, quick: bool, out: Path | None, as_json: bool) -> None:
    """Run the trainings of an environment, or all of them, and print their results."""
    try:
        from pearl_marl.training_benchmark import tasks, turns
    except ModuleNotFoundError as error:
        raise ArgumentError(
            f"training needs the Python package {error.name}: pip install '.[train]'"
        ) from None
    name = None if env_id is None else get_spec(env_id).name
    chosen = turns.tasks_of(name, quick)
    if not chosen:
        possible = ", ".join(dict.fromkeys(task.env_id for task in tasks.TASKS))
        raise ArgumentError(f"no training of {name} is compared; possible are {possible}")
    work = turns.entries(chosen, turns.SEEDS[:1] if quick else turns.SEEDS)
    file = f"trainings_{name or 'all'}.json"
    common.check_results(out, file)
    goals = {task.name: task.goal for task in chosen}
    rows: list[dict[str, Any]] = []
    threads = os.environ.get("OMP_NUM_THREADS", "as each chooses")
    result: dict[str, Any] = {"machine": machine(), "threads": threads, "quick": quick}
    result |= {"goals": goals, "rows": rows}
    for row in common.progress(turns.run(work), len(work), "trainings"):
        rows.append(row)
        result["date"] = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        result["compared"] = turns.compared(rows)
        if out is not None:  # a run that is ended leaves its results so far
            common.write_json(out, file, result)
    if common.delivered(result, as_json, out, file):
        return
    for task, goal in goals.items():
        _print(task, goal, [row for row in result["compared"] if row["task"] == task])
    facts = result["machine"]
    console.print(
        "Medians over seeds. x is how many times as fast ours is, and how many times sooner it reaches the "
        f"goal, with minimum and maximum. {facts['processor']}, {facts['cores']} cores.",
        style="dim",
    )


def _print(task: str, goal: float | None, summary: list[dict[str, Any]]) -> None:
    figures = ["agent-\nsteps/s", "x"]
    if goal is not None:
        figures += [f"to {goal:g}", "reached", "x"]
    grid = common.table(task, ["trainer"], figures, box=box.SIMPLE, padding=(0, 1, 0, 0))
    # Names are folded, between words, so that all fits into 80 columns.
    grid.columns[0].no_wrap, grid.columns[0].min_width = False, len("CleanRL's PPO")
    for row in summary:
        grid.add_row(row["contender"], *_cells(row)[: len(figures)])
    console.print(grid)
    for row in summary:
        if "missing" in row:
            console.print(f"{row['contender']}: {escape(row['missing'])}", style="dim")


def _cells(row: dict[str, Any]) -> list[str]:
    if "missing" in row:
        return ["-"] * 5
    seconds = row["seconds_to_goal"]
    return [
        rate(row["agent_steps_per_second"]),
        _ratio(row["rate_ratio"]),
        "-" if seconds is None else duration(seconds),
        f"{row['reached']} of {row['seeds']}",
        _ratio(row["time_ratio"]),
    ]


def _ratio(spread: list[float] | None) -> str:
    """Return a median with the least and the most."""
    if spread is None:
        return "-"
    median, least, most = (f"{value:.3g}" for value in spread)
    return median if least == most else f"{median} ({least}-{most})"
