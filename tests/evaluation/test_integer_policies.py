"""Evaluations and matches of policies in integers, which run beside the environments."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.devices import Lockstep
from pearl_marl.evaluation.matches import Match
from pearl_marl.evaluation.run import Evaluation, acting
from pearl_marl.policies import integer_file
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.policies.integer_network import table_network
from pearl_marl.policies.loading import load_policy, random_policy

from ..policies.networks import random_network

CARTS, CLIFF = get_spec("CartPole"), get_spec("CliffWalking")


def ran(*arguments: Any, **options: Any) -> Any:
    evaluation = Evaluation(*arguments, **options)
    assert sum(1 for _ in evaluation.run()) == evaluation.episodes
    return evaluation


def along_the_cliff() -> Any:
    values = np.tile([0, 1, 0, 0], (48, 1))
    values[36] = 2, 1, 0, 0
    values[[11, 23, 35]] = 0, 0, 1, 0
    return table_network(CLIFF, values)


@pytest.mark.parametrize("max_cycles", [0, 9])
def test_episodes_are_those_of_single_steps(max_cycles: int) -> None:
    """With chance in the policy, limits that episodes reach, and episodes longer than a first rollout."""
    network, n = random_network(CARTS, 2), 300
    rolled = ran(CARTS, network, n, max_cycles=max_cycles, seed=4)
    stepped = Evaluation(CARTS, lambda *seen: act(*seen), n, max_cycles=max_cycles, seed=4)
    act = acting(network, lambda: stepped.device)
    for _ in stepped.run():
        pass
    assert np.array_equal(rolled.returns, stepped.returns)
    assert np.array_equal(rolled.lengths, stepped.lengths)
    assert rolled.truncated == stepped.truncated
    assert (rolled.truncated > 0) == (max_cycles > 0)


def test_every_agent_does_its_share_of_episodes() -> None:
    once, often = (ran(CARTS, random_network(CARTS, 2), 10, episodes=k, seed=1) for k in (10, 23))
    assert len(often.returns) == 23
    # Of an agent's two or three, the first is the one that it does alone.
    firsts = [0, 3, 6, *range(9, 23, 2)]
    assert np.array_equal(often.returns[firsts], once.returns)
    assert len(set(often.returns)) > len(set(once.returns)), "others begin elsewhere"


def test_the_best_way_along_the_cliff() -> None:
    summary = ran(CLIFF, along_the_cliff(), 5, episodes=12).summary()
    assert summary["return"]["mean"] == -13
    assert (summary["episodes"], summary["truncated"], summary["steps"]) == (12, 0, 3 * 64)
    assert summary["agent_steps_per_second"] > 0
    assert "latency" not in summary


def test_devices_have_one_digest() -> None:
    network = random_network(CARTS, 3)
    one, other = (ran(CARTS, network, 4, device, max_cycles=20) for device in ("native", Lockstep("native")))
    assert one.digest == other.digest
    assert other.summary()["words_compared"] > 0
    assert ran(CARTS, network, 4, max_cycles=20, seed=1).digest != one.digest


def test_a_match_is_that_of_the_same_function() -> None:
    spec = get_spec("ConnectFour")
    network = random_network(spec, 3, drawn=False)

    def function(boards: Any, masks: Any) -> Any:
        rows = np.arange(len(boards))
        return network.choose(
            boards.reshape(len(boards), -1), rows % 2, masks, np.zeros((len(boards), 0), np.uint32)
        ).words[:, 0]

    outcomes = []
    for policy in (network, function):
        match = Match(spec, policy, random_policy(spec, 1), 200, seed=2)
        for _ in match.run():
            pass
        outcomes.append((match.outcome(), match.digest))
    assert outcomes[0] == outcomes[1]


def test_pearl_eval(pearl: Any, tmp_path: Path) -> None:
    file = tmp_path / "integers.safetensors"
    integer_file.save(along_the_cliff(), file)
    assert isinstance(load_policy(str(file), CLIFF), DevicePolicy)
    line = ("eval", "CliffWalking", "--policy", file, "--n-agents", 7, "--out", tmp_path)
    status, out, _ = pearl(*line)
    assert status == 0
    assert "agent-steps/s with the policy" in out
    assert "-13.00" in out
    page = (tmp_path / "evaluation.html").read_text()
    assert "agent-steps/s" in page
    assert "Latency" not in page
    result = json.loads(pearl(*line[:-2], "--json")[1])
    assert result["return"]["mean"] == -13
    status, _, err = pearl("eval", "Taxi", "--policy", file)
    assert status == 2
    assert "was trained on observations in Discrete(48)" in " ".join(err.split())
