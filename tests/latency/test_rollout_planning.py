"""Which builds suit a policy that hardware rolls out."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware.elaboration import clocked
from pearl_marl.hardware.fitting import PARTS
from pearl_marl.latency.rollout_planning import plan_rollouts
from pearl_marl.latency.rollouts import rollout_step_cycles
from pearl_marl.policies import integer_file
from pearl_marl.policies.golden_policy import GoldenPolicy
from pearl_marl.policies.integer_network import IntegerNetwork, table_network

from ..policies.networks import random_network
from ..policies.rules import balance

Pearl = Callable[..., tuple[int, str, str]]

RIGHT = table_network(get_spec("CliffWalking"), np.tile([0, 1, 0, 0], (48, 1)))


def network() -> IntegerNetwork:
    return random_network(get_spec("CartPole"), 1, (32, 32), drawn=False)


def test_the_engine_gets_the_multipliers_that_cores_leave() -> None:
    part, found = PARTS["vc707"], plan_rollouts(network(), 43_008, 125e6, PARTS["vc707"])
    for candidate in found:
        engine, layout = candidate.layout.engine, candidate.layout
        assert engine is not None
        at = network().spec, layout, [4, 32, 32, 2]
        left = part.dsp - candidate.core_dsp - candidate.engine_dsp
        assert 0 <= left < engine.products * layout.pe_num
        assert candidate.cycles == rollout_step_cycles(*at, clocked("xc7", 125))
    best, *others = found
    assert best.limit == "engine"
    assert all(best.rate * 1.05 >= other.rate for other in others)
    assert 100e6 < best.rate < 300e6


def test_planes_take_multipliers_for_layers_alone() -> None:
    """And the inputs of the first layer are those of patches: 64 of them with 5 filters, in words of 8."""
    part, policy = PARTS["vc707"], random_network(get_spec("Breakout"), 1, (32, 16), drawn=False)
    best, *_ = found = plan_rollouts(policy, 43_008, 125e6, part)
    for candidate in found:
        engine, layout = candidate.layout.engine, candidate.layout
        assert engine is not None
        assert candidate.engine_dsp == engine.side * engine.products * layout.pe_num
        at = policy.spec, layout, [64 * 8, 32, 16, 3]
        assert candidate.cycles == rollout_step_cycles(*at, clocked("xc7", 125))
    assert best.core_dsp + best.engine_dsp <= part.dsp


def test_a_table_takes_none_and_cores_limit_it() -> None:
    best, *_ = plan_rollouts(RIGHT, 43_008, 125e6, PARTS["vc707"])
    assert (best.limit, best.engine_dsp, best.layout.pe_num) == ("cores", 0, 256)


def test_a_golden_function_takes_the_multipliers_of_its_cores_and_draws() -> None:
    rule = GoldenPolicy(get_spec("CartPole"), balance)
    found = plan_rollouts(rule, 43_008, 125e6, PARTS["vc707"], pe_num=4)
    assert [candidate.engine_dsp for candidate in found] == [6 * (1 + 4 * rule.draws)]
    layout = found[0].layout
    assert found[0].cycles == rollout_step_cycles(rule.spec, layout, target=clocked("xc7", 125))


def test_what_does_not_fit_is_refused() -> None:
    small = PARTS["arty-a7-100t"]
    with pytest.raises(
        ArgumentError, match="no engine for this policy fits the xc7a100t beside 43,008 slots"
    ):
        plan_rollouts(network(), 43_008, 125e6, small)


def test_the_command(pearl: Pearl, tmp_path: Path) -> None:
    integer_file.save(RIGHT, tmp_path / "right.safetensors")
    given = "--policy", tmp_path / "right.safetensors", "--n-envs", 512
    status, out, err = pearl("plan", "CliffWalking", *given, "--json")
    assert status == 0, err
    assert json.loads(out)["chosen"]["limit"] == "cores"
    status, out, err = pearl("plan", "CliffWalking", *given)
    assert status == 0, err
    assert "What limits: the cores." in out
    status, _, err = pearl("plan", "Taxi", *given)
    assert (status, "the plan for Taxi-v3" in err or "the plan for Taxi-v0" in err) == (2, True)
