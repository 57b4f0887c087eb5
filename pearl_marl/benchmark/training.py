"""Whole trainings beside those of other packages: for each seed and task every trainer in turn.

Each training is a process of its own. A machine that slows down or speeds up does so for all trainers.
"""

from __future__ import annotations

import importlib.util
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from pearl_marl.envs import get_spec
from pearl_marl.spec import EnvSpec
from pearl_marl.training.run import settings_for

SEEDS = (0, 1, 2)

OURS = "PEARL-MARL"
SB3 = "SB3"
CLEANRL = "CleanRL's PPO"
PUREJAXRL = "PureJaxRL's PPO on gymnax"
PUREJAXQL = "PureJaxQL's PQN on gymnax"
BENCHMARL = "BenchMARL on our worlds"
PUFFERLIB = "PufferLib"


class TrainingTask(NamedTuple):
    """What is learned: environment, algorithm and goal, with the settings of our preset.

    A training ends at the first evaluation that reaches the goal, but not before ``least`` iterations, by
    which the rate is measured; in any case at the end of the preset's iterations, and after ``seconds`` of
    training. Without a goal it ends after ``least`` iterations. An iteration is an update of PPO or PQN, or a
    step of DQN with its updates.

    A task with ``brief_seconds`` takes minutes to its goal. It has that only where its environment is asked
    for; among all tasks its rate is measured, of four iterations or so many seconds, and with 0 it is not
    among them.
    """

    name: str
    algorithm: str
    env_id: str
    goal: float | None
    least: int
    every: int = 1  # iterations between evaluations
    seconds: float = 40.0
    options: tuple[tuple[str, Any], ...] = ()  # of the environment, where they are not its defaults
    brief_seconds: float | None = None

    @property
    def spec(self) -> EnvSpec:
        """The environment."""
        return get_spec(self.env_id).with_options(**dict(self.options))

    def settings(self, seed: int) -> Any:
        """Return the settings of our preset."""
        return settings_for(self.algorithm, self.env_id, {"seed": seed}, agents=self.spec.agents)

    def shorter(self) -> TrainingTask:
        """Return the same task with a few iterations and no goal."""
        return self._replace(goal=None, least=2 * self.every)

    def among_all(self) -> TrainingTask | None:
        """Return the task as it is among those of all environments, or None if it is not."""
        if self.brief_seconds is None:
            return self
        brief = self._replace(goal=None, least=4, every=1, seconds=self.brief_seconds)
        return brief if self.brief_seconds else None


COOP = (("max_num_food", 2), ("force_coop", True))


def picture_tasks(env_id: str, goal: float, seconds: float, brief_seconds: float) -> tuple[TrainingTask, ...]:
    """Return the tasks of a game of MinAtar, which PPO and PQN learn."""
    return tuple(
        TrainingTask(
            f"{algorithm.upper()} {env_id}",
            algorithm,
            env_id,
            goal,
            least=20,
            every=5,
            seconds=seconds,
            brief_seconds=brief_seconds,
        )
        for algorithm in ("ppo", "pqn")
    )


TASKS = (
    TrainingTask("PPO CartPole", "ppo", "CartPole", 475.0, least=60),
    TrainingTask("PPO MountainCar", "ppo", "MountainCar", -115.0, least=10),
    TrainingTask("PPO FrozenLake", "ppo", "FrozenLake", 0.70, least=10),
    *picture_tasks("Seaquest", 20.4, seconds=240.0, brief_seconds=20.0),
    TrainingTask("PPO foraging", "ppo", "LevelBasedForaging", 0.49, least=12, every=4),
    *picture_tasks("Asterix", 16.7, seconds=150.0, brief_seconds=0.0),
    *picture_tasks("Breakout", 10.3, seconds=90.0, brief_seconds=0.0),
    *picture_tasks("Freeway", 20.0, seconds=120.0, brief_seconds=0.0),
    *picture_tasks("SpaceInvaders", 45.1, seconds=150.0, brief_seconds=0.0),
    TrainingTask("PQN CartPole", "pqn", "CartPole", 475.0, least=60),
    TrainingTask("PQN MountainCar", "pqn", "MountainCar", -115.0, least=10),
    TrainingTask("DQN CartPole", "dqn", "CartPole", 475.0, least=200, every=20),
    TrainingTask(
        "DQN Breakout", "dqn", "Breakout", 10.3, least=600, every=300, seconds=200.0, brief_seconds=0.0
    ),
    TrainingTask("IPPO foraging", "ppo", "LevelBasedForaging", 0.49, least=12, every=4, options=COOP),
    TrainingTask("MAPPO foraging", "mappo", "LevelBasedForaging", 0.49, least=12, every=4, options=COOP),
    TrainingTask("VDN foraging", "vdn", "LevelBasedForaging", 0.49, least=12, every=4, options=COOP),
    TrainingTask("QMIX foraging", "qmix", "LevelBasedForaging", 0.49, least=12, every=4, options=COOP),
    TrainingTask("IPPO RobotWarehouse", "ppo", "RobotWarehouse", 0.1, least=3),
    TrainingTask("MAPPO RobotWarehouse", "mappo", "RobotWarehouse", 0.1, least=3),
    TrainingTask("VDN RobotWarehouse", "vdn", "RobotWarehouse", 0.1, least=3, every=3),
    TrainingTask("QMIX RobotWarehouse", "qmix", "RobotWarehouse", 0.1, least=3, every=3),
)
"""In foraging, each agent gets half of a world's 1 at most. In RobotWarehouse, a robot that acts at random
delivers 0.017 shelves an episode; the goal is six times that, by our curves what all four algorithms reach in
40 seconds. The goals of MinAtar's games are what MinAtar's own DQN reached in 5 million frames; that of
Freeway is more, in episodes that evaluations end after 1,000 steps.
"""

STEPPED_BY = {
    **dict.fromkeys(("Breakout", "Seaquest"), "MinAtar itself, in Python: EnvPool's games are Atari's"),
    "LevelBasedForaging": "our native device: EnvPool's foraging has Jumanji's rules",
}
"""What steps an environment for SB3 and CleanRL instead of EnvPool."""
SLOW_IN_PYTHON = ("Asterix", "Freeway", "SpaceInvaders")
"""Games of MinAtar whose trainings with MinAtar's own environments would take most of an hour."""


class TrainerModule(NamedTuple):
    """A trainer: a module of ``trainers/`` with ``train(task, settings, watch)``, and what it needs."""

    name: str
    module: str | None
    tasks: str | tuple[str, ...]  # what the names of its tasks begin with
    packages: tuple[str, ...]
    library: str | None = None  # that has to be among the environment's peers
    problem: str | None = None  # why it cannot be run at all

    def missing(self, task: TrainingTask) -> str | None:
        """Return why it cannot run here, or None if it can."""
        if self.problem is not None:
            return self.problem
        if self.library is not None and self.library not in task.spec.peers:
            return f"{self.library} has no {task.env_id}"
        if "envpool" in self.packages and task.env_id in SLOW_IN_PYTHON:
            return "MinAtar's own environments, in Python, are timed in Breakout and Seaquest only"
        absent = [package for package in self.packages if importlib.util.find_spec(package) is None]
        if absent:
            return f"{', '.join(absent)} not installed: make bench-peers, or pip install '.[peers]'"
        return None

    def counts(self, task: TrainingTask) -> str:
        """Return what its figures include."""
        text = "rollout and learning; evaluations, imports and compilation not counted"
        if "envpool" in self.packages:
            return f"{text}; stepped by {STEPPED_BY.get(task.env_id, 'EnvPool')}"
        return text


TRAINERS = (
    TrainerModule(OURS, "ours", "", ("torch",)),
    TrainerModule(SB3, "sb3", ("PPO", "DQN"), ("stable_baselines3", "sb3_contrib", "envpool")),
    TrainerModule(CLEANRL, "cleanrl", "PPO", ("torch", "envpool")),
    TrainerModule(PUREJAXRL, "purejaxrl", "PPO", ("jax", "gymnax", "optax"), "gymnax"),
    TrainerModule(PUREJAXQL, "purejaxql", "PQN", ("jax", "gymnax", "optax"), "gymnax"),
    TrainerModule(BENCHMARL, "benchmarl", ("IPPO", "MAPPO", "VDN", "QMIX"), ("benchmarl",)),
    TrainerModule(
        PUFFERLIB,
        None,
        "PPO CartPole",
        (),
        problem="no trainer of it is here: PufferLib 3.0.0 does not install from PyPI alone; its build "
        "downloads raylib from elsewhere, which failed where this was written",
    ),
)

Row = dict[str, Any]
"""``task``, ``contender``, ``seed``, ``what_counts``; and either ``agent_steps_per_second``,
``seconds_to_goal`` and ``agent_steps_to_goal`` (None if the goal was not reached), ``wall`` and what else the
process reported; or ``missing``, the reason why there are no figures."""

Job = tuple[TrainingTask, TrainerModule, int]
"""A training: its task, its trainer, and its seed."""


def tasks_of(env_id: str | None, quick: bool) -> tuple[TrainingTask, ...]:
    """Return the tasks of an environment, or of all; with ``quick`` a few iterations of each."""
    chosen: Iterable[TrainingTask] = (task for task in TASKS if task.env_id == env_id)
    if env_id is None:
        chosen = filter(None, (task.among_all() for task in TASKS))
    return tuple(task.shorter() if quick else task for task in chosen)


def jobs(tasks: Sequence[TrainingTask], quick: bool) -> list[Job]:
    """Return all trainings in the order in which they are run; with ``quick`` of one seed."""
    return [
        (task, trainer, seed)
        for seed in (SEEDS[:1] if quick else SEEDS)
        for task in tasks
        for trainer in TRAINERS
        if task.name.startswith(trainer.tasks)
    ]


def run(work: Sequence[Job]) -> Iterator[Row]:
    """Run trainings; yield a row for each."""
    for task, trainer, seed in work:
        row: Row = {"task": task.name, "contender": trainer.name, "seed": seed}
        row["what_counts"] = trainer.counts(task)
        missing = trainer.missing(task)
        yield {**row, "missing": missing} if missing else {**row, **_train(task, trainer, seed)}


def _train(task: TrainingTask, trainer: TrainerModule, seed: int) -> Row:
    arguments = json.dumps({"module": trainer.module, "task": task._asdict(), "seed": seed})
    command = [sys.executable, "-m", f"{__package__}.trainers", arguments]
    began = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True)
    wall = time.perf_counter() - began
    if done.returncode:
        *_, last = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        return {"missing": f"it failed: {last}"}
    figures: Row = json.loads(done.stdout.splitlines()[-1])
    return {**figures, "wall": wall}


def compared(rows: Sequence[Row]) -> list[Row]:
    """Return a row for each task and trainer, of all seeds, with how it compares with ours.

    ``rate_ratio`` and ``time_ratio`` are how many times as fast, and how many times sooner at the goal, ours
    was: the median over seeds, with the least and the most. Seeds that did not reach the goal are left out.
    """
    runs: dict[tuple[str, str], dict[int, Row]] = {}
    for row in rows:
        runs.setdefault((row["task"], row["contender"]), {})[row["seed"]] = row
    found = []
    for (task, contender), by_seed in runs.items():
        measured = [row for row in by_seed.values() if "missing" not in row]
        first = next(iter(by_seed.values()))
        summary: Row = {"task": task, "contender": contender, "what_counts": first["what_counts"]}
        if not measured:
            found.append({**summary, "missing": first["missing"]})
            continue
        ours = {seed: row for seed, row in runs.get((task, OURS), {}).items() if "missing" not in row}
        both = [(ours[row["seed"]], row) for row in measured if row["seed"] in ours]
        rate, to_goal, steps = "agent_steps_per_second", "seconds_to_goal", "agent_steps_to_goal"
        reached = [row for row in measured if row[to_goal] is not None]
        times = [(mine[to_goal], row[to_goal]) for mine, row in both if row in reached]
        summary |= {
            "seeds": len(measured),
            "reached": len(reached),
            rate: statistics.median(row[rate] for row in measured),
            **{
                key: statistics.median(row[key] for row in reached) if reached else None
                for key in (to_goal, steps)
            },
            "rate_ratio": _spread([mine[rate] / row[rate] for mine, row in both]),
            "time_ratio": _spread([theirs / own for own, theirs in times if own is not None]),
        }
        found.append(summary)
    return found


def _spread(ratios: list[float]) -> list[float] | None:
    """Return median, least and most."""
    return [statistics.median(ratios), min(ratios), max(ratios)] if ratios else None
