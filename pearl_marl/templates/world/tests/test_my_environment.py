"""MyEnvironment: the contract that every environment keeps, and its own rules."""

from functools import partial

import numpy as np
import pytest
from pearl_marl import get_spec
from pearl_marl.testing import ContractSuite, Outcome, compare_steps, one_by_one

from my_environment.step import AGENTS, State, masks

ENVIRONMENT = "my_environment:MyEnvironment"


class TestContract(ContractSuite):
    """What every environment must do; on the simulated hardware, where this machine can build it."""

    environments = (ENVIRONMENT,)
    devices = ("native", "rtl")


def expected(slip: int, state: State, actions: list[int], draws: list[int]) -> Outcome:
    """Say the rules a second time, as one would tell them: the oracle.

    Where somebody else's implementation exists, compare with that one instead. The upper three bits of a
    draw are an eighth of all that there are.
    """
    cell, strengths = state.cell, state.strengths
    pulls = [action if strength else 0 for strength, action in zip(strengths, actions, strict=True)]
    balance = pulls.count(2) - pulls.count(1)
    if balance and draws[0] >> 29 >= slip:
        cell += 1 if balance > 0 else -1
    cell = min(max(cell, 0), 15)
    after = [
        strength - 1 if pull else min(strength + 1, 3)
        for strength, pull in zip(strengths, pulls, strict=True)
    ]
    return Outcome(
        observations=[(cell, strength) for strength in after],
        rewards=[{0: -20.0, 15: 20.0}.get(cell, -1.0 if pull else 0.0) for pull in pulls],
        terminated=[cell in (0, 15)] * AGENTS,
        masks=[(True, strength > 0, strength > 0) for strength in after],
    )


@pytest.mark.parametrize("slip", [0, 1, 7])
def test_many_states_and_actions(slip: int) -> None:
    """Any of each, by the draws of the device."""
    spec = get_spec(ENVIRONMENT).with_options(slip=slip)
    generator = np.random.default_rng(slip)
    states = [generator.integers(*field.range, size=2000, endpoint=True) for field in spec.state]
    compare_steps(spec, one_by_one(spec, partial(expected, slip)), states, seed=slip)


def test_who_is_tired_may_only_rest() -> None:
    for agent in range(AGENTS):
        tired = [int(k != agent) for k in range(AGENTS)]
        assert masks(State(7, tired), agent) == (True, False, False)
        rested = [int(k == agent) for k in range(AGENTS)]
        assert masks(State(7, rested), agent) == (True, True, True)
