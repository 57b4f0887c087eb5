"""Every transition of an environment, as ``record_bsuite.py`` and ``record_pgx.py`` have recorded them."""

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
from pearl_marl.porting.oracle import Actions, Outcome, any_actions, compare
from pearl_marl.testing import compare_steps

Array = npt.NDArray[Any]
RECORDED: dict[str, Array] = {}
for package in ("bsuite", "pgx"):
    RECORDED |= np.load(Path(__file__).with_name(f"{package}.npz"))


def cases(name: str) -> list[str]:
    """Return the recorded cases of an environment."""
    return sorted({key.split("/")[0] for key in RECORDED if key.partition("/")[0].partition(",")[0] == name})


class Recorded:
    """The oracle that looks recorded transitions up."""

    def __init__(self, case: str) -> None:
        self.columns = {key.split("/")[1]: RECORDED[key] for key in RECORDED if key.split("/")[0] == case}
        self.options = json.loads(str(self.columns.pop("options")))
        self.spec: EnvSpec = pearl_marl.get_spec(case.partition(",")[0]).with_options(**self.options)
        goes_on = np.flatnonzero(~self.columns["over"])
        self.rows = {tuple(self.columns["states"][row].tolist()): row for row in goes_on}
        self._now = np.zeros(0, np.int64)

    def pose(self, games: Array, state: list[Array]) -> None:
        """Look the states of games up."""
        found = np.array([self.rows[row] for row in zip(*(c.tolist() for c in state), strict=True)])
        if len(games) > len(self._now):
            self._now = np.zeros(len(games), np.int64)
        self._now[games] = found

    def look(self, games: Array) -> Outcome:
        """Return what the package shows in these states."""
        return self._shows(self._now[games])

    def step(self, actions: Array, draws: Array) -> Outcome:
        """Return what the package's steps led to, by the actions of agents on turn."""
        agents = np.zeros(len(actions), np.int64)
        if self.spec.turns:
            names = [field.name for field in self.spec.state]
            agents = self.columns["states"][self._now, names.index("turn")]
        which = self._now, actions[np.arange(len(actions)), agents]
        self._now = self.columns["after"][which].astype(np.int64)
        after = self.columns["states"][self._now].astype(np.int64)
        return self._shows(self._now)._replace(
            rewards=self.columns["reward"][which],
            terminated=np.repeat(self.columns["over"][self._now, None], self.spec.agents, 1),
            state={field.name: after[:, k] for k, field in enumerate(self.spec.state)},
        )

    def _shows(self, rows: Array) -> Outcome:
        seen = self.columns["seen"][rows].reshape(len(rows), self.spec.agents, -1)
        return Outcome(seen, masks=self.columns["mask"][rows] if "mask" in self.columns else None)


def check_every_step(case: str) -> int:
    """Compare every recorded transition, of default options on the CPU device, too; return their number."""
    oracle = Recorded(case)
    every = np.ones(oracle.columns["after"].shape, np.bool_)
    rows, actions = np.nonzero(oracle.columns.get("legal", every) & ~oracle.columns["over"][:, None])
    words = list(oracle.columns["states"][rows].T)
    taken = np.repeat(actions[:, None], oracle.spec.agents, 1)
    taken = taken if oracle.spec.agents > 1 else actions
    if oracle.spec.options == pearl_marl.get_spec(oracle.spec.name).options:
        compare_steps(oracle.spec, oracle, words, taken)
    else:  # each spec's kernels take seconds to compile
        list(compare(oracle.spec, oracle, len(rows), state=words, actions=taken))
    return len(rows)


def check_starts(case: str, draws: int) -> None:
    """Compare the starts: all are as likely, by evenly spaced draws."""
    oracle = Recorded(case)
    spaced = (2 * np.arange(draws) + 1 << 31) // draws
    grid = np.meshgrid(*[spaced] * oracle.spec.reset_draws)
    ours = call_reference(oracle.spec.positional.initial, [column.ravel() for column in grid])
    counts = Counter(zip(*(np.broadcast_to(c, grid[0].size).tolist() for c in ours), strict=True))
    assert set(counts) == {state for state, row in oracle.rows.items() if row < oracle.columns["starts"]}
    assert max(counts.values()) - min(counts.values()) <= 1


def check_play(case: str, games: int, steps: int, actions: Actions = any_actions) -> None:
    """Compare whole episodes of random play."""
    oracle = Recorded(case)
    moves = compare(oracle.spec, oracle, games, steps, actions=actions, seed=3)
    assert sum(int(move.ended.sum()) for move in moves) > games
