"""MyEnvironment: the contract that every environment keeps, and its own rules."""

from itertools import product

import numpy as np
import pytest
from pearl_marl import get_spec
from pearl_marl.golden import call_reference, u8, u32
from pearl_marl.testing import ContractSuite

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


@pytest.mark.parametrize("slip", [0, 1, 7])
def test_every_state_action_and_draw(slip: int) -> None:
    spec = get_spec(ENVIRONMENT).with_options(slip=slip)
    assert spec.rewards is not None
    cases = list(product(range(16), range(2), range(8)))
    cells, actions, eighths = np.array(cases).T
    # All cases at once: golden functions take whole arrays. An eighth is the draw's upper three bits.
    draws = u32(eighths << 29) | u32(12345)
    arrived, categories, ends = call_reference(spec.positional.step, (u8(cells), u8(actions), draws))
    rewards = np.take(spec.rewards, categories)
    results = zip(arrived.tolist(), rewards.tolist(), ends.astype(bool).tolist(), strict=True)
    assert list(results) == [expected(slip, *case) for case in cases]


def test_starts_are_in_the_middle() -> None:
    draws = np.arange(0, 2**32, 2**24, dtype=np.uint32)
    (cells,) = call_reference(get_spec(ENVIRONMENT).golden.initial, (draws,))
    assert np.unique(cells, return_counts=True)[1].tolist() == [len(draws) // 8] * 8
    assert (cells.min(), cells.max()) == (4, 11)
