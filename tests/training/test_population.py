"""Many seeds at once: each learns what it would learn alone, and the spread is that of their returns."""

from __future__ import annotations

import csv
import importlib
import json
import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pearl_marl.errors import ArgumentError

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
training = importlib.import_module("pearl_marl.training.run")
training_settings = importlib.import_module("pearl_marl.training.settings")
population = importlib.import_module("pearl_marl.training.population")

SMALL = {"n_agents": 16, "rollout_length": 8, "iterations": 6, "minibatch": 64, "width": 16, "seed": 3}


def plan(goal: float | None = None) -> Any:
    settings = training.settings_for("ppo", "FrozenLake", SMALL)
    return training.Training("FrozenLake", "ppo", settings, goal=goal, evaluate_every=2)


def trained(run: Any, most: int = 100) -> None:
    with run.claimed():
        while not run.finished:
            run.iterate()
            if run.done >= most:
                run.keep()
                raise KeyboardInterrupt


def test_each_seed_learns_what_it_would_alone(tmp_path: Path) -> None:
    """Also when it was stopped on the way."""
    with pytest.raises(KeyboardInterrupt):
        trained(population.Population(plan(), tmp_path / "all", 3, evaluated=20), most=3)
    together = population.Population(plan(), tmp_path / "all", 3, evaluated=20)
    trained(together)
    assert [run.done for run in together.runs] == [6, 6, 6]
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    for seed in (3, 4, 5):
        settings = training.settings_for("ppo", "FrozenLake", {**SMALL, "seed": seed})
        alone = training.Training("FrozenLake", "ppo", settings, evaluate_every=2)
        training.train(alone, tmp_path / f"{seed}", 20)
        files = [
            folder / "policy.safetensors" for folder in (tmp_path / f"{seed}", tmp_path / f"all/seed-{seed}")
        ]
        assert files[0].read_bytes() == files[1].read_bytes()
    torch.set_num_threads(before)
    returns = [[row["eval_return"] for row in run.rows] for run in together.runs]
    with (tmp_path / "all" / "spread.csv").open() as file:
        spread = list(csv.DictReader(file))
    assert [int(row["agent_steps"]) for row in spread] == [256, 512, 768]
    assert {(row["seeds"], row["diverged"]) for row in spread} == {("3", "0")}
    for k, row in enumerate(spread):
        least, median, greatest = sorted(own[k] for own in returns)
        found = [float(row[name]) for name in ("least", "median", "greatest", "mean")]
        assert found == pytest.approx([least, median, greatest, (least + median + greatest) / 3])
    assert (tmp_path / "all" / "learning_curves.png").stat().st_size > 0


def diverge(run: Any, after: int) -> None:
    """Have the losses of a run be no numbers after so many iterations."""
    check = run.trainer.check
    run.trainer.check = lambda losses: check(losses * (math.nan if run.done == after else 1))


def test_others_go_on_where_a_seed_diverges(tmp_path: Path) -> None:
    together = population.Population(plan(), tmp_path, 3, evaluated=20)
    diverge(together.runs[1], after=3)
    trained(together)
    assert [run.done for run in together.runs] == [6, 3, 6]
    assert "the loss of iteration 4 is no number" in together.diverged[4]
    returns = [run.rows[-1]["eval_return"] for run in together.runs[::2]]
    last = together.spread()[-1]
    assert [last[name] for name in ("least", "greatest", "seeds", "diverged")] == [*sorted(returns), 2, 1]
    diverging = population.Population(plan(), tmp_path / "none", 2, evaluated=20)
    for run in diverging.runs:
        diverge(run, after=0)
    with pytest.raises(ArgumentError, match="no seed can go on; of seed 3, the training has diverged"):
        trained(diverging)


def test_folders_are_kept_until_their_runs_have_ended_an_iteration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    together = population.Population(plan(), tmp_path, 2, evaluated=20)
    slow, begun, ends = together.runs[1], threading.Event(), []

    def update() -> None:
        begun.set()
        time.sleep(0.1)
        with pytest.raises(ArgumentError, match="trains"), slow.folder.claimed():
            pass
        ends.append(slow)

    slow.trainer.update = update

    def interrupted(_: Any) -> None:
        assert begun.wait(10)
        raise KeyboardInterrupt

    monkeypatch.setattr(population, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        trained(together)
    assert ends == [slow]


@pytest.mark.parametrize(("algorithm", "at_once"), [("ppo", 2), ("q-learning", 3)])
def test_the_memory_of_all_seeds_counts(
    algorithm: str, at_once: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rollout is held in an iteration only, of which the machine's threads do so many at a time."""
    monkeypatch.setattr(population.os, "cpu_count", lambda: 2)
    settings = training.settings_for(algorithm, "FrozenLake", {"n_agents": 4096})
    one = training.Training("FrozenLake", algorithm, settings)
    size = training.TrainingRun(one, tmp_path).trainer.need.size
    monkeypatch.setattr(training_settings, "memory_of_machine", lambda: at_once * size)
    population.Population(one, tmp_path, 3)
    monkeypatch.setattr(training_settings, "memory_of_machine", lambda: at_once * size - 1)
    with pytest.raises(ArgumentError, match=f", {at_once} seeds at a time, takes at least"):
        population.Population(one, tmp_path, 3)


def test_a_folder_of_other_seeds_is_refused(tmp_path: Path) -> None:
    (tmp_path / "seed-5").mkdir()
    says = "holds seed-5, and this training has the seeds 3 to 4: give the seeds that it had"
    with pytest.raises(ArgumentError, match=says):
        trained(population.Population(plan(), tmp_path, 2))
    assert [path.name for path in tmp_path.iterdir()] == ["seed-5"]


def test_a_seed_that_reached_the_goal_rests() -> None:
    rows = [{"agent_steps": at, "eval_return": float(at)} for at in (10, 20)]
    assert population._returns_at(rows, [5, 10, 15, 20, 30]) == [10, 10, 10, 20, 20]


def test_the_command(pearl: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    given = ("FrozenLake", "--n-agents", 8, "--iterations", 1, "--seeds", 2, "--goal", -1, "--json")
    status, out, err = pearl("train", *given, "--out", tmp_path / "run")
    assert status == 0, err
    result = json.loads(out)
    assert result["reached"] == 2
    assert [run["seed"] for run in result["runs"]] == [0, 1]
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == [
        "learning_curves.png",
        "seed-0",
        "seed-1",
        "spread.csv",
    ]


@pytest.mark.parametrize("seeds", [0, 1001])
def test_impossible_numbers_of_seeds_are_refused(seeds: int, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=f"--seeds is {seeds}; it must be an integer from 1 to 1000"):
        population.Population(plan(), tmp_path, seeds)
