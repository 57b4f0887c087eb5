"""MyEnvironment: the contract that every environment keeps, and its own rules."""

from itertools import product

import pytest
from pearl_marl import get_spec
from pearl_marl.golden import Draws
from pearl_marl.testing import ContractSuite

from my_environment.step import State, initial

ENVIRONMENT = "my_environment:MyEnvironment"


class TestContract(ContractSuite):
    """What every environment must do; on the simulated hardware, where this machine can build it."""

    environments = (ENVIRONMENT,)
    devices = ("native", "rtl")


def expected(slip: int, cell: int, action: int, eighth: int) -> tuple[int, float, bool]:
    """Say the rules a second time, as one would tell them: the oracle.

    Where somebody else's implementation exists, compare with that one instead.
    """
    if eighth >= slip:
        cell += 1 if action == 1 else -1
    cell = min(max(cell, 0), 15)
    return cell, {0: -20.0, 15: 20.0}.get(cell, -1.0), cell in (0, 15)


def draws(eighth: int) -> Draws:
    """Return one random draw of 32 bits, whose upper three are known: an eighth of all that there are."""
    return Draws([(eighth << 29) + 12345])


@pytest.mark.parametrize("slip", [0, 1, 7])
def test_every_state_action_and_draw(slip: int) -> None:
    spec = get_spec(ENVIRONMENT).with_options(slip=slip)
    assert spec.rewards is not None
    for cell, action, eighth in product(range(16), range(2), range(8)):
        state, reward, ended = spec.golden.step(State(cell), action, draws(eighth))
        assert (state.cell, spec.rewards[reward], ended) == expected(slip, cell, action, eighth)


def test_starts_are_in_the_middle() -> None:
    assert [initial(draws(eighth)).cell for eighth in range(8)] == list(range(4, 12))
