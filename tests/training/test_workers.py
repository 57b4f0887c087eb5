"""Training over several processes: the same weights, however many there are and whatever happens to them."""

from __future__ import annotations

import contextlib
import importlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError, DeviceError

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
ray = pytest.importorskip("ray", reason="Ray is not installed: pip install '.[ray]'")
training = importlib.import_module("pearl_marl.training.run")
distributed = importlib.import_module("pearl_marl.training.workers")

pytestmark = pytest.mark.usefixtures("ray_cluster", "one_thread")

SMALL = {"n_agents": 16, "rollout_length": 70, "iterations": 3, "minibatch": 256}
"""Of Pendulum, whose episodes of 200 steps are cut short in the last rollout."""


def trainer(shards: int | None, env_id: str = "Pendulum", **given: Any) -> Any:
    settings = training.settings_for("ppo", env_id, {**SMALL, "blocks": 8, **given})
    return training.ALGORITHMS["ppo"](get_spec(env_id), "native", settings, shards=shards)


def assert_same(ours: Any, theirs: Any) -> None:
    """Compare all that a continuation depends on."""
    ours, theirs = ours.state(), theirs.state()
    for name, tensor in theirs["model"].items():
        assert torch.equal(ours["model"][name], tensor), name
    assert torch.equal(ours["agents"], theirs["agents"])


@pytest.fixture(scope="module")
def alone() -> Any:
    """A run of this process, and its figures, which can be taken once."""
    torch.set_num_threads(1)
    run = trainer(None)
    for _ in range(3):
        run.iterate()
    return run, run.figures()


def test_shards_of_any_size_go_on_with_what_a_process_began(alone: Any) -> None:
    """Three of eight blocks; the next test begins with two. The device's own tests have more."""
    first, second = trainer(None), trainer(3)
    first.iterate()
    first.iterate()
    second.load(first.state())
    second.iterate()
    assert_same(second, alone[0])
    assert second.figures() == alone[1]


@pytest.mark.exhaustive  # other tests lose shards, and tests/training/test_memory.py has the memories
def test_memories_travel_with_the_agents() -> None:
    """Two shards, one of which is lost between rollouts."""
    remembering = {"memory": "gru", "chunk_length": 10, "width": 8}
    one, several = trainer(None, **remembering), trainer(2, **remembering)
    for _ in range(2):
        one.iterate()
    several.iterate()
    ray.kill(several.worker._actors[1])
    several.iterate()
    assert_same(several, one)
    assert torch.equal(several.state()["memory"], one.state()["memory"])
    again = trainer(1, **remembering)
    again.load(several.state())
    for run in (one, again):
        run.iterate()
    assert_same(again, one)


def test_workers_lost_between_rollouts_and_within(alone: Any) -> None:
    run = trainer(2)
    run.iterate()
    ray.kill(run.worker._actors[1])
    run.iterate()
    actor = run.worker._actors[0]
    # Asked for the rollout it will do first this, and is no more when that is asked for.
    actor.__ray_terminate__.remote()
    run.iterate()
    assert run.worker._actors[0] is not actor
    assert_same(run, alone[0])


def test_a_worker_that_is_lost_again_and_again_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    run = trainer(1)
    dead = run.worker._actors[0]
    ray.kill(dead)
    monkeypatch.setattr(run.worker, "_start", lambda i: (dead, None))
    with pytest.raises(DeviceError, match=r"shard 0 was lost 3 times in rollout 0.*the run goes on later"):
        run.iterate()


def test_what_cannot_be_shared_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"--shards is 9; the agents are in 8 blocks.*--set blocks=9"):
        trainer(9)
    with pytest.raises(ArgumentError, match=r"--shards is 0; it must be at least 1"):
        trainer(0)
    with pytest.raises(ArgumentError, match=r"dqn does not learn with --shards"):
        training.settings_for("dqn", "CartPole", {}, shards=2)
    assert training.settings_for("ppo", "CartPole", {"n_agents": 5}, shards=2).blocks == 5
    with pytest.raises(ArgumentError, match=r"'blocks' is 8; it must be 1 to 5"):
        trainer(None, n_agents=5)


def run(folder: Path, shards: int | None, show: Callable[[int], None] = lambda _: None) -> None:
    """Train ten iterations, unless the folder has some of them."""
    torch.set_num_threads(1)
    settings = training.settings_for(
        "ppo", "CartPole", {"n_agents": 64, "iterations": 10, "blocks": 8}, shards
    )
    plan = training.Training("CartPole", "ppo", settings, evaluate_every=2)
    run = training.TrainingRun(plan, folder, shards, evaluated=50, checkpoint_seconds=0.0)
    with run.claimed():
        while not run.finished:
            if run.iterate():
                show(run.trainer.done)


DRIVER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from tests.training.test_workers import run
run(Path(sys.argv[2]), 2, lambda done: print('done', done, flush=True))
"""


@pytest.mark.exhaustive
def test_killed_workers_and_a_killed_driver_change_nothing(tmp_path: Path) -> None:
    """A worker at random after every second rollout, and then the driver."""
    folder, chance = tmp_path / "killed", random.Random(0)
    command = [sys.executable, "-c", DRIVER, str(Path(__file__).parents[2]), str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as driver:
        assert driver.stdout is not None
        for line in driver.stdout:  # among what Ray has to say
            if not line.startswith("done "):
                continue
            if int(line.split()[1]) > 4:
                driver.kill()
                break
            os.kill(chance.choice(worker_processes(driver.pid)), signal.SIGKILL)
    assert driver.returncode == -signal.SIGKILL
    deadline = time.monotonic() + 1800
    while worker_processes(driver.pid) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not worker_processes(driver.pid), "they end with their driver"
    run(folder, 1)
    run(tmp_path / "whole", None)
    ours, theirs = (
        torch.load(tmp_path / name / "checkpoint.pt", weights_only=True) for name in ("killed", "whole")
    )
    for each in ours, theirs:
        for row in each["rows"]:
            del row["seconds"]
    assert ours["rows"] == theirs["rows"]
    assert ours["trainer"]["done"] == 10
    for name, tensor in theirs["trainer"]["model"].items():
        assert torch.equal(ours["trainer"]["model"][name], tensor), name


def worker_processes(session: int) -> list[int]:
    """Return the processes of workers in a session."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            name = (folder / "cmdline").read_bytes()
            if name.startswith(b"ray::Worker") and os.getsid(int(folder.name)) == session:
                found.append(int(folder.name))
    return found
