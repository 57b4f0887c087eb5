"""BenchMARL through our bridge: its algorithms run as they are, and learn."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

import pearl_marl
from pearl_marl import envs
from pearl_marl.errors import ArgumentError
from pearl_marl.wrappers import agent_indicator_v0, dtype_v0, flatten_v0, pad_observations_v0

from ..toy_world import MEADOW, NIM

pytest.importorskip("benchmarl", reason="BenchMARL is not installed: pip install '.[marl]'")

import torch
from benchmarl.algorithms import IppoConfig, MappoConfig, QmixConfig, VdnConfig
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig

from pearl_marl.wrappers import benchmarl_task


@pytest.fixture(autouse=True)
def _surroundings() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    with mock.patch.dict(envs._specs), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # TorchRL and BenchMARL tell of their own coming changes
        for spec in (MEADOW, NIM):
            pearl_marl.register(spec)
        yield
    torch.set_num_threads(before)


class Batches(Callback):
    """Keeps what was collected."""

    def __init__(self) -> None:
        super().__init__()
        self.all: list[Any] = []
        self.losses: list[float] = []

    def on_batch_collected(self, batch: Any) -> None:
        self.all.append(batch.clone())

    def on_train_end(self, training_td: Any, group: str) -> None:
        self.losses += [float(value) for value in training_td.mean().values()]

    def returns(self) -> list[float]:
        """Return what a world's agents got together in an episode, by batch."""
        means = []
        for batch in self.all:
            ended = batch["next", "done"][..., 0]
            means.append(float(batch["next", "agents", "episode_reward"][ended].sum(1).mean()))
        return means


def config(folder: Path, worlds: int = 10, steps: int = 20, iterations: int = 2) -> ExperimentConfig:
    made = ExperimentConfig.get_from_yaml()
    made.loggers, made.create_json, made.render = [], False, False
    made.save_folder = str(folder)
    made.max_n_frames, made.max_n_iters = None, iterations
    frames = worlds * steps
    made.on_policy_n_envs_per_worker = made.off_policy_n_envs_per_worker = worlds
    made.on_policy_collected_frames_per_batch = made.off_policy_collected_frames_per_batch = frames
    made.on_policy_minibatch_size, made.on_policy_n_minibatch_iters = frames // 4, 4
    made.off_policy_train_batch_size, made.off_policy_n_optimizer_steps = 32, 3
    made.off_policy_memory_size = 1000
    made.evaluation_interval, made.evaluation_episodes = frames, 3
    made.lr, made.gamma = 1e-3, 0.98
    return made


def experiment(task: Any, algorithm: Any, settings: ExperimentConfig) -> tuple[Experiment, Batches]:
    batches = Batches()
    made = Experiment(
        task=task,
        algorithm_config=algorithm,
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=settings,
        callbacks=[batches],
    )
    return made, batches


@pytest.mark.parametrize("state", [False, True])
@pytest.mark.parametrize("algorithm", [MappoConfig, IppoConfig, QmixConfig, VdnConfig])
def test_algorithms_run_as_they_are(algorithm: Any, state: bool, tmp_path: Path) -> None:
    """With evaluation; every action that they took was one that they may take."""
    task = benchmarl_task("LevelBasedForaging", state=state, max_cycles=7)
    settings = config(tmp_path)
    settings.create_json = True  # which evaluation is for
    made, batches = experiment(task, algorithm.get_from_yaml(), settings)
    made.run()
    assert [batch.shape for batch in batches.all] == [(10, 20)] * 2
    for batch in batches.all:
        assert ("state" in batch.keys()) is state  # noqa: SIM118  # a tensordict iterates otherwise
        taken = batch["agents", "action_mask"].gather(-1, batch["agents", "action"][..., None])
        assert taken.all()
        assert batch["next", "truncated"].any()
    assert np.isfinite(batches.losses).all()


def test_groups_of_roles(tmp_path: Path) -> None:
    made, batches = experiment(
        benchmarl_task("Meadow", wrap=as_floats), IppoConfig.get_from_yaml(), config(tmp_path)
    )
    made.run()
    assert made.group_map == {"hare": ["agent_0", "agent_1"], "snail": ["agent_2", "agent_3"]}
    assert {"hare", "snail"} <= set(batches.all[0].keys())


def test_numbers_for_actions(tmp_path: Path) -> None:
    task = benchmarl_task("Pendulum")
    assert task.supports_continuous_actions()
    assert not task.supports_discrete_actions()
    made, batches = experiment(task, IppoConfig.get_from_yaml(), config(tmp_path))
    made.run()
    assert batches.all[0]["agents", "action"].shape == (10, 20, 1, 1)


def boards_as_numbers(env: Any) -> Any:
    return dtype_v0(flatten_v0(env), np.float32)


def as_floats(env: Any) -> Any:
    return dtype_v0(pad_observations_v0(env), np.float32)


def test_a_game_that_refuses_masked_actions(tmp_path: Path) -> None:
    task = benchmarl_task("ConnectFour", wrap=boards_as_numbers, max_cycles=42)
    made, batches = experiment(task, MappoConfig.get_from_yaml(), config(tmp_path, steps=60))
    made.run()
    assert batches.all[0]["next", "terminated"].any()


@pytest.mark.slow
def test_mappo_learns_to_forage(tmp_path: Path) -> None:
    """One food on a small grid: random players find it in half of the episodes."""
    task = benchmarl_task("LevelBasedForaging", field_size=(5, 5), max_num_food=1, wrap=agent_indicator_v0)
    algorithm = MappoConfig.get_from_yaml()
    algorithm.entropy_coef = 0.01
    settings = config(tmp_path, worlds=128, steps=32, iterations=8)
    settings.evaluation = False
    made, batches = experiment(task, algorithm, settings)
    made.run()
    returns = batches.returns()
    assert returns[1] < 0.65
    assert returns[-1] > 0.9


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: benchmarl_task("LevelBasedForaging", n_agents=4),
            "n_agents is 4; BenchMARL says how many worlds there are: set on_policy_n_envs_per_worker or "
            "off_policy_n_envs_per_worker of its ExperimentConfig",
        ),
        (
            lambda: benchmarl_task("ConnectFour"),
            "ConnectFour has no time limit here, and BenchMARL's evaluation needs one: give max_cycles",
        ),
        (
            lambda: benchmarl_task("LevelBasedForaging", wrap=lambda env: env.unwrapped.device),
            "wrap returned Native, which is not the environment it was given in wrappers of this package",
        ),
        (
            lambda: benchmarl_task("LevelBasedForaging", autoreset=False),
            "agents of autoreset=False leave when their episode ends, and TorchRL's stay: make the "
            "environment with autoreset=True",
        ),
    ],
)
def test_what_is_refused(make: Any, message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        make()
    assert str(error.value) == message
