"""Many seeds of one training at once, in one process: how much of a result is luck."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import io
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pearl_marl.base.files import check_files, replace_file
from pearl_marl.errors import ArgumentError
from pearl_marl.rendering import new_figure, save_figure
from pearl_marl.training.run import Training, TrainingRun

CURVES, SPREAD = "learning_curves.png", "spread.csv"

MOST = 1000
"""Seeds at most."""


class Population:
    """Runs of one training that differ in their seeds alone, each in a folder of its own: ``seed-0``, ...

    It has the methods of a :class:`~pearl_marl.training.run.TrainingRun`. Threads take the runs of an
    iteration; whichever does, a run's result is that of a process of its own with one thread of PyTorch.

    Parameters
    ----------
    training
        What they have in common; its seed is the first.
    folder
        Where their folders are, and at the end ``spread.csv`` and ``learning_curves.png``.
    seeds
        How many.
    evaluated, checkpoint_seconds
        Of each run.
    """

    def __init__(
        self,
        training: Training,
        folder: Path,
        seeds: int,
        evaluated: int | None = None,
        checkpoint_seconds: float = 20.0,
    ) -> None:
        if not 1 <= seeds <= MOST:
            raise ArgumentError(f"--seeds is {seeds}; it must be an integer from 1 to {MOST}")
        self.folder, self.training, first = folder, training, training.settings.seed
        self.runs = []
        for seed in range(first, first + seeds):
            settings = dataclasses.replace(training.settings, seed=seed)
            one = dataclasses.replace(training, settings=settings)
            path = folder / f"seed-{seed}"
            run = TrainingRun(one, path, None, evaluated, checkpoint_seconds)
            self.runs.append(run)
        self._threads = ThreadPoolExecutor(os.cpu_count())

    @property
    def finished(self) -> bool:
        """Whether all of them are."""
        return all(run.finished for run in self.runs)

    @property
    def done(self) -> int:
        """Iterations that each of them has done, or needs no more."""
        return min(run.iterations if run.finished else run.done for run in self.runs)

    @property
    def reached(self) -> int | None:
        """How many reached the goal, if there is one."""
        goal = self.training.goal
        return None if goal is None else sum(run.best >= goal for run in self.runs)

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Train in the block; see :meth:`TrainingRun.claimed`."""
        check_files(self.folder, CURVES, SPREAD)
        before = torch.get_num_threads()
        # PyTorch has one number of threads for all of this process.
        torch.set_num_threads(1)
        try:
            with contextlib.ExitStack() as folders:
                for run in self.runs:
                    folders.enter_context(run.claimed())
                yield
                self._write_spread()
        finally:
            torch.set_num_threads(before)

    def iterate(self) -> dict[str, Any] | None:
        """Go on by one iteration of each that is not finished; return means, if there were evaluations."""
        going_on = [run for run in self.runs if not run.finished]
        rows = [row for row in self._threads.map(TrainingRun.iterate, going_on) if row is not None]
        if not rows:
            return None
        trained = [row["train_return"] for row in rows if row["train_return"] is not None]
        return {
            "eval_return": float(np.mean([row["eval_return"] for row in rows])),
            "train_return": float(np.mean(trained)) if trained else None,
        }

    def keep(self) -> None:
        """Keep all that is needed to go on later."""
        for run in self.runs:
            run.keep()

    def spread(self) -> list[dict[str, Any]]:
        """Return least, median, mean and greatest return of the seeds for each evaluation.

        A run that ended at its goal counts with its last return.
        """
        steps = sorted({row["agent_steps"] for run in self.runs for row in run.rows})
        returns = np.array([_returns_at(run.rows, steps) for run in self.runs])
        return [
            {
                "agent_steps": at,
                "least": column.min(),
                "median": np.median(column),
                "mean": column.mean(),
                "greatest": column.max(),
            }
            for at, column in zip(steps, returns.T, strict=True)
        ]

    def _write_spread(self) -> None:
        rows = self.spread()
        text = io.StringIO()
        writer = csv.DictWriter(text, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
        replace_file(self.folder / SPREAD, text.getvalue().encode())
        figure = new_figure(7, 4)
        axes = figure.subplots()
        steps = [row["agent_steps"] / 1e6 for row in rows]
        for run in self.runs:
            own = [(row["agent_steps"] / 1e6, row["eval_return"]) for row in run.rows]
            axes.plot(*zip(*own, strict=True), color="grey", alpha=0.3, linewidth=0.7)
        axes.fill_between(steps, [row["least"] for row in rows], [row["greatest"] for row in rows], alpha=0.2)
        axes.plot(steps, [row["median"] for row in rows], label=f"median of {len(self.runs)} seeds")
        if self.training.goal is not None:
            axes.axhline(
                self.training.goal, color="grey", linestyle="--", label=f"goal: {self.training.goal:g}"
            )
        title = f"{self.runs[0].spec.name}: {self.runs[0].algorithm}, {len(self.runs)} seeds"
        axes.set(xlabel="agent-steps (millions)", ylabel="mean return of best actions", title=title)
        axes.grid(alpha=0.3)
        axes.legend()
        save_figure(figure, self.folder / CURVES)


def _returns_at(rows: Sequence[dict[str, Any]], steps: Sequence[int]) -> list[float]:
    """Return the return of a run's last evaluation until each number of steps; before its first, that."""
    returns, k = [], 0
    for at in steps:
        while k + 1 < len(rows) and rows[k + 1]["agent_steps"] <= at:
            k += 1
        returns.append(rows[k]["eval_return"])
    return returns
