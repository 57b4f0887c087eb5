"""Episodes of jumanji's games, as ``record_jumanji.py`` has recorded them, replayed by ours."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

import pearl_marl
from pearl_marl.porting.oracle import Ours

Array = npt.NDArray[Any]
RECORDED = np.load(Path(__file__).with_name("jumanji.npz"))


class Replayed(NamedTuple):
    """What has been compared."""

    steps: int
    rewarded: int
    """How many steps had a reward."""
    idle: int
    """How many steps changed nothing."""
    last: Array
    """The words of the state in which each episode ended, shape ``(episodes, words)``."""


def replay(
    case: str,
    begin: Callable[[Any, Array], None],
    draws: Callable[[Array], Array],
    board: Callable[[Array], Array],
    episodes: int | None,
) -> Replayed:
    """Compare every board, reward, mask and end of recorded episodes.

    Parameters
    ----------
    case
        Its name in the recording, which begins with the environment's.
    begin
        Puts our games into their starts, from what was drawn for them, shape ``(episodes, numbers)``.
    draws
        Returns the draws of a step, shape ``(episodes, draws)``, from what was drawn in it.
    board
        Returns boards as their checksums were taken, from observations, shape ``(episodes, elements)``.
    episodes
        How many; or all.
    """
    spec = pearl_marl.get_spec(case.partition(",")[0])
    spec = spec.with_options(**json.loads(str(RECORDED[f"{case}/options"])))
    keys = "actions", "drawn", "checks", "running"
    actions, drawn, checks, running = (RECORDED[f"{case}/{key}"][:, :episodes] for key in keys)
    start = RECORDED[f"{case}/start"][:episodes].astype(np.int64)
    ours, rows = Ours(spec, len(start)), np.arange(len(start))
    begin(ours, start)

    def compare(rewards: Array, ends: Array, recorded: Array) -> None:
        parts = (
            board(ours.observations()[:, 0]),
            np.float32(rewards),
            np.uint8(ours.masks()[:, 0]),
            np.uint8(ends),
        )
        sums = [
            zlib.crc32(b"".join(part.tobytes() for part in row)) & 255 for row in zip(*parts, strict=True)
        ]
        np.testing.assert_array_equal(sums, recorded)

    nothing = np.zeros(len(start))
    compare(nothing, nothing, checks[0])
    rewarded, idle, last = 0, 0, np.zeros((len(start), len(spec.state)), np.int64)
    for action, numbers, check, on in zip(actions, drawn, checks[1:], running == 1, strict=True):
        goes_on = on[rows]
        rows, before = rows[goes_on], [word[goes_on] for word in ours.words]
        if not len(rows):
            break
        ours.words, ours.n = before, len(rows)
        made = ours.step(action[rows, None], draws(numbers[rows].astype(np.int64)))
        compare(made.rewards[:, 0], made.terminated[:, 0], check[rows])
        last[rows] = np.stack(ours.words, 1)
        rewarded += np.count_nonzero(made.rewards)
        idle += int((np.stack(before, 1) == last[rows]).all(1).sum())
    return Replayed(int(running.sum()), rewarded, idle, last)


def below(which: Array, count: Array) -> Array:
    """Return a draw whose ``below(count)`` is ``which``."""
    return -(-(which << 32) // np.maximum(count, 1))
