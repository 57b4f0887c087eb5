"""The perfect player of ConnectFour, against a search that knows nothing but the rules."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pearl_marl.batch.actions import random_actions
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.envs import get_spec
from pearl_marl.envs.connect_four.step import COLUMNS, ROWS
from pearl_marl.errors import ArgumentError
from pearl_marl.experiments import self_play
from pearl_marl.experiments.perfect_play import DRAW, ILLEGAL, LOSS, WIN, Judge

SPEC = get_spec("ConnectFour")


LINES = [
    [(row + k * down, column + k * right) for k in range(4)]
    for row in range(ROWS)
    for column in range(COLUMNS)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1))
    if row + 3 * down < ROWS and 0 <= column + 3 * right < COLUMNS
]


@cache
def searched(own: frozenset[tuple[int, int]], other: frozenset[tuple[int, int]]) -> tuple[int, ...]:
    """Return what each column is worth to who is on turn, whose discs are given first."""
    values = []
    for column in range(COLUMNS):
        free = [row for row in range(ROWS) if (row, column) not in own | other]
        if not free:
            values.append(ILLEGAL)
            continue
        after = own | {(free[-1], column)}  # the row at the bottom is the last
        if any(after.issuperset(line) for line in LINES):
            values.append(WIN)
        elif len(after) + len(other) == ROWS * COLUMNS:
            values.append(DRAW)
        else:
            values.append(-max(searched(other, after)))
    return tuple(values)


def games(discs: int, count: int) -> Any:
    """Return what players on turn see in games with so many discs."""
    device = Native().open(BatchConfig(spec=SPEC, n_envs=count))
    obs, rng = device.reset(0), np.random.default_rng(1)
    seen: list[Any] = []
    while sum(map(len, seen)) < count:
        rows = (obs.sum((1, 2, 3), dtype=int) == discs) & device.action_masks.any(1)
        seen.append(obs[rows])
        obs = device.step(random_actions(SPEC, rng, len(obs), device.action_masks)).obs
    device.close()
    return np.concatenate(seen)[:count]


@pytest.mark.parametrize("discs", [35, 34, 33])
def test_late_positions_are_worth_what_a_whole_search_finds(discs: int) -> None:
    seen = games(discs, 40)
    values = Judge().values(seen)
    cells = [
        [frozenset(zip(*board.nonzero(), strict=True)) for board in (s[..., 0], s[..., 1])] for s in seen
    ]
    expected = [searched(*pair) for pair in cells]
    np.testing.assert_array_equal(values, expected)
    assert {LOSS, WIN} <= set(np.unique(values)), "some of each"


def test_what_is_remembered_changes_nothing() -> None:
    seen = games(24, 60)
    judge = Judge()
    for boards in (seen, seen[::-1]):
        np.testing.assert_array_equal(judge.values(boards), Judge().values(boards))


def test_good_moves_are_told_from_bad_ones() -> None:
    seen = games(24, 60)
    values = Judge().values(seen)
    assert Judge().optimal(seen, values.argmax(1)).all()
    worst = np.where(values == ILLEGAL, 9, values).argmin(1)
    told = Judge().optimal(seen, worst)
    np.testing.assert_array_equal(told, values[np.arange(60), worst] == values.max(1))
    assert not told.all()


def test_a_run_without_past_selves_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="has no folder past/: give that of a run of --algo self-play"):
        self_play.main(tmp_path)
