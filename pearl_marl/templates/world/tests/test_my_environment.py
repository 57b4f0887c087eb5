"""MyEnvironment: the contract that every environment keeps, and its own rules."""

import numpy as np
import pytest
from pearl_marl import get_spec
from pearl_marl.golden import call_reference
from pearl_marl.testing import ContractSuite

ENVIRONMENT = "my_environment:MyEnvironment"
AGENTS = get_spec(ENVIRONMENT).agents


class TestContract(ContractSuite):
    """What every environment must do; on the simulated hardware, where this machine can build it."""

    environments = (ENVIRONMENT,)
    devices = ("native", "rtl")


def expected(slip: int, cell: int, strengths: list[int], actions: list[int], eighth: int) -> list[float]:
    """Say the rules a second time, as one would tell them: the oracle.

    Where somebody else's implementation exists, compare with that one instead.
    """
    pulls = [action if strength else 0 for strength, action in zip(strengths, actions, strict=True)]
    balance = pulls.count(2) - pulls.count(1)
    if balance and eighth >= slip:
        cell += 1 if balance > 0 else -1
    cell = min(max(cell, 0), 15)
    after = [
        strength - 1 if pull else min(strength + 1, 3)
        for strength, pull in zip(strengths, pulls, strict=True)
    ]
    rewards = [{0: -20.0, 15: 20.0}.get(cell, -1.0 if pull else 0.0) for pull in pulls]
    return [cell, *after, *rewards, *[cell in (0, 15)] * AGENTS]


@pytest.mark.parametrize("slip", [0, 1, 7])
def test_many_states_actions_and_draws(slip: int) -> None:
    spec = get_spec(ENVIRONMENT).with_options(slip=slip)
    assert spec.rewards is not None
    rng = np.random.default_rng(slip)
    n = 2000
    cells, eighths = rng.integers(16, size=n), rng.integers(8, size=n)
    strengths, actions = rng.integers(4, size=(AGENTS, n)), rng.integers(3, size=(AGENTS, n))
    # All cases at once: golden functions take whole arrays. An eighth is the draw's upper three bits.
    draws = (eighths << 29) + 12345
    words = np.array(call_reference(spec.positional.step, (cells, *strengths, *actions, draws))).astype(float)
    first = 1 + AGENTS
    words[first : first + AGENTS] = np.take(spec.rewards, words[first : first + AGENTS].astype(int))
    for case in range(n):
        told = expected(
            slip, cells[case], strengths[:, case].tolist(), actions[:, case].tolist(), eighths[case]
        )
        assert words[:, case].tolist() == told


def test_who_is_tired_may_only_rest() -> None:
    spec = get_spec(ENVIRONMENT)
    assert spec.positional.masks is not None
    for agent in range(AGENTS):
        tired = [1] * AGENTS
        tired[agent] = 0
        flags = [int(flag) for flag in call_reference(spec.positional.masks, (7, *tired), agent)]
        assert flags == [1, 0, 0]
        rested = [0] * AGENTS
        rested[agent] = 1
        flags = [int(flag) for flag in call_reference(spec.positional.masks, (7, *rested), agent)]
        assert flags == [1, 1, 1]
