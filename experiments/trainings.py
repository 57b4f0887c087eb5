"""Whole trainings beside those of other packages: agent-steps a second, and time to a goal."""

from __future__ import annotations

from typing import Any

from pearl_marl.benchmark.training import (
    BENCHMARL,
    CLEANRL,
    OURS,
    PUREJAXQL,
    PUREJAXRL,
    SB3,
    compared,
    jobs,
    run,
    tasks_of,
)

from .section import Colour, Progress, Row, bars, having, legend, panels, row_of, select, tidy

TITLE = "Whole trainings"
TEXT = (
    "Rollout and learning together, by this package and by others, each in a process of its own, in turns. "
    "All have the same numbers of agents, networks, minibatches and epochs, those of our presets, as far as "
    "a trainer has the knob. A goal is reached when the best actions of 200 agents' first episodes have that "
    "mean return; evaluations, imports and compilation are not counted. The others need an environment of "
    "their own, which `make bench-peers` makes."
)
COLUMNS = {
    "task": "task",
    "contender": "contender",
    "what": "what",
    "seed": "seed",
    "agent_steps_per_second": "agent-steps/s",
    "rate_ratio": "ours is so many times as fast",
    "rate_range": "least and most of the seeds",
    "seconds_to_goal": "s to the goal",
    "agent_steps_to_goal": "agent-steps to the goal",
    "time_ratio": "ours is so many times sooner",
    "time_range": "least and most of them",
    "reached": "seeds that reached it",
    "agent_steps": "agent-steps",
    "wall": "s of the process",
    "counts": "what is counted, or why there is nothing",
}
COLOURS = {
    OURS: Colour.GREEN,
    SB3: Colour.RED,
    CLEANRL: Colour.ORANGE,
    PUREJAXRL: Colour.BLUE,
    PUREJAXQL: Colour.SKY,
    BENCHMARL: Colour.PINK,
}
QUICK_ENV = "CartPole"
"""What a quick report trains, for a few iterations."""


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Train every task with everyone and every seed, in turns."""
    tasks = tasks_of(QUICK_ENV if quick else None, quick)
    work = jobs(tasks, quick)
    runs = list(progress(run(work), len(work), "training"))
    rows = [_summary(row) for row in compared(runs)]
    shown = ("task", "contender", "seed", "agent_steps_per_second")
    counted = ("seconds_to_goal", "agent_steps_to_goal", "agent_steps", "wall")
    return rows + [
        row_of("measured", row["what_counts"], what="run", **{key: row[key] for key in shown + counted})
        for row in runs
        if "missing" not in row
    ]


def _summary(row: Row) -> Row:
    who = {"task": row["task"], "contender": row["contender"]}
    if "missing" in row:
        return row_of("missing", row["missing"], **who)
    found = row_of(
        "measured",
        row["what_counts"],
        **who,
        what=f"median of {row['seeds']}",
        agent_steps_per_second=row["agent_steps_per_second"],
        seconds_to_goal=row["seconds_to_goal"],
        agent_steps_to_goal=row["agent_steps_to_goal"],
        reached=row["reached"],
    )
    for name in ("rate", "time"):
        if row[f"{name}_ratio"] is not None:
            median, least, most = row[f"{name}_ratio"]
            found |= {f"{name}_ratio": median, f"{name}_range": f"{least:.3g} to {most:.3g}"}
    return found


def draw(rows: list[Row]) -> Any:
    """Draw a panel a task: agent-steps a second, a bar a contender, and the time to the goal beside it."""
    medians = [row for row in having(rows, "agent_steps_per_second") if row["what"] != "run"]
    tasks = list(dict.fromkeys(row["task"] for row in medians))
    figure, grid = panels(tasks, 0.6, 1.9)
    handles: dict[str, Any] = {}
    for task, axes in grid.items():
        for place, row in enumerate(reversed(select(medians, task=task))):
            colour, rate = COLOURS[row["contender"]], row["agent_steps_per_second"]
            bars(axes, [place], [rate], 0.7, color=colour)
            handles.setdefault(row["contender"], axes.patches[-1])
            if row["seconds_to_goal"] is not None:
                axes.text(0, place, f" {row['seconds_to_goal']:.3g} s", va="center", fontsize=7)
        axes.set(title=task, xlabel="agent-steps/s", yticks=[])
        axes.tick_params(labelsize=7)
        axes.margins(x=0.3)
    tidy(*grid.values())
    legend(figure, {name: handles[name] for name in COLOURS if name in handles}, 4)
    return figure
