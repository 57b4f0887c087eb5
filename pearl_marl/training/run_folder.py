"""A training run's folder (docs/training.md has its files), and how a run goes on after a kill.

Everything is written beside and renamed, and metrics and checkpoint belong together: whenever a run is
killed, it goes on from its last checkpoint as if nothing had happened. A folder may be somebody else's: a
checkpoint is tensors and plain data, and no code in it is ever run.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import json
import pickletools
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch.utils.tensorboard import SummaryWriter

from pearl_marl.base.files import check_files, check_uncompressed, claimed, replace_file
from pearl_marl.checks import is_number
from pearl_marl.errors import ArgumentError, brief, one_line
from pearl_marl.evaluation.machine import machine
from pearl_marl.rendering import new_figure, save_figure
from pearl_marl.training import tracking
from pearl_marl.training.settings import TrainerSettings

CHECKPOINT, PREVIOUS = "checkpoint.pt", "checkpoint.previous.pt"
CONFIG, METRICS, POLICY, CURVE = "config.json", "metrics.csv", "policy.safetensors", "learning_curve.png"

FORMAT = 5
"""Of checkpoints; it changes with the data that trainers keep in them."""


class RunFolder:
    """The folder of one run, new or resumed; ``rows`` are the metrics so far, a dict for each report.

    Parameters
    ----------
    path
        The folder.
    settings
        What the run depends on, by name; JSON.
    kind
        The class of the algorithm's settings, by which those of an older run are understood.
    track
        A service that gets the metrics, too: see :mod:`pearl_marl.training.tracking`.
    """

    def __init__(
        self,
        path: Path,
        settings: dict[str, Any],
        kind: type[TrainerSettings] = TrainerSettings,
        track: str | None = None,
    ) -> None:
        if track is not None:
            tracking.check(track)
        self.path, self._kind = path, kind
        self.rows: list[dict[str, Any]] = []
        self._settings = json.loads(json.dumps(settings))
        self._board: SummaryWriter | None = None
        self._track = track
        self._tracker: tracking.Tracker | None = None
        self._resumed = path / CHECKPOINT

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Write the folder in the block, alone; it is made if need be.

        Raises
        ------
        ArgumentError
            Another process has it, it holds a run of other settings, or cannot be written.
        """
        check_files(self.path, CONFIG, METRICS, POLICY, CURVE, CHECKPOINT, PREVIOUS)
        with claimed(self.path, "trains"), contextlib.ExitStack() as at_end:
            config = self.path / CONFIG
            if config.exists():
                self._check(_settings(config), f"{self.path} holds")
            if self._track is not None:
                about = {k: v for k, v in self._flat(self._settings).items() if v is not None}
                self._tracker = tracking.tracker(self._track, self.path, about)
                at_end.callback(self._tracker.close)
            yield

    def write_config(self) -> None:
        """Write config.json, unless it is there."""
        config = self.path / CONFIG
        if not config.exists():
            about = {"settings": self._settings, "machine": machine()}
            replace_file(config, json.dumps(about, indent=2).encode())

    def _check(self, theirs: dict[str, Any], what_is: str) -> None:
        """Refuse settings that are not this run's."""
        before, now = self._flat(theirs), self._flat(self._settings)
        # Where nobody gives evaluate_every, it follows from the iterations.
        for name in sorted({**before, **now}, key="evaluate_every".__eq__):
            # As text: True is 1 in Python.
            if name not in before or json.dumps(before[name]) != json.dumps(now.get(name)):
                raise ArgumentError(
                    f"{what_is} a run with {one_line(name)} {brief(before.get(name))}, not "
                    f"{now.get(name)!r}: give the same settings to go on with it, or another --out"
                )

    def _flat(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Return a run's settings with those of its algorithm among them, by the names that they have now.

        An older run has the default of a setting that it does not know.
        """
        own = settings.get("settings")
        if not isinstance(own, dict):
            return settings
        successors: Mapping[str, str] = self._kind.successors()
        renamed = {successors.get(name, name): value for name, value in own.items()}
        return {**settings, **self._kind.defaults(), **renamed, "settings": None}

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
        settings, rows = checkpoint.pop("settings", None), checkpoint.pop("rows", None)
        try:
            settings = json.loads(settings)
        except (TypeError, ValueError, RecursionError):
            settings = None
        if not isinstance(settings, dict):
            raise self.damaged("and does not say what settings its run has")
        self._check(settings, f"{self._resumed} is of")
        if not isinstance(rows, list) or not all(map(_is_row, rows)):
            raise self.damaged("and has no metrics")
        self.rows[:] = rows
        return checkpoint

    def _read(self) -> dict[str, Any]:
        """Read tensors and plain data, of an archive whose checksums are right: PyTorch ignores those."""
        why = "and is no archive of PyTorch"
        try:
            with zipfile.ZipFile(self._resumed) as archive:
                why = "and holds more than tensors and plain data"  # which is refused, and not run
                check_uncompressed(archive, self._resumed.stat().st_size)
                wrong = archive.testzip()
                plain = wrong is None and _is_plain(archive)
            if wrong is not None:
                why = f"and the checksum of {brief(wrong)} in it is wrong"
            if plain:
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
        """Note the figures of the moment; written with the next checkpoint, and sent to others at once."""
        self.rows.append({"agent_steps": agent_steps, **metrics})
        if self._board is None:  # what a run that was killed reported after its checkpoint is not shown
            self._board = SummaryWriter(str(self.path), purge_step=agent_steps)
        known = {name: value for name, value in metrics.items() if value is not None}
        for name, value in known.items():
            self._board.add_scalar(name, value, agent_steps)
        if self._tracker is not None:
            self._tracker.log(agent_steps, known)

    def checkpoint(self, state: dict[str, Any]) -> None:
        """Keep what the continuation depends on, and the metrics."""
        buffer = io.BytesIO()
        kept = {**state, "rows": self.rows, "format": FORMAT, "settings": json.dumps(self._settings)}
        torch.save(kept, buffer)
        replace_file(self.path / CHECKPOINT, buffer.getvalue(), keep=self.path / PREVIOUS)
        self.write_metrics()

    def keep(self, past: Mapping[int, Any]) -> None:
        """Write policies of earlier iterations, which change no more: ``past/000010.safetensors``, ..."""
        for done, policy in past.items():
            path = self.path / "past" / f"{done:06}.safetensors"
            if not path.exists():
                policy.save(path)

    def write_metrics(self) -> None:
        """Write metrics.csv."""
        write_table(self.path / METRICS, self.rows)
        if self._board is not None:
            self._board.flush()

    def draw_curve(self, title: str, goal: float | None) -> None:
        """Draw the returns of training and of evaluations over agent-steps."""
        with curve(self.path / CURVE, title, "mean return", goal) as axes:
            for name, label in (("train_return", "episodes in training"), ("eval_return", "best actions")):
                known = [row for row in self.rows if row.get(name) is not None]
                if known:
                    points = [(row["agent_steps"] / 1e6, row[name]) for row in known]
                    axes.plot(*zip(*points, strict=True), label=label, marker=".", markersize=4)


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV, with a column for each name that any of them has."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)))
    writer.writeheader()
    writer.writerows(rows)
    replace_file(path, text.getvalue().encode())


@contextlib.contextmanager
def curve(path: Path, title: str, ylabel: str, goal: float | None) -> Iterator[Any]:
    """Yield the axes of a plot over agent-steps, in millions; the block draws, and then it is written."""
    figure = new_figure(7, 4)
    axes = figure.subplots()
    yield axes
    if goal is not None:
        axes.axhline(goal, color="grey", linestyle="--", label=f"goal: {goal:g}")
    axes.set(xlabel="agent-steps (millions)", ylabel=ylabel, title=title)
    axes.grid(alpha=0.3)
    axes.legend()
    save_figure(figure, path)


def _settings(config: Path) -> dict[str, Any]:
    """Return the settings in a run's config.json."""
    try:
        settings = json.loads(config.read_bytes())["settings"]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        settings = None
    if not isinstance(settings, dict):
        raise ArgumentError(
            f"{config} is damaged, and does not say what settings the run has: choose another --out"
        )
    return settings


_GLOBALS = re.compile(
    r"collections OrderedDict|torch._utils _rebuild_tensor_v2|torch [A-Z][A-Za-z0-9]+Storage"
)
"""Names in the pickle of tensors and plain data."""


def _is_plain(archive: zipfile.ZipFile) -> bool:
    """Return whether the pickle in a checkpoint names nothing but tensors.

    PyTorch runs no code either, but makes arrays of bytes as long as the pickle says.
    """
    pickles = [name for name in archive.namelist() if name.endswith(".pkl")]
    return len(pickles) == 1 and all(
        _GLOBALS.fullmatch(value or "") if operation.name == "GLOBAL" else operation.name not in _NAMING
        for operation, value, _ in pickletools.genops(archive.read(pickles[0]))
    )


_NAMING = "STACK_GLOBAL", "INST", "OBJ", "EXT1", "EXT2", "EXT4"
"""Other ways to name something, which PyTorch does not write."""


def _is_row(row: Any) -> bool:
    """Return whether a row of metrics is one that :meth:`RunFolder.report` notes."""
    return (
        isinstance(row, dict)
        and all(isinstance(name, str) and name.isidentifier() for name in row)
        and type(row.get("agent_steps")) is int
        and all(value is None or is_number(value) for value in row.values())
        and is_number(row.get("eval_return"))
        and is_number(row.get("seconds"))
    )
