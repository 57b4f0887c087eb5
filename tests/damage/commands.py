"""Files that the command line is given."""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path
from typing import Any

from pearl_marl import cli
from pearl_marl.cli import interrupts
from pearl_marl.errors import PearlError

from .devices import Replays
from .kind import Kind, Rng, expect
from .policies import Archives, Arrays, Policies


class CommandLine(Kind):
    """It ends with a status of 0, 1 or 2, and one line where it refuses."""

    weight = 3

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        # What signals do is the main program's own; here it would be done once for each call.
        interrupts.watched = contextlib.nullcontext
        self.kinds = {
            "replay.json": (Replays(folder), ["verify", "replay.json"]),
            "table.npz": (
                Archives(folder),
                ["eval", "CliffWalking", "--policy", "table.npz", "--n-agents", "4", "--episodes", "4"],
            ),
            "policy.safetensors": (
                Policies(folder),
                ["eval", "CartPole", "--policy", "policy.safetensors", "--n-agents", "4", "--episodes", "4"],
            ),
            "actions.npy": (
                Arrays(folder),
                ["run", "CliffWalking", "--n-agents", "4", "--steps", "48", "--actions", "actions.npy"],
            ),
        }
        self.sample = self.kinds["replay.json"][0].sample

    def case(self, others: list[bytes], rng: Rng) -> tuple[bytes, bool]:
        self.chosen = list(self.kinds)[int(rng.integers(len(self.kinds)))]
        return self.kinds[self.chosen][0].case(others, rng)

    def warm_up(self) -> None:
        for name, (kind, _) in self.kinds.items():
            self.chosen = name
            for content in (kind.sample, kind.sample[:40]):
                with contextlib.suppress(PearlError):
                    self.read(content, False)

    def read(self, content: bytes, sealed: bool) -> None:
        path = self.folder / self.chosen
        path.write_bytes(content)
        words = [
            str(self.folder / word) if word == self.chosen else word for word in self.kinds[self.chosen][1]
        ]
        out, err = io.StringIO(), io.StringIO()
        sys.argv = ["pearl", *words]
        status: Any = 0
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                cli.main()
            except SystemExit as end:
                status = end.code or 0
        lines = err.getvalue().splitlines()
        expect(status in (0, 1, 2), f"status {status}")
        if status == 2:
            expect(len(lines) == 1 and lines[0].startswith("pearl: "), f"it says {lines}")
            raise PearlError(lines[0])
