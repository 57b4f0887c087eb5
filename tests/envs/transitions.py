"""What the tests of bsuite's environments share: the transitions that ``record_bsuite.py`` has recorded."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.golden import call_reference
from pearl_marl.porting.oracle import Outcome, compare
from pearl_marl.testing import compare_steps

Array = npt.NDArray[Any]
RECORDED = np.load(Path(__file__).with_name("bsuite.npz"))


def cases(name: str) -> list[str]:
    """Return the recorded cases of an environment."""
    return sorted({key.split("/")[0] for key in RECORDED if key.partition("/")[0].partition(",")[0] == name})


class Recorded:
    """The oracle that looks recorded transitions up."""

    def __init__(self, case: str) -> None:
        self.columns = {key.split("/")[1]: RECORDED[key] for key in RECORDED if key.split("/")[0] == case}
        self.options = json.loads(str(self.columns.pop("options")))
        self.spec: EnvSpec = pearl_marl.get_spec(case.partition(",")[0]).with_options(**self.options)
        self.rows = {tuple(state): row for row, state in enumerate(self.columns["states"].tolist())}
        self._now = np.zeros(0, np.int64)

    def pose(self, games: Array, state: list[Array]) -> None:
        """Look the states of games up."""
        found = np.array([self.rows[row] for row in zip(*(c.tolist() for c in state), strict=True)])
        if len(games) > len(self._now):
            self._now = np.zeros(len(games), np.int64)
        self._now[games] = found

    def look(self, games: Array) -> Outcome:
        """Return what bsuite shows in these states."""
        return Outcome(self._seen(self._now[games]))

    def step(self, actions: Array, draws: Array) -> Outcome:
        """Return what bsuite's steps led to."""
        which = self._now, actions[:, 0]
        self._now = self.columns["after"][which].astype(np.int64)
        after = self.columns["states"][self._now].astype(np.int64)
        return Outcome(
            self._seen(self._now),
            self.columns["reward"][which],
            self.columns["ended"][which],
            state={field.name: after[:, k] for k, field in enumerate(self.spec.state)},
        )

    def _seen(self, rows: Array) -> Array:
        return self.columns["seen"][rows].reshape(len(rows), 1, -1)


def check_every_step(case: str) -> int:
    """Compare every recorded transition, on the CPU device, too; return how many there are."""
    oracle = Recorded(case)
    rows = np.flatnonzero(~oracle.columns["over"])
    count = oracle.columns["after"].shape[1]
    words = [np.repeat(column, count) for column in oracle.columns["states"][rows].T]
    compare_steps(oracle.spec, oracle, words, np.tile(np.arange(count), len(rows)))
    return len(rows) * count


def check_starts(case: str, draws: int) -> None:
    """Compare the starts: all are as likely, by evenly spaced draws."""
    oracle = Recorded(case)
    spaced = (2 * np.arange(draws) + 1 << 31) // draws
    grid = np.meshgrid(*[spaced] * oracle.spec.reset_draws)
    ours = call_reference(oracle.spec.positional.initial, [column.ravel() for column in grid])
    counts = Counter(zip(*(np.broadcast_to(c, grid[0].size).tolist() for c in ours), strict=True))
    assert set(counts) == {state for state, row in oracle.rows.items() if row < oracle.columns["starts"]}
    assert max(counts.values()) - min(counts.values()) <= 1


def check_play(case: str, games: int, steps: int) -> None:
    """Compare whole episodes of random play."""
    oracle = Recorded(case)
    ends = sum(int(move.ended.sum()) for move in compare(oracle.spec, oracle, games, steps, seed=3))
    assert ends > games
