"""A training run's folder (docs/training.md has its files), and how a run goes on after a kill.

Everything is written beside and renamed, and metrics and checkpoint belong together: whenever a run is
killed, it goes on from its last checkpoint as if nothing had happened. A folder may be somebody else's: a
checkpoint is tensors and plain data, and no code in it is ever run.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import fcntl
import io
import json
import os
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from torch.utils.tensorboard import SummaryWriter

from pearl_marl.benchmark.machine import machine
from pearl_marl.errors import ArgumentError
from pearl_marl.files import check_files, replace_file
from pearl_marl.rendering import new_figure, save_figure

CHECKPOINT, PREVIOUS = "checkpoint.pt", "checkpoint.previous.pt"
CONFIG, METRICS, POLICY, CURVE = "config.json", "metrics.csv", "policy.safetensors", "learning_curve.png"

FORMAT = 4
"""Of checkpoints; another number for every change of what trainers keep in them."""


class RunFolder:
    """The folder of one run, new or to be gone on with; ``rows`` are the metrics so far, a dict a report.

    Parameters
    ----------
    path
        The folder.
    settings
        What the run depends on, by name; JSON.

    Raises
    ------
    ArgumentError
        The folder holds a run of other settings, or cannot be written.
    """

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        self.path = path
        self.rows: list[dict[str, Any]] = []
        self._board: SummaryWriter | None = None
        self._resumed = path / CHECKPOINT
        config = path / CONFIG
        settings = json.loads(json.dumps(settings))
        check_files(path, CONFIG, METRICS, POLICY, CURVE, CHECKPOINT, PREVIOUS)
        try:
            path.mkdir(parents=True, exist_ok=True)
            theirs = _settings(config) if config.exists() else None
        except OSError as error:
            raise ArgumentError(f"--out {path} is no folder that can be written: {error.strerror}") from None
        if theirs is None:
            about = {"settings": settings, "machine": machine()}
            replace_file(config, json.dumps(about, indent=2).encode())
            return
        before, now = _flat(theirs), _flat(settings)
        # Where nobody gives evaluate_every, it follows from the iterations.
        for name in sorted({**before, **now}, key="evaluate_every".__eq__):
            if before.get(name) != now.get(name):
                raise ArgumentError(
                    f"{path} holds a run with {name} {before.get(name)!r}, not {now.get(name)!r}: "
                    "give the same settings to go on with it, or another --out"
                )

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Write the folder in the block, alone; or raise ArgumentError."""
        folder = os.open(self.path, os.O_RDONLY)
        try:
            try:
                fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ArgumentError(
                    f"another process trains in {self.path}: wait for its end, or give another --out"
                ) from None
            except OSError:  # some networks' file systems have no locks of folders
                pass
            yield
        finally:
            os.close(folder)

    def resume(self) -> dict[str, Any] | None:
        """Return the last checkpoint, and take up its metrics; ``None`` where there is none.

        Raises
        ------
        ArgumentError
            It cannot be read, is damaged, or is of another version of this package.
        """
        last, previous = self.path / CHECKPOINT, self.path / PREVIOUS
        # Killed between two renames, or the last one deleted since it was damaged.
        self._resumed = previous if previous.exists() and not last.exists() else last
        if not self._resumed.exists():
            return None
        checkpoint = self._read()
        if checkpoint.get("format") != FORMAT:
            raise ArgumentError(f"{self._resumed} is of another version of this package: give another --out")
        rows = checkpoint.pop("rows", None)
        if not isinstance(rows, list) or not all(
            isinstance(row, dict) and isinstance(row.get("agent_steps"), int) for row in rows
        ):
            raise self.damaged("and has no metrics")
        self.rows = rows
        return checkpoint

    def _read(self) -> dict[str, Any]:
        """Read tensors and plain data, of an archive whose checksums are right: PyTorch ignores those."""
        why = "and is no archive of PyTorch"
        try:
            with zipfile.ZipFile(self._resumed) as archive:
                wrong = archive.testzip()
            why = f"and the checksum of {wrong} in it is wrong"
            if wrong is None:
                why = "and holds more than tensors and plain data"  # which is refused, and not run
                checkpoint = torch.load(self._resumed, map_location="cpu", weights_only=True)
                why = "and holds no state of a training"
                if isinstance(checkpoint, dict):
                    return checkpoint
        except MemoryError:
            raise
        except Exception as error:  # whatever a reader makes of random bytes
            if isinstance(error, OSError) and error.errno != errno.EINVAL:  # of a place before the file
                raise ArgumentError(f"{self._resumed} cannot be read: {error.strerror or error}") from None
            raise self.damaged(why) from error
        raise self.damaged(why)

    def damaged(self, why: str) -> ArgumentError:
        """Return the error that refuses the checkpoint that was read, and says how to go on."""
        file, previous = self._resumed, self.path / PREVIOUS
        then = f"to go on from {previous}" if file != previous and previous.exists() else "to start over"
        return ArgumentError(
            f"{file} is damaged, or of another version of this package, {why}: delete it and give the same "
            f"command again {then}"
        )

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
        replace_file(self.path / CHECKPOINT, buffer.getvalue(), keep=self.path / PREVIOUS)
        self.write_metrics()

    def keep(self, past: Mapping[int, Any]) -> None:
        """Write policies of earlier iterations, which change no more: ``past/000010.safetensors``, ..."""
        for done, policy in past.items():
            path = self.path / "past" / f"{done:06}.safetensors"
            if not path.exists():
                path.parent.mkdir(exist_ok=True)
                policy.save(path)

    def write_metrics(self) -> None:
        """Write metrics.csv."""
        text = io.StringIO()
        names = list(dict.fromkeys(name for row in self.rows for name in row))
        writer = csv.DictWriter(text, names)
        writer.writeheader()
        writer.writerows(self.rows)
        replace_file(self.path / METRICS, text.getvalue().encode())
        if self._board is not None:
            self._board.flush()

    def draw_curve(self, title: str, goal: float | None) -> None:
        """Draw the returns of training and of evaluations over agent-steps."""
        figure = new_figure(7, 4)
        axes = figure.subplots()
        for name, label in (("train_return", "episodes in training"), ("eval_return", "best actions")):
            points = [(row["agent_steps"] / 1e6, row[name]) for row in self.rows if row.get(name) is not None]
            if points:
                axes.plot(*zip(*points, strict=True), label=label, marker=".", markersize=4)
        if goal is not None:
            axes.axhline(goal, color="grey", linestyle="--", label=f"goal: {goal:g}")
        axes.set(xlabel="agent-steps (millions)", ylabel="mean return", title=title)
        axes.grid(alpha=0.3)
        axes.legend()
        save_figure(figure, self.path / CURVE)


def _settings(config: Path) -> dict[str, Any]:
    """Return the settings in a run's config.json."""
    try:
        settings = json.loads(config.read_bytes())["settings"]
    except (ValueError, TypeError, KeyError, RecursionError):
        settings = None
    if not isinstance(settings, dict):
        raise ArgumentError(
            f"{config} is damaged, and does not say what settings the run has: choose another --out"
        )
    return settings


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    """Return a run's settings with those of its algorithm among them."""
    own = settings.get("settings")
    return {**settings, **own, "settings": None} if isinstance(own, dict) else settings
