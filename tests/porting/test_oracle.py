"""The oracle contract itself: it passes where both agree, and says what differs first where they do not."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pytest
from gymnasium.spaces import Discrete

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Range
from pearl_marl.porting.oracle import DifferenceError, Games, Outcome, Rules, compare, one_by_one
from pearl_marl.spec import EnvSpec, Golden
from pearl_marl.testing import assert_same_play, compare_pictures, compare_steps, every_state
from pearl_marl.testing.oracles import p_of_one_law

LIMIT = 6


class State(NamedTuple):
    """A cell of ten."""

    cell: Range[0, 9]


def initial(draws: Draws) -> State:
    return State(draws.below(4))


def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
    cell = min(state.cell + action + draws.bits(1), 9)
    return State(cell), cell == 9, cell == 9


def observe(state: State) -> Word:
    return state.cell


def masks(state: State) -> tuple[Word, Word]:
    return True, state.cell < 8


def draw(state: State) -> Any:
    return np.full((2, 2, 3), state.cell, np.uint8)


SPEC = EnvSpec(
    name="Walk",
    version=0,
    summary="Walk to the tenth cell",
    rewards=(0.0, 1.0),
    observation_space=Discrete(10),
    action_space=Discrete(2),
    golden=Golden(State, initial, step, observe, masks),
    max_cycles=LIMIT,
    draw=draw,
    render_modes=("rgb_array",),
)


class Walk:
    """The same in a class of its own, which counts its steps; ``wrong`` has it err."""

    def __init__(self, wrong: str = "") -> None:
        self.cell = self.steps = 0
        self.wrong = wrong

    def pose(self, state: State) -> None:
        self.cell, self.steps = state.cell, 0

    def step(self, actions: list[int], draws: list[int]) -> Outcome:
        self.steps += 1
        self.cell = min(self.cell + actions[0] + (draws[0] >> 31), 9)
        if self.wrong == "draws" and draws[0] >> 30 == 3:
            self.cell -= 1
        over = self.cell == 9
        shown = self.look()._replace(
            rewards=float(over) + (self.wrong == "rewards" and self.cell == 5),
            terminated=over or (self.wrong == "terminated" and self.cell == 7),
            truncated=self.steps == LIMIT - (self.wrong == "truncated") and not over,
            state={"cell": self.cell + (self.wrong == "state" and self.cell == 3)},
        )
        if self.wrong == "memory" and self.cell == 4:
            self.cell = 3  # which nothing shows before the next step
        return shown

    def look(self) -> Outcome:
        seen = self.cell + (self.wrong == "observations" and self.cell == 6)
        return Outcome(seen, masks=[self.wrong != "masks" or self.cell != 2, self.cell < 8])


def walked(wrong: str = "", n: int = 20, steps: int = 60) -> int:
    """Compare whole episodes; return how many ended."""
    games = Games(SPEC, [Walk(wrong) for _ in range(n)], Walk.pose, Walk.step, Walk.look)
    return sum(int(move.ended.sum()) for move in compare(SPEC, games, n, steps))


def test_both_agree() -> None:
    assert walked() > 200


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("observations", "cell=. .*: observation is 6, the original's 7"),
        ("rewards", "reward is 0, the original's 1"),
        ("terminated", "terminated is 0, the original's 1"),
        (
            "truncated",
            "after 5 steps, the last by the actions ., ., ., ., .: truncated is 0, the original's 1",
        ),
        ("masks", "mask 0 is 1, the original's 0"),
        ("state", "cell is 3, the original's 4"),
        ("draws", "is ., the original's ."),
        ("memory", "is ., the original's ."),
    ],
)
def test_each_difference_is_seen(wrong: str, words: str) -> None:
    with pytest.raises(DifferenceError, match=words):
        walked(wrong)


def rules(state: State, actions: list[int], draws: list[int], off: float = 0.0) -> Outcome:
    cell = min(state.cell + actions[0] + (draws[0] >> 31), 9)
    return Outcome(cell + off, float(cell == 9), cell == 9)


def every(oracle: Rules, **arguments: Any) -> Any:
    *words, actions = every_state(SPEC)
    return compare_steps(SPEC, oracle, words, actions, **arguments)


def test_every_state_and_action() -> None:
    assert len(every(one_by_one(SPEC, rules)).ended) == 20


def test_a_tolerance() -> None:
    nearly = one_by_one(SPEC, partial(rules, off=0.01))
    assert every(nearly, tolerance={"observation": 0.02}).errors["observation"].max() == pytest.approx(0.01)
    with pytest.raises(DifferenceError, match="the original's"):
        every(one_by_one(SPEC, partial(rules, off=0.01)), tolerance=0.005)


def test_what_is_undecided_is_not_compared() -> None:
    def undecided(state: State, actions: list[int], draws: list[int]) -> Outcome:
        outcome = rules(state, actions, draws)
        near = outcome.observations > 7
        return outcome._replace(terminated=outcome.terminated ^ near, undecided=near)

    assert every(one_by_one(SPEC, undecided)).outcome.undecided.any()


def test_a_device_that_differs_is_seen() -> None:
    with mock.patch("pearl_marl.testing.oracles.step_from") as other:
        other.return_value.arrivals.return_value = np.zeros(20)
        with pytest.raises(AssertionError, match="Mismatched elements"):
            every(one_by_one(SPEC, rules))


@pytest.mark.parametrize(("drawn", "fits"), [(draw, True), (lambda state: draw(State(5)), False)])
def test_pictures(drawn: Callable[[Any], Any], fits: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def call() -> None:
        compare_pictures(SPEC, "rgb_array", drawn, [1] * 5, different=4, device="reference")

    monkeypatch.setattr("pearl_marl.envs.get_spec", lambda name: SPEC)
    monkeypatch.setattr("pearl_marl.interfaces.parallel.get_spec", lambda name: SPEC)
    if fits:
        call()
    else:
        with pytest.raises(AssertionError, match="Mismatched elements"):
            call()


def test_random_play() -> None:
    generator = np.random.default_rng(0)
    first, second = generator.geometric(0.1, (2, 4000))
    assert_same_play((first, first), (second, second))
    with pytest.raises(AssertionError, match="returns"):
        assert_same_play((first, first), (second, second + 1))
    assert p_of_one_law(first, first) == 1.0


def test_p_is_scipys() -> None:
    stats = pytest.importorskip("scipy.stats")
    generator = np.random.default_rng(1)
    for shift in (0.0, 0.02, 0.05):
        a, b = generator.normal(size=5000), generator.normal(shift, size=4000)
        assert p_of_one_law(a, b) == pytest.approx(stats.ks_2samp(a, b, method="asymp").pvalue, abs=0.02)
