"""A training run's folder: settings, metrics, checkpoints, the policy; and how it goes on after a kill.

::

    config.json            settings, seed, versions, machine
    metrics.csv            a row for each report; the same figures for TensorBoard beside it
    checkpoint.pt          all that the continuation depends on
    policy.safetensors     the best policy so far that was evaluated
    learning_curve.png     when the run is done

Everything is written beside and renamed, and metrics and checkpoint belong together: whenever a run is
killed, it goes on from its last checkpoint as if nothing had happened.
"""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path
from typing import Any

import torch
from torch.utils.tensorboard import SummaryWriter

from pearl_marl.benchmark.machine import machine
from pearl_marl.errors import ArgumentError
from pearl_marl.rendering import import_pyplot

FORMAT = 2
"""Of checkpoints; another number for every change of what trainers keep in them."""


class RunFolder:
    """The folder of one run, new or to be gone on with.

    Parameters
    ----------
    path
        The folder. If it holds a run already, that has to be of the same settings.
    settings
        What the run depends on, by name; JSON.

    Attributes
    ----------
    rows
        The metrics so far, a dict a report.

    Raises
    ------
    ArgumentError
        The folder holds a run of other settings, or cannot be written.
    """

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        self.path = path
        self.rows: list[dict[str, Any]] = []
        config = path / "config.json"
        settings = json.loads(json.dumps(settings))
        try:
            path.mkdir(parents=True, exist_ok=True)
            if config.exists():
                self._refuse_others(json.loads(config.read_text())["settings"], settings)
            else:
                _replace(config, json.dumps({"settings": settings, "machine": machine()}, indent=2).encode())
        except OSError as error:
            raise ArgumentError(f"--out {path} is no folder that can be written: {error.strerror}") from None
        self._board: SummaryWriter | None = None

    def _refuse_others(self, theirs: dict[str, Any], ours: dict[str, Any]) -> None:
        for name in {**theirs, **ours}:
            if theirs.get(name) != ours.get(name):
                raise ArgumentError(
                    f"{self.path} holds a run with {name} {theirs.get(name)!r}, not {ours.get(name)!r}: "
                    "give the same settings to go on with it, or another --out"
                )

    def resume(self) -> dict[str, Any] | None:
        """Return the last checkpoint, and take up its metrics; ``None`` where there is none.

        Raises
        ------
        ArgumentError
            It is of another version of this package.
        """
        file = self.path / "checkpoint.pt"
        if not file.exists():
            return None
        checkpoint: dict[str, Any] = torch.load(file, weights_only=False)
        if checkpoint.get("format") != FORMAT:
            raise ArgumentError(f"{file} is of another version of this package: give another --out")
        self.rows = checkpoint.pop("rows")
        return checkpoint

    def report(self, agent_steps: int, **metrics: float | None) -> None:
        """Note the figures of the moment; written with the next checkpoint, and for TensorBoard at once."""
        self.rows.append({"agent_steps": agent_steps, **metrics})
        if self._board is None:  # what a run that was killed reported after its checkpoint is not shown
            self._board = SummaryWriter(str(self.path), purge_step=agent_steps)
        for name, value in metrics.items():
            if value is not None:
                self._board.add_scalar(name, value, agent_steps)

    def checkpoint(self, state: dict[str, Any]) -> None:
        """Keep what the continuation depends on, and the metrics."""
        buffer = io.BytesIO()
        torch.save({**state, "rows": self.rows, "format": FORMAT}, buffer)
        _replace(self.path / "checkpoint.pt", buffer.getvalue())
        self.write_metrics()

    def write_metrics(self) -> None:
        """Write metrics.csv."""
        text = io.StringIO()
        names = list(dict.fromkeys(name for row in self.rows for name in row))
        writer = csv.DictWriter(text, names)
        writer.writeheader()
        writer.writerows(self.rows)
        _replace(self.path / "metrics.csv", text.getvalue().encode())
        if self._board is not None:
            self._board.flush()

    def draw_curve(self, title: str, goal: float | None) -> Path:
        """Draw the returns of training and of evaluations over agent-steps; return the picture's path."""
        plt = import_pyplot()
        figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
        for name, label in (("train_return", "episodes in training"), ("eval_return", "best actions")):
            points = [(row["agent_steps"] / 1e6, row[name]) for row in self.rows if row.get(name) is not None]
            if points:
                axes.plot(*zip(*points, strict=True), label=label, marker=".", markersize=4)
        if goal is not None:
            axes.axhline(goal, color="grey", linestyle="--", label=f"goal: {goal:g}")
        axes.set(xlabel="agent-steps (millions)", ylabel="mean return", title=title)
        axes.grid(alpha=0.3)
        axes.legend()
        path = self.path / "learning_curve.png"
        figure.savefig(path, dpi=120)
        plt.close(figure)
        return path


def _replace(path: Path, content: bytes) -> None:
    scratch = path.with_name(f"{path.name}.tmp")
    scratch.write_bytes(content)
    os.replace(scratch, path)
