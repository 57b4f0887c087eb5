"""Learning in worlds: teams and games whose agents share a world, learned with their presets."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pearl_marl.envs import get_spec
from pearl_marl.policies import trained
from pearl_marl.training.run import Training, evaluate, settings_for, train

from .section import Colour, Progress, Row, labelled, legend, panels, row_of, select, tidy

TITLE = "Learning in worlds"
TEXT = (
    "Agents that share a world, learned with the settings that `pearl train` has for them. A line is a "
    "training: the return of a world at each evaluation. Of ConnectFour it is that of the learner against "
    "a player who makes random moves: 1 is won, -1 lost. Of Overcooked it has the shaped rewards in it. A "
    "result is the saved policy's over fresh episodes, without shaped rewards. Seconds are of the whole "
    "training, with its evaluations. RobotWarehouse takes minutes, and is learned with one seed."
)
COLUMNS = {
    "part": "part",
    "task": "task",
    "algorithm": "algorithm",
    "n_agents": "agents",
    "seed": "seed",
    "value": "return",
    "wanted": "wanted",
    "reached": "reached",
    "agent_steps": "agent-steps",
    "seconds": "s of training",
    "counts": "what is wanted",
}
SEEDS = (0, 1, 2)
FRESH, EPISODES = 1000, 10_000
"""Seed of the episodes by which a trained policy is judged, and of how many agents."""
QUICK_ITERATIONS, QUICK_EPISODES = 2, 100


class WorldTask(NamedTuple):
    """What is learned, and which mean return of an agent in an evaluation ends a training."""

    name: str
    env_id: str
    algorithm: str
    aim: float | None
    wanted: float | None
    counts: str
    options: Mapping[str, Any] = {}
    judged_by: Mapping[str, Any] = {}
    """Options of the episodes that count, where they differ."""
    settings: Mapping[str, Any] = {}
    """What its preset leaves open."""
    seeds: Sequence[int] = SEEDS


COOP = {"max_num_food": 2, "force_coop": True}

TASKS = (
    WorldTask("Foraging-8x8-2p-3f", "LevelBasedForaging", "ippo", None, 0.95, "1 is the most"),
    WorldTask(
        "Foraging-8x8-2p-2f-coop",
        "LevelBasedForaging",
        "ippo",
        0.496,
        0.98,
        "1 is the most",
        COOP,
    ),
    WorldTask("Foraging-8x8-2p-3f", "LevelBasedForaging", "mappo", None, 0.95, "1 is the most"),
    WorldTask("Foraging-8x8-2p-2f-coop", "LevelBasedForaging", "mappo", 0.496, 0.98, "1 is the most", COOP),
    WorldTask(
        "Overcooked, cramped_room",
        "Overcooked",
        "ippo",
        None,
        400.0,
        "ten soups; each pays 20 to both cooks",
        {"reward_shaping_factor": 1.0},
        {"reward_shaping_factor": 0.0},
    ),
    WorldTask(
        "RobotWarehouse, tiny, 2 robots",
        "RobotWarehouse",
        "ippo",
        None,
        21.2,
        "1 a shelf that was asked for",
        seeds=SEEDS[:1],
    ),
    WorldTask(
        "CoinGame, each for itself",
        "CoinGame",
        "ippo",
        None,
        None,
        "a coin brings 1; of the other's colour it costs the other 2",
        settings={"rewards": "own"},
    ),
    WorldTask(
        "CoinGame, from the sum",
        "CoinGame",
        "ippo",
        None,
        70.0,
        "both leave most of the other's coins alone",
        settings={"rewards": "sum"},
    ),
    WorldTask("ConnectFour", "ConnectFour", "self-play", None, 0.9, "95 % of games won and the others lost"),
)


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Train and judge; with ``quick`` a little: one task an environment and algorithm, and one seed."""
    tasks = {(task.env_id, task.algorithm): task for task in reversed(TASKS)}.values() if quick else TASKS
    work = [(task, seed) for task in tasks for seed in (task.seeds[:1] if quick else task.seeds)]
    return [
        row for task, seed in progress(work, len(work), "training") for row in _trained(task, seed, quick)
    ]


def _trained(task: WorldTask, seed: int, quick: bool) -> list[Row]:
    """Return a row for each evaluation of a training, and one of its result."""
    spec = get_spec(task.env_id).with_options(**task.options)
    given = {"seed": seed, **task.settings, **({"iterations": QUICK_ITERATIONS} if quick else {})}
    settings = settings_for(task.algorithm, task.env_id, given, agents=spec.agents)
    with tempfile.TemporaryDirectory() as folder:
        training = Training(task.env_id, task.algorithm, settings, dict(task.options), goal=task.aim)
        metrics = train(training, Path(folder))
        policy = trained.load(Path(folder))
    # Of a game that somebody wins, what the others get says nothing.
    share = 1 if spec.turns else spec.agents
    judged = spec.with_options(**task.judged_by) if task.judged_by else spec
    n = (QUICK_EPISODES if quick else EPISODES) // spec.agents * spec.agents
    value = evaluate(policy, judged, n, FRESH)["eval_return"] * share
    same = {"task": task.name, "algorithm": task.algorithm, "n_agents": settings.n_agents, "seed": seed}
    curve = [
        row_of(
            "measured",
            task.counts,
            part="curve",
            **same,
            value=row["eval_return"] * share,
            agent_steps=row["agent_steps"],
            seconds=row["seconds"],
        )
        for row in metrics
    ]
    result = row_of(
        "measured",
        task.counts,
        part="result",
        **same,
        value=value,
        wanted=task.wanted,
        reached=None if task.wanted is None else value >= task.wanted,
        agent_steps=metrics[-1]["agent_steps"],
        seconds=metrics[-1]["seconds"],
    )
    return [result, *curve]


def draw(rows: list[Row]) -> Any:
    """Draw a panel a task: the return at each evaluation, a line a seed, and what is wanted."""
    tasks = list(dict.fromkeys((row["task"], row["algorithm"]) for row in rows))
    figure, grid = panels([f"{task}\n{algorithm}" for task, algorithm in tasks], 0.6, 2.3)
    for (task, algorithm), (name, axes) in zip(tasks, grid.items(), strict=True):
        these = select(rows, task=task, algorithm=algorithm)
        results = select(these, part="result")
        colours = (Colour.BLUE, Colour.SKY, Colour.GREEN)[: len(results)]
        for colour, result in zip(colours, results, strict=True):
            curve = select(these, part="curve", seed=result["seed"])
            axes.plot(
                [row["agent_steps"] / 1e6 for row in curve],
                [row["value"] for row in curve],
                color=colour,
                marker=".",
                label=f"seed {result['seed']}",
            )
        if results[0]["wanted"] is not None:
            axes.axhline(results[0]["wanted"], color=Colour.ORANGE, linestyle="--", label="wanted")
        axes.set_title(name, fontsize=8)
        axes.set_xlabel("million agent-steps", fontsize=8)
        axes.tick_params(labelsize=8)
    tidy(*grid.values())
    figure.supylabel("return of a world", fontsize=10)
    legend(figure, labelled(next(iter(grid.values()))), 4)
    return figure
