"""Whole trainings beside those of other packages: the clock, the comparison, and that everybody learns."""

from __future__ import annotations

import dataclasses
import importlib
import json
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Discrete

from pearl_marl import parallel_env
from pearl_marl.benchmark import training, watch
from pearl_marl.benchmark.training import OURS, TASKS, TRAINERS, TrainerModule, TrainingTask
from pearl_marl.benchmark.watch import Watch
from pearl_marl.spec import EnvSpec

from .. import sampling

Pearl = Callable[..., tuple[int, str, str]]
NEEDS = {trainer.module: trainer.packages for trainer in TRAINERS if trainer.module is not None}
TEAM_TRAINER = next(trainer for trainer in TRAINERS if trainer.module == "benchmarl")
SINGLE_TASKS = [task for task in TASKS if task.name.startswith(("PPO ", "PQN "))]
POLES = [task for task in SINGLE_TASKS if task.env_id == "CartPole"]
SINGLE = [
    (trainer.module, task)
    for trainer in TRAINERS
    for task in SINGLE_TASKS
    if trainer.module is not None and task.name.startswith(trainer.tasks)
]
ON_POLES = [(module, task) for module, task in SINGLE if task in POLES]
IN_WORLDS = [(module, task) for module, task in SINGLE if task.spec.agents > 1]
DQN_TASKS = [task for task in TASKS if task.algorithm == "dqn"]
TEAM_TASKS = [task for task in TASKS if task.name.startswith(TEAM_TRAINER.tasks)]
EASY = TrainingTask("PPO CartPole", "ppo", "CartPole", 475.0, least=1)


def sampled_pairs(pairs: list[Any], always: list[Any]) -> list[Any]:
    """Return trainers with tasks as parameters that have short names."""
    return [
        pytest.param(
            *pair, marks=() if pair in always else pytest.mark.exhaustive, id=f"{pair[0]}-{pair[1].name}"
        )
        for pair in (pairs if sampling.exhaustive else always)
    ]


def trainer(module: str) -> Any:
    for package in NEEDS[module]:
        pytest.importorskip(package)
    return importlib.import_module(f"pearl_marl.benchmark.trainers.{module}")


class Clock:
    """A clock that is set by hand."""

    now = 0.0

    def perf_counter(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(watch, "time", made)
    return made


def watched(monkeypatch: pytest.MonkeyPatch, clock: Clock, task: TrainingTask, returns: list[float]) -> Watch:
    """Return a watch after a training whose iterations of 10 steps take a second, and evaluations five."""
    coming = iter(returns)

    def mean_return(spec: EnvSpec, choose: Any) -> float:
        clock.now += 5
        return next(coming)

    monkeypatch.setattr(watch, "mean_return", mean_return)
    made = Watch(task)
    clock.now = 100
    made.start()
    for iteration in range(1, 1000):
        clock.now += 3 if iteration == 1 else 1  # caches are cold in the first
        if made(iteration * 10, lambda obs: obs):
            break
    return made


def test_evaluations_are_not_timed(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    made = watched(monkeypatch, clock, EASY._replace(every=2), [0, 475])
    assert made.points == [(4, 20), (6, 40)]
    assert (made.reached, made.reached_steps) == (6, 40)
    assert made.best == 475
    assert made.rate == 10, "of what came after the first point"


def test_the_rate_is_measured_for_longer_than_the_goal_takes(
    monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    made = watched(monkeypatch, clock, EASY._replace(least=5), [500])
    assert (made.reached, made.reached_steps) == (3, 10)
    assert made.points[-1] == (7, 50)


def test_a_goal_that_is_not_reached_ends_with_the_time(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    made = watched(monkeypatch, clock, EASY._replace(seconds=8.0), [0] * 10)
    assert (made.reached, made.reached_steps) == (None, None)
    assert made.points[-1] == (8, 60)


def test_without_a_goal_nobody_is_evaluated(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    made = watched(monkeypatch, clock, EASY._replace(goal=None, least=1), [])
    assert (made.points, made.reached, made.best) == ([(3, 10)], None, None)
    assert made.rate == pytest.approx(10 / 3), "the first iteration is all that there is"


@pytest.mark.parametrize(("module", "task"), sampled_pairs(SINGLE, ON_POLES + IN_WORLDS))
def test_a_few_iterations(module: str, task: TrainingTask) -> None:
    """Everybody takes our settings, and its policy's actions are ours."""
    entry = next(trainer for trainer in TRAINERS if trainer.module == module)
    made = trainer(module)
    if entry.missing(task) is not None:
        pytest.skip(str(entry.missing(task)))
    few = {"n_agents": 8, "rollout_length": 4, "minibatch": 16, "epochs": 2, "iterations": 5, "width": 8}
    settings = dataclasses.replace(task.settings(0), **few)
    noted = Looking(task._replace(goal=None, least=3, every=1))
    made.train(task, settings, noted)
    assert [steps for _, steps in noted.points] == [32, 64, 96]


def test_all_iterations_are_noted() -> None:
    """Stable-Baselines3 tells nobody that the last one is over."""
    made = trainer("sb3")
    settings = dataclasses.replace(EASY.settings(0), n_agents=4, rollout_length=4, minibatch=8, iterations=3)
    noted = Watch(EASY._replace(goal=None, least=9))
    made.train(EASY, settings, noted)
    assert [steps for _, steps in noted.points] == [16, 32, 48]


@pytest.mark.slow
@pytest.mark.parametrize(("module", "task"), sampled_pairs(ON_POLES, ON_POLES))
def test_everybody_balances_the_pole(module: str, task: TrainingTask) -> None:
    made, noted = trainer(module), Watch(task._replace(least=1, seconds=600.0))
    made.train(task, task.settings(0), noted)
    assert noted.reached is not None


@pytest.mark.parametrize("module", ["ours", "sb3"])
@pytest.mark.parametrize("task", DQN_TASKS, ids=lambda task: task.env_id)
def test_dqn(module: str, task: TrainingTask) -> None:
    few = {"n_agents": 8, "memory": 20, "warm_up": 2, "minibatch": 16, "iterations": 40, "width": 8}
    noted = Watch(task._replace(goal=None, least=20, every=10))
    trainer(module).train(task, dataclasses.replace(task.settings(0), **few), noted)
    assert [steps for _, steps in noted.points] == [80, 160]


@pytest.mark.parametrize("module", ["ours", "benchmarl"])
@pytest.mark.parametrize("task", TEAM_TASKS, ids=lambda task: task.name)
def test_teams(module: str, task: TrainingTask) -> None:
    """Everybody learns in our worlds, and its policy's actions are among those that are possible."""
    few = {"n_agents": 8, "rollout_length": 4, "minibatch": 16, "epochs": 2, "iterations": 5, "width": 8}
    noted = Looking(task._replace(goal=None, least=12, every=1))
    with warnings.catch_warnings():
        trainer(module).train(task, dataclasses.replace(task.settings(0), **few), noted)
    assert [steps for _, steps in noted.points] == [32, 64, 96, 128, 160]


class Looking(Watch):
    """A watch that has eight agents choose after every iteration. BenchMARL pickles it."""

    def __call__(self, agent_steps: int, choose: Callable[..., Any]) -> bool:
        spec = self.task.spec
        obs, space = np.zeros((8, *spec.observation_shape), spec.observation_dtype), spec.action_space
        assert isinstance(space, Discrete)
        if spec.golden.masks is None:
            actions = choose(obs)
            assert all(action in space for action in actions)
        else:
            masks = np.eye(space.n, dtype=np.int8)[np.arange(8) % space.n]
            actions = choose(obs, masks)
            assert masks[np.arange(8), actions].all()
        assert actions.shape == (8,)
        return super().__call__(agent_steps, choose)


def test_worlds_and_evaluations_say_alike_who_observes() -> None:
    worlds = importlib.import_module("pearl_marl.benchmark.trainers.worlds")
    task = next(task for task in TASKS if task.name == "PPO foraging")
    env, bare = worlds.environments(task, 8), parallel_env(task.env_id, n_agents=8)
    obs = env.reset_batch(3)
    np.testing.assert_array_equal(worlds.indicated(bare.reset_batch(3), 2), obs)
    np.testing.assert_array_equal(obs[:, -2:], np.tile(np.eye(2), (4, 1)))


# ---- In turns, each in a process of its own ----

ABSENT = TrainerModule("somebody", "sb3", "", ("no_such_package",))
BROKEN = TrainerModule("broken", "no_such_module", "", ())


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "TRAINERS", (*TRAINERS[:1], ABSENT, BROKEN, TRAINERS[-1]))


@pytest.mark.usefixtures("few")
def test_who_cannot_run_is_named(pearl: Pearl, tmp_path: Any) -> None:
    call = ("bench", "training", "frozenlake", "--quick", "--out", tmp_path)
    status, out, err = pearl(*call)
    assert status == 0, err
    (settings,) = (task.settings(0) for task in TASKS if task.env_id == "FrozenLake")
    result = json.loads((tmp_path / "trainings_FrozenLake.json").read_text())
    assert result["quick"]
    assert result["goals"] == {"PPO FrozenLake": None}
    ours, absent, broken = result["rows"]
    assert ours["contender"] == OURS
    assert ours["agent_steps_per_second"] > 0
    assert ours["seconds_to_goal"] is None
    assert ours["agent_steps_to_goal"] is None
    assert ours["agent_steps"] == 2 * settings.n_agents * settings.rollout_length
    assert ours["wall"] > ours["training_seconds"]
    assert "evaluations, imports and compilation not counted" in ours["what_counts"]
    assert absent["missing"].startswith("no_such_package not installed: make bench-peers")
    assert "it failed" in broken["missing"]
    assert "no_such_module" in broken["missing"]
    for row in (absent, broken):
        assert row["missing"] in " ".join(out.split())


@pytest.mark.usefixtures("few")
def test_each_seed_has_everybody_in_turn() -> None:
    order = [(task.name, who.name, seed) for task, who, seed in training.jobs(TASKS[:2], quick=False)]
    assert order[:4] == [("PPO CartPole", name, 0) for name in (OURS, "somebody", "broken", "PufferLib")]
    assert order[4:7] == [("PPO MountainCar", name, 0) for name in (OURS, "somebody", "broken")]
    assert [seed for _, _, seed in order[6::7]] == [0, 1, 2]


def row(contender: str, seed: int, rate: float, seconds: float | None) -> dict[str, Any]:
    about = {"task": "PPO CartPole", "contender": contender, "seed": seed, "what_counts": ""}
    steps = None if seconds is None else round(rate * seconds)
    reached = {"seconds_to_goal": seconds, "agent_steps_to_goal": steps}
    return {**about, "agent_steps_per_second": rate, **reached}


def test_ratios_are_seed_by_seed() -> None:
    rows = [
        *(row(OURS, 0, 100.0, 1.0), row(OURS, 1, 200.0, 2.0), row(OURS, 2, 300.0, None)),
        *(row("it", 0, 50.0, 3.0), row("it", 1, 50.0, None), row("it", 2, 50.0, 7.0)),
        {"task": "PPO CartPole", "contender": "gone", "seed": 0, "what_counts": "", "missing": "why"},
    ]
    ours, it, gone = training.compared(rows)
    assert (ours["agent_steps_per_second"], ours["seconds_to_goal"], ours["reached"]) == (200, 1.5, 2)
    assert it["rate_ratio"] == [4, 2, 6]
    assert it["time_ratio"] == [3, 3, 3], "of the seed with which both reached it"
    assert (it["seconds_to_goal"], it["reached"], it["seeds"]) == (5, 2, 3)
    assert (ours["agent_steps_to_goal"], it["agent_steps_to_goal"]) == (250, 250)
    assert gone["missing"] == "why"


def test_long_trainings_have_their_goal_where_their_environment_is_named() -> None:
    named = {task.name: task for game in ("Seaquest", "Breakout") for task in training.tasks_of(game, False)}
    assert list(named) == ["PPO Seaquest", "PQN Seaquest", "PPO Breakout", "PQN Breakout", "DQN Breakout"]
    assert named["PQN Seaquest"].goal == named["PPO Seaquest"].goal == 20.4
    among_all = {task.name: task for task in training.tasks_of(None, False)}
    brief = among_all["PQN Seaquest"]
    assert (brief.goal, brief.seconds) == (None, 20)
    assert "PQN Breakout" not in among_all
    assert among_all["PQN CartPole"] == next(task for task in TASKS if task.name == "PQN CartPole")
    assert all(task.goal is None for task in training.tasks_of("Breakout", quick=True))


def test_envpool_has_other_games_than_minatar() -> None:
    for task in SINGLE_TASKS:
        for who in (who for who in TRAINERS if "envpool" in who.packages):
            absent = str(who.missing(task)).startswith("MinAtar's own environments")
            minatar = "MinAtar" in (task.spec.oracle or "")
            assert (absent or "in Python" in who.counts(task)) == minatar


def test_refused_calls(pearl: Pearl) -> None:
    status, _, err = pearl("bench", "training", "Taxi")
    assert status == 2
    assert "possible are CartPole, MountainCar, FrozenLake, Seaquest, LevelBasedForaging" in err
