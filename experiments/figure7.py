"""Figure 7: training time to a mean return on three environment libraries, and by our batched trainers."""

from __future__ import annotations

import importlib.util
import statistics
import time
from typing import Any, NamedTuple

import numpy as np
import torch

from pearl_marl.benchmark.watch import mean_return
from pearl_marl.envs import get_spec
from pearl_marl.training.run import ALGORITHMS, settings_for

from . import paper, sb3_training
from .sb3_training import EVALUATION_LIMIT
from .section import Colour, Progress, Row, legend, log_axis, panels, row_of, select, tidy

TITLE = "Figure 7: training time"
TEXT = (
    "Seconds of training until the best actions of 200 agents' episodes reach a mean return, evaluations not "
    "counted. Stable-Baselines3 trains with the same settings and seeds whether this package, EnvPool or "
    "Gymnasium steps its environments, so it needs as many steps, give or take luck, and what it saves is "
    "time for each: the share saved compares how long the first steps took, as many in all runs. Each is run "
    "three times, and of the stretch between two evaluations the shortest time counts: in the others is "
    "more of what else the machine does. The batched trainers are this package's own. All with one thread of "
    "PyTorch; EnvPool has threads of its own."
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
    "saved_range": "least and most of the seeds",
    "shorter_than_envpool": "times shorter than SB3 on EnvPool",
    "counts": "what is counted, or from where",
}
SEEDS = (0, 1, 2)
REPEATS = 3


class TimedTask(NamedTuple):
    """A training: what is learned by which algorithm, and when it ends."""

    name: str
    algorithm: str
    env_id: str
    goal: float
    n_agents: int
    every: int
    most: int


TASKS = (
    TimedTask("PPO CartPole", "ppo", "CartPole", 475.0, 256, 8192, 400_000),
    TimedTask("DQN CartPole", "dqn", "CartPole", 475.0, 512, 10_240, 600_000),
    TimedTask("DQN CliffWalking", "dqn", "CliffWalking", -13.0, 512, 10_240, 600_000),
)

QUICK_TASK = TASKS[0]._replace(every=4096, most=8192)
"""What a quick report trains: one rollout, with an evaluation in it."""

OURS, ENVPOOL, GYMNASIUM = "SB3 on PEARL-MARL", "SB3 on EnvPool", "SB3 on Gymnasium"
BATCHED, LARGE, ZOO = "our batched trainer", "our batched trainer, 4,096 agents", "SB3 on EnvPool, 8 agents"
SOURCES = {GYMNASIUM: "gymnasium", ENVPOOL: "envpool", OURS: "pearl"}
STYLES = {
    GYMNASIUM: (Colour.ORANGE, "-"),
    ENVPOOL: (Colour.RED, "-"),
    ZOO: (Colour.PINK, "--"),
    OURS: (Colour.BLUE, "-"),
    BATCHED: (Colour.GREEN, "-"),
    LARGE: (Colour.GREEN, ":"),
}

OWN_SETTINGS: dict[str, dict[str, dict[str, Any]]] = {
    BATCHED: {"ppo": {"n_agents": 256, "minibatch": 256, "iterations": 120}, "dqn": {}},
    LARGE: {
        "ppo": {"n_agents": 4096, "rollout_length": 8, "minibatch": 2048},
        "dqn": {"n_agents": 4096, "memory": 50},
    },
}
"""Of the batched trainers, beyond those of ``pearl train``."""

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
    """Train every task with every contender and seed, in turns."""
    tasks, seeds = ((QUICK_TASK,), SEEDS[:1]) if quick else (TASKS, SEEDS)
    envpool = importlib.util.find_spec("envpool") is not None
    work = [
        (task, contender, seed)
        for task in tasks
        for seed in seeds
        for contender in (*SOURCES, BATCHED, *(() if quick else (LARGE, ZOO)))
        if (envpool or contender not in (ENVPOOL, ZOO)) and (contender != ZOO or task.algorithm == "ppo")
    ]
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        repeats = 1 if quick else REPEATS
        turns = [job for _ in range(repeats) for job in work]
        done = [_train(*job) for job in progress(turns, len(turns), "training")]
        runs = [(job, undisturbed(done[i :: len(work)])) for i, job in enumerate(work)]
    finally:
        torch.set_num_threads(before)
    rows: list[Row] = []
    if not envpool:
        reason = "EnvPool is not installed: pip install '.[bench]'"
        rows.append(row_of("missing", reason, task="all", contender=ENVPOOL))
    for task in tasks:
        of_task = [run for (of, _, _), run in runs if of is task]
        rows += _summaries(task, of_task)
        for run in of_task:
            rows += _rows(task, run)
    return rows


class TimedRun(NamedTuple):
    """One training."""

    contender: str
    seed: int
    n_agents: int
    points: Points

    @property
    def seconds(self) -> float:
        """Of all of it."""
        return self.points[-1][0]


def undisturbed(runs: list[TimedRun]) -> TimedRun:
    """Return the run that was made several times, with the shortest time of each stretch.

    What it learns depends on its seed alone. Should the times not have gone through the same evaluations all
    the same, the shortest whole run counts.
    """
    ways = {tuple(point[1:] for point in run.points) for run in runs}
    if len(ways) > 1:
        return min(runs, key=lambda run: run.seconds)
    stretches = [np.diff([point[0] for point in run.points], prepend=0.0) for run in runs]
    seconds = np.cumsum(np.min(stretches, 0)).tolist()
    points = [(s, *point[1:]) for s, point in zip(seconds, runs[0].points, strict=True)]
    return runs[0]._replace(points=points)


def _train(task: TimedTask, contender: str, seed: int) -> TimedRun:
    if contender in (BATCHED, LARGE):
        return _batched(task, contender, seed, OWN_SETTINGS[contender][task.algorithm])
    n, settings, steps, every = task.n_agents, None, task.most, task.every
    if contender == ZOO:
        n, settings, steps, every = 8, ZOO_SETTINGS, ZOO_STEPS, ZOO_STEPS // 20
    _, points = sb3_training.train(
        SOURCES.get(contender, "envpool"),
        *(task.env_id, task.algorithm, n, steps, seed, task.goal, every, settings),
    )
    return TimedRun(contender, seed, n, points)


def _batched(task: TimedTask, contender: str, seed: int, own: dict[str, Any]) -> TimedRun:
    settings = settings_for(task.algorithm, task.env_id, {**own, "seed": seed})
    trainer = ALGORITHMS[task.algorithm](get_spec(task.env_id), "native", settings)
    points: Points = []
    seconds, evaluated = 0.0, 0
    while trainer.done < settings.iterations:
        began = time.perf_counter()
        trainer.iterate()
        seconds += time.perf_counter() - began
        if trainer.agent_steps - evaluated < task.every:
            continue
        evaluated = trainer.agent_steps
        mean = mean_return(trainer.spec, trainer.policy.choose, EVALUATION_LIMIT)
        points.append((seconds, evaluated, mean))
        if mean >= task.goal:
            break
    return TimedRun(contender, seed, settings.n_agents, points)


def _reached(task: TimedTask, run: TimedRun) -> bool:
    return run.points[-1][2] >= task.goal


def _rows(task: TimedTask, run: TimedRun) -> list[Row]:
    common: Row = {
        "kind": "measured",
        "task": task.name,
        "contender": run.contender,
        "seed": run.seed,
        "n_agents": run.n_agents,
    }
    names = ("seconds", "agent_steps", "eval_return")
    points = [dict(zip(names, point, strict=True)) for point in run.points]
    last = {"seconds": run.seconds, "agent_steps": run.points[-1][1]}
    whole = {**common, "what": "run", "reached": _reached(task, run), **last}
    return [whole, *({**common, "what": "evaluation", **point} for point in points)]


def _summaries(task: TimedTask, runs: list[TimedRun]) -> list[Row]:
    """Return a row for each contender, of all seeds; and the paper's."""
    shortest = min(run.points[-1][1] for run in runs if run.contender in SOURCES)
    rows: list[Row] = []
    medians: dict[str, float] = {}
    first: dict[str, dict[int, float]] = {}
    for contender in dict.fromkeys(run.contender for run in runs):
        own = [run for run in runs if run.contender == contender]
        count = sum(_reached(task, run) for run in own)
        row = row_of(
            "measured",
            f"to a mean return of {task.goal:g}, which {count} of {len(own)} seeds reached",
            task=task.name,
            contender=contender,
            what=f"median of {len(own)}",
            n_agents=own[0].n_agents,
            reached=count == len(own),
            seconds=statistics.median(run.seconds for run in own),
            agent_steps=int(statistics.median(run.points[-1][1] for run in own)),
        )
        if count == len(own):
            medians[contender] = row["seconds"]
        if contender in SOURCES:
            first[contender] = {run.seed: _seconds_of(run.points, shortest) for run in own}
            row["common_steps"] = shortest
            row["common_seconds"] = statistics.median(first[contender].values())
        rows.append(row)
    for row in rows:
        if row["contender"] == OURS:
            for name, rival in (("envpool", ENVPOOL), ("gymnasium", GYMNASIUM)):
                if rival in first:
                    saved = [1 - first[OURS][seed] / seconds for seed, seconds in first[rival].items()]
                    row[f"saved_over_{name}"] = statistics.median(saved)
                    if rival == ENVPOOL:
                        row["saved_range"] = f"{min(saved):.2f} to {max(saved):.2f} over EnvPool"
        # Against the fastest of EnvPool's that learns with every seed, whichever settings that has.
        rivals = [seconds for name, seconds in medians.items() if name in (ENVPOOL, ZOO)]
        if row["contender"] in (BATCHED, LARGE) and row["contender"] in medians and rivals:
            row["shorter_than_envpool"] = min(rivals) / row["seconds"]
    saved_there = paper.TRAINING_TIME_SAVED[task.name]
    quoted = row_of(
        "quoted",
        f"of the whole training time; {paper.TRAINING_TIME_SOURCE}",
        task=task.name,
        contender="the paper: SB3 on PEARL",
        saved_over_envpool=saved_there["EnvPool"],
        saved_over_gymnasium=saved_there["VectorEnv"],
    )
    return [*rows, quoted]


def _seconds_of(points: Points, steps: int) -> float:
    """Return how long the first steps took, between evaluations by their share."""
    seconds, agent_steps, _ = zip(*points, strict=True)
    return float(np.interp(steps, (0, *agent_steps), (0.0, *seconds)))


def draw(rows: list[Row]) -> Any:
    """Draw a panel a task: mean return over seconds of training, a line a run."""
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    figure, grid = panels(tasks, 0.0, 3.6)
    handles: dict[str, Any] = {}
    goals = {task.name: task.goal for task in TASKS}
    for task, axes in grid.items():
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
        if goals[task] < 0:  # with less than nothing on the axis, there is no room lost above
            axes.set(yscale="symlog", ylim=(None, goals[task] / 2))
    tidy(*grid.values())
    grid[tasks[0]].set(ylabel="mean return of 200 episodes")
    legend(figure, handles, 3)
    return figure
