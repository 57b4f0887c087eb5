"""MyEnvironment: the contract that every environment keeps, and its own rules."""

import random

import pytest
from pearl_marl import get_spec
from pearl_marl.golden import Draws
from pearl_marl.testing import ContractSuite

from my_environment.step import AGENTS, State, masks

ENVIRONMENT = "my_environment:MyEnvironment"


class TestContract(ContractSuite):
    """What every environment must do; on the simulated hardware, where this machine can build it."""

    environments = (ENVIRONMENT,)
    devices = ("native", "rtl")


def expected(
    slip: int, cell: int, strengths: list[int], actions: list[int], eighth: int
) -> tuple[State, list[float], bool]:
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
    return State(cell, after), rewards, cell in (0, 15)


@pytest.mark.parametrize("slip", [0, 1, 7])
def test_many_states_actions_and_draws(slip: int) -> None:
    spec = get_spec(ENVIRONMENT).with_options(slip=slip)
    assert spec.rewards is not None
    chance = random.Random(slip)
    for _ in range(2000):
        cell, eighth = chance.randrange(16), chance.randrange(8)
        strengths = [chance.randrange(4) for _ in range(AGENTS)]
        actions = [chance.randrange(3) for _ in range(AGENTS)]
        # One random draw of 32 bits; the upper three are an eighth of all that there are.
        draws = Draws([(eighth << 29) + 12345])
        state, rewards, ends = spec.golden.step(State(cell, strengths), actions, draws)
        due, worth, end = expected(slip, cell, strengths, actions, eighth)
        assert (state, [spec.rewards[reward] for reward in rewards], ends) == (due, worth, [end] * AGENTS)


def test_who_is_tired_may_only_rest() -> None:
    for agent in range(AGENTS):
        tired = [int(k != agent) for k in range(AGENTS)]
        assert masks(State(7, tired), agent) == (True, False, False)
        rested = [int(k == agent) for k in range(AGENTS)]
        assert masks(State(7, rested), agent) == (True, True, True)
