"""Training: the trainers learn, runs go on after a kill as if it had not been, wrong settings are refused."""

from __future__ import annotations

import csv
import importlib
import json
import signal
import subprocess
import sys
import warnings
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pearl_marl.devices import BatchStep
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation.episodes import EpisodeStatistics
from pearl_marl.interfaces.parallel import parallel_env
from pearl_marl.policies.loading import load_policy

from ..sampling import sampled

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
training = importlib.import_module("pearl_marl.training.run")
policy = importlib.import_module("pearl_marl.policies.trained")
trainers = importlib.import_module("pearl_marl.training.trainer")
actor_critic = importlib.import_module("pearl_marl.training.actor_critic")

pytestmark = pytest.mark.usefixtures("one_thread")

EVALUATED = 50
"""A thousand episodes take longer than such training."""

SMALL: dict[str, dict[str, Any]] = {
    "ppo": {"n_agents": 32, "rollout_length": 8, "iterations": 12, "minibatch": 64},
    "pqn": {"n_agents": 32, "rollout_length": 8, "iterations": 12, "minibatch": 64},
    "dqn": {
        "n_agents": 16,
        "iterations": 40,
        "memory": 20,
        "warm_up": 5,
        "updates": 2,
        "minibatch": 32,
        "target_update": 9,
    },
    "q-learning": {"n_agents": 64, "iterations": 40},
}

OF_WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    "pqn": ("LevelBasedForaging", {**SMALL["pqn"], "rewards": "sum", "sharing": "indicator"}),
    "mappo": ("LevelBasedForaging", {**SMALL["ppo"], "rewards": "sum", "sharing": "none"}),
    "vdn": ("LevelBasedForaging", {**SMALL["pqn"], "sharing": "none"}),
    "qmix": ("LevelBasedForaging", {**SMALL["pqn"], "memory": "gru", "chunk_length": 4}),
    "self-play": ("ConnectFour", {**SMALL["ppo"], "join_every": 2}),
}
"""Trainers that are for several agents: an environment, and settings."""


def run(
    algorithm: str,
    env: str,
    folder: Path,
    goal: float | None = None,
    every: int | None = None,
    evaluated: int = EVALUATED,
    **given: Any,
) -> list[dict[str, Any]]:
    settings = training.settings_for(algorithm, env, given)
    plan = training.Training(env, algorithm, settings, goal=goal, evaluate_every=every)
    rows: list[dict[str, Any]] = training.train(plan, folder, evaluated)
    return rows


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_q_learning_finds_the_shortest_way_along_the_cliff(seed: int, tmp_path: Path) -> None:
    rows = run("q-learning", "CliffWalking", tmp_path, goal=-13.0, n_agents=4096, seed=seed)
    assert rows[-1]["eval_return"] == -13


def test_every_agent_can_learn_for_itself(tmp_path: Path) -> None:
    given = {"n_agents": 200, "learners": 200, "learning_rate": 1.0, "epsilon": 0.1, "iterations": 2500}
    rows = run("q-learning", "CliffWalking", tmp_path, every=2500, evaluated=200, **given)
    assert rows[-1]["eval_return"] == -13
    assert rows[-1]["eval_deviation"] == 0
    values = policy.load(tmp_path).values
    assert len(np.unique(values, axis=0)) == 200, "no two have had the same experience"


def test_learners_differ_in_rates_and_in_what_they_want() -> None:
    settings = training.settings_for("q-learning", "CliffWalking", {"n_agents": 30, "learners": 3})
    rewards, rates = [[-1, -100], [-1, -100], [1, 1]], [0.5, 0.0, 0.5]
    make = training.ALGORITHMS["q-learning"]
    learner = make(get_spec("CliffWalking"), "native", settings, rates=rates, rewards=rewards)
    for _ in range(20):
        learner.iterate()
    values = learner.policy.values
    assert values[0].min() < 0
    assert values[0].max() == 0
    assert not values[1].any()
    assert values[2].min() == 0
    assert values[2].max() > 0


@pytest.mark.parametrize(("name", "shape"), [("rates", (3, 1)), ("rewards", (3, 3)), ("rewards", (2, 2))])
def test_what_learners_differ_in_has_to_be_of_them_all(name: str, shape: tuple[int, int]) -> None:
    settings = training.settings_for("q-learning", "CliffWalking", {"n_agents": 6, "learners": 3})
    with pytest.raises(ArgumentError, match=rf"{name} have the shape \({shape[0]}, {shape[1]}\)"):
        training.ALGORITHMS["q-learning"](
            get_spec("CliffWalking"), "native", settings, **{name: np.zeros(shape)}
        )


def test_a_checkpoint_of_another_version_is_refused(tmp_path: Path) -> None:
    run("q-learning", "CliffWalking", tmp_path, **SMALL["q-learning"])
    file = tmp_path / "checkpoint.pt"
    torch.save({**torch.load(file, weights_only=True), "format": 1}, file)
    with pytest.raises(ArgumentError, match=r"checkpoint.pt is of another version.*another --out"):
        run("q-learning", "CliffWalking", tmp_path, **SMALL["q-learning"])


def test_returns_are_those_of_the_episodes_that_ended() -> None:
    """As ``EpisodeStatistics`` has them, which counts step by step."""
    random, n = np.random.default_rng(0), 7
    ours, theirs = trainers.EpisodeReturns(n, torch.device("cpu")), EpisodeStatistics(n)
    for steps in (1, 5, 3, 40):
        rewards, ended = random.normal(size=(steps, n)).astype(np.float32), random.random((steps, n)) < 0.2
        ours.add(torch.from_numpy(rewards), torch.from_numpy(ended))
        for t in range(steps):
            theirs.add(BatchStep(rewards[t], rewards[t], ended[t], np.zeros(n, bool), rewards[t]))
        if steps == 5:
            continue  # asked for less often than told
        figures, expected = ours.take(), theirs.summary()
        theirs.clear()
        assert figures["episodes"] == expected["episodes"]
        assert figures["train_return"] == pytest.approx(expected["return_mean"])
        assert figures["train_length"] == pytest.approx(expected["length_mean"])


def test_rewards_after_an_end_do_not_count_in_what_has_ended() -> None:
    returns = trainers.EpisodeReturns(2, torch.device("cpu"))
    rewards = torch.tensor([[1.0, float("inf")], [float("inf"), 1.0]])
    returns.add(rewards, torch.tensor([[True, False], [False, False]]))
    assert returns.take() == {"train_return": 1.0, "train_length": 1.0, "episodes": 1}


def test_advantages_are_those_of_their_definition() -> None:
    """Weighted sums of errors up to the end of the episode; cut short, with what was to come."""
    given = {
        "n_agents": 3,
        "rollout_length": 250,
        "discount": 0.9,
        "gae_lambda": 0.7,
        "blocks": 2,
        "reward_scale": 0.5,
    }
    trainer = training.ALGORITHMS["ppo"](
        get_spec("Pendulum"), "native", training.settings_for("ppo", "Pendulum", given)
    )
    first = trainer.worker.agents.obs.clone()
    e = trainer.worker.gather(0)
    assert torch.equal(e.inputs.obs[0], first)
    assert e.ended[199].all(), "an episode of Pendulum has 200 steps"
    assert e.ended.sum() == 3
    with torch.no_grad():
        seen = [*e.inputs.obs, trainer.worker.agents.obs]
        values = torch.stack([trainer.model.values(actor_critic.Inputs(obs)) for obs in seen])
        outputs = torch.stack([trainer.policy(obs) for obs in e.inputs.obs])
    torch.testing.assert_close(e.log_probs, trainer.model.evaluate(outputs, e.actions)[0])
    wanted = torch.zeros(3)
    for t in reversed(range(250)):
        if t == 199:  # the last reward's successor is not in the rollout: what counts is known otherwise
            wanted = e.advantages[t]
            continue
        error = 0.5 * e.rewards[t] + 0.9 * values[t + 1] - values[t]
        wanted = error + 0.9 * 0.7 * wanted
        torch.testing.assert_close(e.advantages[t], wanted)
    torch.testing.assert_close(e.returns, e.advantages + values[:-1])
    # The pendulum goes on from where it was cut short, so its value is about that of the step before.
    left = e.advantages[199] - 0.5 * e.rewards[199] + values[199]
    torch.testing.assert_close(left, 0.9 * values[199], atol=0.2, rtol=0)


def test_envpool_as_stable_baselines_wants_it() -> None:
    pytest.importorskip("envpool")
    sb3 = importlib.import_module("pearl_marl.experiments.sb3_training")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # Gymnasium's, of EnvPool's spaces, helps nobody here
        env = sb3.vec_env("envpool", "CartPole", 4, 0)
    obs = env.reset()
    ends = 0
    for _ in range(60):
        before = obs
        obs, rewards, ended, infos = env.step(np.ones(4, np.int64))
        assert (rewards == 1).all()
        for i in range(4):
            assert bool(infos[i]) == ended[i]
            if ended[i]:
                ends += 1
                assert not infos[i]["TimeLimit.truncated"]
                assert abs(infos[i]["terminal_observation"][2]) > 0.2, "the pole has fallen"
                assert np.abs(obs[i]).max() <= 0.05, "and a new episode has begun"
            else:
                assert np.abs(obs[i] - before[i]).max() < 0.5, "nobody else is reset"
    assert ends > 4
    env.close()


def test_envpool_says_when_it_was_only_the_time() -> None:
    pytest.importorskip("envpool")
    sb3 = importlib.import_module("pearl_marl.experiments.sb3_training")
    env = sb3.vec_env("envpool", "CartPole", 2, 0)
    obs = env.reset()
    for t in range(500):
        # Keeps the pole up: push where it leans and moves.
        obs, _, ended, infos = env.step((3 * obs[:, 2] + obs[:, 3] + 0.1 * obs[:, 1] > 0).astype(np.int64))
        assert ended.all() == (t == 499)
    assert all(info["TimeLimit.truncated"] for info in infos)


@pytest.mark.slow
def test_ppo_balances_the_pole(tmp_path: Path) -> None:
    rows = run("ppo", "CartPole", tmp_path, goal=475.0)
    assert rows[-1]["eval_return"] >= 475
    best = policy.load(tmp_path)
    assert training.evaluate(best, get_spec("CartPole"), EVALUATED)["eval_return"] == rows[-1]["eval_return"]


@pytest.mark.parametrize("env", ["CartPole", "Taxi", "Blackjack", "Pendulum"])
@pytest.mark.parametrize("algorithm", SMALL)
def test_every_kind_of_space_is_trained_or_refused(algorithm: str, env: str, tmp_path: Path) -> None:
    of_numbers = algorithm in ("pqn", "dqn", "q-learning") and env == "Pendulum"
    if of_numbers or (algorithm, env) == ("q-learning", "CartPole"):
        with pytest.raises(ArgumentError, match=env):
            run(algorithm, env, tmp_path, **SMALL[algorithm])
        assert not any(tmp_path.iterdir())
        return
    rows = run(algorithm, env, tmp_path, every=10, **SMALL[algorithm])
    assert np.isfinite(rows[-1]["eval_return"])
    assert (tmp_path / "learning_curve.png").stat().st_size > 0
    with (tmp_path / "metrics.csv").open() as file:
        assert [int(row["agent_steps"]) for row in csv.DictReader(file)] == [
            row["agent_steps"] for row in rows
        ]
    assert json.loads((tmp_path / "config.json").read_text())["settings"]["algorithm"] == algorithm
    with closing(parallel_env(env, n_agents=8)) as agents:
        obs = agents.reset_batch(seed=0)
    actions = load_policy(str(tmp_path), get_spec(env))(obs)  # as `pearl eval` has it
    np.testing.assert_array_equal(actions, policy.load(tmp_path).choose(obs))


ENDLESS = """
import importlib, sys, time
from pathlib import Path
training = importlib.import_module("pearl_marl.training.run")
import torch
torch.set_num_threads(1)
algorithm, env, folder, given = sys.argv[1], sys.argv[2], Path(sys.argv[3]), eval(sys.argv[4])
settings = training.settings_for(algorithm, env, given)
plan = training.Training(env, algorithm, settings)
run = training.TrainingRun(plan, folder, evaluated=50, checkpoint_seconds=0.2)
with run.claimed():
    while not run.finished:
        if run.iterate():
            print(run.trainer.done, flush=True)
            time.sleep(0.05)
"""


KILLED: dict[str, tuple[str, str, dict[str, Any]]] = {
    **{algorithm: (algorithm, "FrozenLake", given) for algorithm, given in SMALL.items()},
    **{algorithm: (algorithm, *case) for algorithm, case in OF_WORLDS.items()},
    "memory": ("ppo", "FrozenLake", {**SMALL["ppo"], "memory": "gru", "chunk_length": 4}),
    "a league's memories": (
        "self-play",
        "ConnectFour",
        {**SMALL["ppo"], "join_every": 2, "memory": "gru", "chunk_length": 4},
    ),
}


@pytest.mark.parametrize("name", sampled([*KILLED], ("ppo", "self-play")))
def test_a_killed_run_goes_on_as_if_nothing_had_been(name: str, tmp_path: Path) -> None:
    algorithm, env, given = KILLED[name]
    whole = run(algorithm, env, tmp_path / "whole", **given)
    killed = tmp_path / "killed"
    command = [sys.executable, "-c", ENDLESS, algorithm, env, str(killed), repr(given)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            # Between two checkpoints: what came after the last one is done again.
            if int(line) >= 9 and (killed / "checkpoint.pt").exists():
                process.send_signal(signal.SIGKILL)
                break
    assert process.wait() == -signal.SIGKILL
    rows = run(algorithm, env, killed, **given)
    timeless = [[{**row, "seconds": 0} for row in part] for part in (whole, rows)]
    assert timeless[0] == timeless[1]
    ends = [
        torch.load(folder / "checkpoint.pt", weights_only=True) for folder in (tmp_path / "whole", killed)
    ]
    assert same(ends[0]["trainer"], ends[1]["trainer"])
    files = [
        sorted(path.relative_to(folder) for path in folder.rglob("*.safetensors"))
        for folder in (tmp_path / "whole", killed)
    ]
    assert files[0] == files[1]
    assert all((tmp_path / "whole" / file).read_bytes() == (killed / file).read_bytes() for file in files[0])


def test_a_stopped_run_goes_on_as_if_nothing_had_been(tmp_path: Path) -> None:
    """Wherever it is stopped: also between evaluations, long before a checkpoint is due."""
    whole = run("ppo", "FrozenLake", tmp_path / "whole", every=4, **SMALL["ppo"])
    settings = training.settings_for("ppo", "FrozenLake", SMALL["ppo"])
    plan = training.Training("FrozenLake", "ppo", settings, evaluate_every=4)

    def stopped_after(iterations: int) -> None:
        stopped = training.TrainingRun(plan, tmp_path / "stopped", evaluated=EVALUATED)
        with stopped.claimed():
            for _ in range(iterations):
                stopped.iterate()
            stopped.keep()
            raise KeyboardInterrupt

    for iterations in (3, 1):
        with pytest.raises(KeyboardInterrupt):
            stopped_after(iterations)
    rows = run("ppo", "FrozenLake", tmp_path / "stopped", every=4, **SMALL["ppo"])
    timeless = [[{**row, "seconds": 0} for row in part] for part in (whole, rows)]
    assert timeless[0] == timeless[1]
    assert (tmp_path / "whole" / "policy.safetensors").read_bytes() == (
        tmp_path / "stopped" / "policy.safetensors"
    ).read_bytes()


def same(one: Any, other: Any) -> bool:
    """Return whether two states are equal, to the bit."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, torch.Tensor):
        return bool(torch.equal(one, other))
    if isinstance(one, np.ndarray):
        return bool(np.array_equal(one, other))
    if hasattr(one, "__dict__"):
        return same(vars(one), vars(other))
    return bool(one == other)


@pytest.mark.parametrize(
    ("algorithm", "given", "words"),
    [
        ("sarsa", {}, "'sarsa'.*'dqn', 'pqn', 'vdn', 'qmix', 'q-learning', 'ippo', 'iql'"),
        ("ppo", {"n_agent": 5}, "--set n_agent: .*'n_agents'"),
        ("ppo", {"rollout_length": 1.5}, "--set rollout_length is 1.5"),
        ("dqn", {"discount": -1}, "--set discount is -1"),
        ("q-learning", {"n_agents": 10, "learners": 3}, "'learners' is 3; it must divide n_agents, 10"),
        ("dqn", {"discount": "high"}, "--set discount is 'high'"),
    ],
)
def test_wrong_settings_are_refused(
    algorithm: str, given: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(ArgumentError, match=words):
        run(algorithm, "CliffWalking", tmp_path, **given)
    assert not any(tmp_path.iterdir())


def test_a_folder_of_another_run_is_refused(tmp_path: Path) -> None:
    run("q-learning", "CliffWalking", tmp_path, n_agents=64, iterations=3)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(ArgumentError, match=r"environment 'CliffWalking-v0', not 'Taxi-v0'"):
        run("q-learning", "Taxi", tmp_path, n_agents=64, iterations=3)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_what_is_no_policy_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"policy.safetensors"):
        policy.load(tmp_path)
    (tmp_path / "policy.safetensors").write_bytes(b"no")
    with pytest.raises(ArgumentError, match=r"policy.safetensors"):
        policy.load(tmp_path)


@pytest.mark.parametrize(
    ("algorithm", "env", "given"),
    [("ppo", "Pendulum", {"reward_scale": 1e38}), ("dqn", "MountainCar", {"reward_scale": 1e300})],
)
def test_a_training_that_diverges_says_so(
    algorithm: str, env: str, given: dict[str, float], tmp_path: Path
) -> None:
    with pytest.raises(ArgumentError, match=r"the training has diverged.*'learning_rate' smaller"):
        run(algorithm, env, tmp_path, **SMALL[algorithm], **given)
