"""Policies that are golden functions: compiled they do as in plain Python; impossible ones are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, make_device
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation.run import Evaluation
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.policies.golden_policy import GoldenPolicy
from pearl_marl.policies.loading import load_policy

from .rules import balance, bet, brake, catch, drive, swing, up, walk


@pytest.mark.parametrize(
    ("name", "act", "draws"),
    [
        ("CartPole", balance, 2),
        pytest.param("Acrobot", swing, 0, marks=pytest.mark.exhaustive),
        pytest.param("MountainCarContinuous", drive, 0, marks=pytest.mark.exhaustive),
        ("Pendulum", brake, 0),
        ("CliffWalking", walk, 0),
        pytest.param("Catch", catch, 0, marks=pytest.mark.exhaustive),
        ("Game2048", up, 1),
        ("KuhnPoker", bet, 0),
    ],
)
def test_compiled_it_does_as_in_plain_python(name: str, act: Any, draws: int) -> None:
    policy, found = GoldenPolicy(get_spec(name), act), []
    assert policy.draws == draws
    for device in map(make_device, ("native", "reference")):
        device.open(BatchConfig(spec=policy.spec, n_envs=40, max_cycles=30))
        device.reset(1)
        result = device.rollout(policy, 50)
        found.append((result.returns, result.lengths, device.snapshot().memory))
    for native, reference in zip(*found, strict=True):
        np.testing.assert_array_equal(native, reference)
    assert found[0][1].any()


def test_it_does_as_its_author_says() -> None:
    """A walk along the cliff costs 13, and a paddle that moves with the ball catches it."""
    for name, act, expected in (("CliffWalking", walk, -13), ("Catch", catch, 1)):
        evaluation = Evaluation(get_spec(name), GoldenPolicy(get_spec(name), act), 50)
        for _ in evaluation.run():
            pass
        assert set(evaluation.returns) == {expected}


def test_recorded_steps_are_those_of_the_rollout() -> None:
    """Where observations are unpacked, which the policy is not shown."""
    policy, results = GoldenPolicy(get_spec("Catch"), catch), []
    for record in (False, True):
        device = make_device("native")
        device.open(BatchConfig(spec=policy.spec, n_envs=9))
        device.reset(2)
        results.append(device.rollout(policy, 30, record=record))
    np.testing.assert_array_equal(results[0].returns, results[1].returns)
    assert results[1].observations is not None
    assert results[1].observations.shape == (30, 9, *policy.spec.observation_shape)


@pytest.mark.parametrize(
    ("name", "act", "message"),
    [
        ("CartPole", lambda view, draws: 2, "returns 2 for action.*the action space has 0 to 1"),
        ("CartPole", lambda view, draws: (0, 1), "returns 2 words"),
        ("CartPole", lambda view: 1, r"is called with \(view, draws\)"),
        ("CartPole", lambda view, draws: view.lean, r"test_golden_policy.py, line \d+: .*'lean'"),
    ],
)
def test_what_is_no_policy_is_refused(name: str, act: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        GoldenPolicy(get_spec(name), act)


def test_a_policy_for_other_words_is_refused() -> None:
    policy = GoldenPolicy(get_spec("Catch"), catch)
    device = make_device("native")
    device.open(BatchConfig(spec=get_spec("Catch").with_options(columns=9), n_envs=2))
    device.reset(1)
    with pytest.raises(ArgumentError, match="the policy is for Catch with the observation_space"):
        device.rollout(policy, 2)


def test_it_is_loaded_by_name(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(
        "from pearl_marl import get_spec\n"
        "from pearl_marl.policies.golden_policy import GoldenPolicy\n"
        "def act(place, draws):\n"
        "    return 1\n"
        "right = GoldenPolicy(get_spec('CliffWalking'), act)\n"
    )
    policy = load_policy(f"{path}:right", get_spec("CliffWalking"))
    assert isinstance(policy, DevicePolicy)
