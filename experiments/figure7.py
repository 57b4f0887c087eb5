"""Figure 7: training time to a mean return, whoever steps the environments; and of our batched trainers."""

from __future__ import annotations

import statistics
import time
from typing import Any, NamedTuple

import numpy as np
import torch

from pearl_marl.registry import get_spec
from pearl_marl.rendering import import_pyplot

from . import paper, sb3_training
from .section import BLUE, GREEN, ORANGE, PINK, RED, WIDTH, Progress, Row, log_axis, select
from .training import ALGORITHMS, settings_for

TITLE = "Figure 7: training time"
TEXT = (
    "Seconds of training until the best actions of 200 agents' episodes reach a mean return, evaluations not "
    "counted. Stable-Baselines3 trains with the same settings and seeds whether this package, EnvPool or "
    "Gymnasium steps its environments, so it needs as many steps, give or take luck, and what it saves is "
    "time for each: the share saved compares how long the first steps took, as many in all runs. The batched "
    "trainers are this package's own. All with one thread of PyTorch; EnvPool has threads of its own."
)
COLUMNS = {
    "task": "task",
    "contender": "contender",
    "what": "what",
    "seed": "seed",
    "n_agents": "agents",
    "reached": "reached",
    "seconds": "s",
    "agent_steps": "agent-steps",
    "common_steps": "first agent-steps",
    "common_seconds": "they took s",
    "saved_over_envpool": "share saved over EnvPool",
    "saved_over_gymnasium": "share saved over Gymnasium",
    "shorter_than_envpool": "times shorter than SB3 on EnvPool",
    "counts": "what is counted, or from where",
}
SEEDS = (0, 1, 2)


class Task(NamedTuple):
    """What is to be learned: by whom, until when."""

    name: str
    algorithm: str
    env_id: str
    goal: float
    n_agents: int
    every: int
    most: int


TASKS = (
    Task("PPO CartPole", "ppo", "CartPole", 475.0, 256, 8192, 400_000),
    Task("DQN CartPole", "dqn", "CartPole", 475.0, 512, 10_240, 600_000),
    Task("DQN CliffWalking", "dqn", "CliffWalking", -13.0, 512, 10_240, 600_000),
)

OURS, BATCHED, ZOO = "SB3 on PEARL-MARL", "our batched trainer", "SB3 on EnvPool, 8 agents"
SOURCES = {"SB3 on Gymnasium": "gymnasium", "SB3 on EnvPool": "envpool", OURS: "pearl"}
STYLES = {
    "SB3 on Gymnasium": (ORANGE, "-"),
    "SB3 on EnvPool": (RED, "-"),
    ZOO: (PINK, "--"),
    OURS: (BLUE, "-"),
    BATCHED: (GREEN, "-"),
}

ZOO_SETTINGS: dict[str, Any] = {
    "n_steps": 32,
    "batch_size": 256,
    "gae_lambda": 0.8,
    "gamma": 0.98,
    "n_epochs": 20,
    "learning_rate": lambda left: 1e-3 * left,
    "clip_range": lambda left: 0.2 * left,
}
"""What RL Baselines3 Zoo trains CartPole with, 8 agents and 100,000 steps."""
ZOO_STEPS = 100_000

Points = list[tuple[float, int, float]]
"""Seconds of training, agent-steps, mean return."""


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Train every task with everyone and every seed, in turns."""
    tasks, seeds = (TASKS[:1], SEEDS[:1]) if quick else (TASKS, SEEDS)
    work = [
        (task, contender, seed)
        for task in tasks
        for seed in seeds
        for contender in (*SOURCES, BATCHED, ZOO)
        if contender != ZOO or (task.algorithm == "ppo" and not quick)
    ]
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        runs = [(job, _train(*job)) for job in progress(work, len(work), "training")]
    finally:
        torch.set_num_threads(before)
    rows: list[Row] = []
    for task in tasks:
        of_task = [(contender, seed, points) for (t, contender, seed), points in runs if t is task]
        rows += _summaries(task, of_task)
        for contender, seed, points in of_task:
            rows += _run(task, contender, seed, points)
    return rows


def _train(task: Task, contender: str, seed: int) -> Points:
    if contender == BATCHED:
        return _batched(task, seed)
    n, settings, steps = task.n_agents, None, task.most
    if contender == ZOO:
        n, settings, steps = 8, ZOO_SETTINGS, ZOO_STEPS
    source = SOURCES.get(contender, "envpool")
    _, points = sb3_training.train(
        source, task.env_id, task.algorithm, n, steps, seed, task.goal, min(task.every, steps // 20), settings
    )
    return points


def _batched(task: Task, seed: int) -> Points:
    settings = settings_for(task.algorithm, task.env_id, {"seed": seed})
    trainer = ALGORITHMS[task.algorithm](get_spec(task.env_id), "native", settings)
    points: Points = []
    seconds, seen = 0.0, 0
    while trainer.done < settings.iterations:
        began = time.perf_counter()
        trainer.iterate()
        seconds += time.perf_counter() - began
        if trainer.agent_steps - seen < task.every:
            continue
        seen = trainer.agent_steps
        points.append((seconds, seen, sb3_training.mean_return(task.env_id, trainer.policy.choose)))
        if points[-1][2] >= task.goal:
            break
    return points


def _run(task: Task, contender: str, seed: int, points: Points) -> list[Row]:
    about = {"kind": "measured", "task": task.name, "contender": contender, "seed": seed}
    seconds, steps, mean = points[-1]
    evaluations = [
        {**about, "what": "evaluation", "seconds": s, "agent_steps": n, "eval_return": value}
        for s, n, value in points
    ]
    reached = mean >= task.goal
    return [
        {**about, "what": "run", "reached": reached, "seconds": seconds, "agent_steps": steps},
        *evaluations,
    ]


def _summaries(task: Task, runs: list[tuple[str, int, Points]]) -> list[Row]:
    """Return a row for each contender, of all seeds; and the paper's."""
    common = min(points[-1][1] for contender, _, points in runs if contender in SOURCES)
    rows: list[Row] = []
    for contender in dict.fromkeys(contender for contender, _, _ in runs):
        of_all = [points for other, _, points in runs if other == contender]
        row: Row = {
            "kind": "measured",
            "task": task.name,
            "contender": contender,
            "what": f"median of {len(of_all)}",
            "reached": all(points[-1][2] >= task.goal for points in of_all),
            "seconds": statistics.median(points[-1][0] for points in of_all),
            "agent_steps": int(statistics.median(points[-1][1] for points in of_all)),
            "counts": f"to a mean return of {task.goal:g}",
        }
        if contender in SOURCES:
            row["n_agents"], row["common_steps"] = task.n_agents, common
            row["common_seconds"] = statistics.median(_seconds_of(points, common) for points in of_all)
        rows.append(row)
    times = {row["contender"]: row for row in rows}
    for row in rows:
        if "common_seconds" in row:
            for name, other in (("envpool", "SB3 on EnvPool"), ("gymnasium", "SB3 on Gymnasium")):
                if row["contender"] == OURS:
                    saved = 1 - row["common_seconds"] / times[other]["common_seconds"]
                    row[f"saved_over_{name}"] = saved
    # Against the faster of EnvPool's, whichever settings that has.
    rival = min(row["seconds"] for name, row in times.items() if "EnvPool" in name)
    times[BATCHED]["shorter_than_envpool"] = rival / times[BATCHED]["seconds"]
    saved = paper.TRAINING_TIME_SAVED[task.name]
    rows.append(
        {
            "kind": "quoted",
            "task": task.name,
            "contender": "the paper: SB3 on PEARL",
            "saved_over_envpool": saved["EnvPool"],
            "saved_over_gymnasium": saved["VectorEnv"],
            "counts": paper.TRAINING_TIME_SOURCE,
        }
    )
    return rows


def _seconds_of(points: Points, steps: int) -> float:
    """Return how long the first steps took, between evaluations by their share."""
    seconds, agent_steps, _ = zip(*points, strict=True)
    return float(np.interp(steps, (0, *agent_steps), (0.0, *seconds)))


def draw(rows: list[Row]) -> Any:
    """Draw a panel a task: mean return over seconds of training, a line a run."""
    plt = import_pyplot()
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    figure, grid = plt.subplots(1, len(tasks), figsize=(WIDTH, 3.6), squeeze=False, layout="constrained")
    handles: dict[str, Any] = {}
    goals = {task.name: task.goal for task in TASKS}
    for axes, task in zip(grid.flat, tasks, strict=True):
        seconds = []
        for contender, (colour, style) in STYLES.items():
            for row in select(rows, task=task, contender=contender, what="run"):
                points = select(rows, task=task, contender=contender, seed=row["seed"], what="evaluation")
                x = [point["seconds"] for point in points]
                y = [point["eval_return"] for point in points]
                seconds += x
                (handles[contender],) = axes.plot(
                    x, y, color=colour, linestyle=style, linewidth=1, marker=".", markersize=3
                )
        axes.axhline(goals[task], color="grey", linestyle=":", linewidth=1)
        log_axis(axes, "x", seconds)
        axes.set(title=f"{task}, to {goals[task]:g}", xlabel="seconds of training (log scale)")
        if goals[task] < 0:
            axes.set(yscale="symlog")
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    grid[0, 0].set(ylabel="mean return of 200 episodes")
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=3, fontsize=8, frameon=False
    )
    return figure
