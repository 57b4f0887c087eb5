"""MyEnvironment: the contract that every environment keeps, and its own rules."""

from functools import partial

import numpy as np
import pytest
from pearl_marl import get_spec
from pearl_marl.golden import Draws
from pearl_marl.testing import ContractSuite, Outcome, compare_steps, every_state, one_by_one

from my_environment.step import State, initial

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
    cell = state.cell
    if draws[0] >> 29 >= slip:
        cell += 1 if actions[0] == 1 else -1
    cell = min(max(cell, 0), 15)
    return Outcome(cell, {0: -20.0, 15: 20.0}.get(cell, -1.0), cell in (0, 15))


@pytest.mark.parametrize("slip", [0, 1, 7])
def test_every_state_action_and_draw(slip: int) -> None:
    """Each of the first two 100 times, by the draws of the device."""
    spec = get_spec(ENVIRONMENT).with_options(slip=slip)
    cells, actions = np.tile(every_state(spec), 100)
    compare_steps(spec, one_by_one(spec, partial(expected, slip)), [cells], actions)


def test_starts_are_in_the_middle() -> None:
    assert [initial(Draws([eighth << 29])).cell for eighth in range(8)] == list(range(4, 12))
