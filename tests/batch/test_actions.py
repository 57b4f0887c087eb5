"""Random actions, and those that masks allow."""

from __future__ import annotations

import numpy as np
import pytest

from pearl_marl.batch.actions import random_actions, random_allowed, refuse_masked
from pearl_marl.errors import ActionError

from ..toy_world import MEADOW

MASKS = np.array([[0, 1, 0, 1, 1], [1, 0, 0, 0, 0], [0, 0, 0, 0, 0], [1, 1, 1, 1, 1]], np.int8)


def test_allowed_actions_are_equally_likely() -> None:
    draws = np.random.default_rng(0).integers(1 << 32, size=40_000, dtype=np.uint32)
    actions = random_allowed(np.tile(MASKS, (10_000, 1)), draws).reshape(-1, 4)
    counts = np.stack([np.bincount(column, minlength=5) for column in actions.T])
    assert (counts[2] == [10_000, 0, 0, 0, 0]).all(), "who may do nothing takes action 0"
    several = MASKS.any(1)
    assert ((counts > 0) == MASKS)[several].all()
    expected = 10_000 / MASKS.sum(1, keepdims=True)[several]
    spread = np.abs(counts[several] - expected) * MASKS[several]
    assert (spread < 4 * np.sqrt(expected)).all()


@pytest.mark.parametrize("draw", [0, (1 << 32) - 1])
def test_the_least_and_the_greatest_draw(draw: int) -> None:
    draws = np.full(4, draw, np.uint32)
    assert random_allowed(MASKS, draws).tolist() == ([1, 0, 0, 0] if draw == 0 else [4, 0, 0, 4])


def test_random_actions_of_masks_cost_a_step_least() -> None:
    rng = np.random.default_rng(0)
    actions = random_actions(MEADOW, rng, 4, MASKS)
    assert actions.dtype == MEADOW.action.dtype
    refuse_masked(actions, MASKS)


def test_of_those_who_take_turns_one_may_act() -> None:
    nobody, all_but_first = [0, 0, 0], [0, 1, 1]
    masks = np.array([nobody, all_but_first, all_but_first, nobody], np.int8)
    refuse_masked(np.array([2, 1, 2, 0]), masks, 0, 2)
    with pytest.raises(ActionError, match="agent_2: action 0 is masked; it may take 1, 2"):
        refuse_masked(np.array([1, 1, 0, 1]), masks, 0, 2)
    # A world in which nobody may act is not refused, nor does it hide another one.
    masks[:2] = 0
    refuse_masked(np.array([0, 0, 1, 0]), masks, 0, 2)
    with pytest.raises(ActionError, match="agent_2"):
        refuse_masked(np.array([0, 0, 0, 0]), masks, 0, 2)


def test_the_first_masked_action_is_named() -> None:
    refuse_masked(np.array([1, 0, 4, 4]), MASKS)
    with pytest.raises(ActionError, match="agent_11: action 1 is masked; it may take 0"):
        refuse_masked(np.array([1, 1, 0, 0]), MASKS, 10)
