"""Many seeds of one training at once, in one process: how much of a result is luck."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.base.files import check_files
from pearl_marl.errors import ArgumentError
from pearl_marl.policies.second_thread import torch_threads
from pearl_marl.training.run import Training, TrainingRun
from pearl_marl.training.run_folder import curve, write_table
from pearl_marl.training.trainer import DivergedError

CURVES, SPREAD = "learning_curves.png", "spread.csv"

MOST = 1000
"""Seeds at most."""


class Population:
    """Runs of one training that differ in their seeds alone, each in a folder of its own: ``seed-0``, ...

    It has the methods of a :class:`~pearl_marl.training.run.TrainingRun`. Threads take the runs of an
    iteration, and each run has the result of a process of its own with one thread of PyTorch. Where a run
    diverges, the others go on.

    Parameters
    ----------
    training
        What they have in common; its seed is the first.
    folder
        Where their folders are, and at the end ``spread.csv`` and ``learning_curves.png``.
    seeds
        How many.
    evaluated
        Agents whose first episodes are an evaluation of each run.

    Attributes
    ----------
    diverged
        Why runs cannot go on, by their seeds. The spread is without them.
    """

    def __init__(self, training: Training, folder: Path, seeds: int, evaluated: int | None = None) -> None:
        if not 1 <= seeds <= MOST:
            raise ArgumentError(f"--seeds is {seeds}; it must be an integer from 1 to {MOST}")
        self.folder, self.training, first = folder, training, training.settings.seed
        self.runs: list[TrainingRun] = []
        self.diverged: dict[int, str] = {}
        self._threads: ThreadPoolExecutor | None = None
        for seed in range(first, first + seeds):
            settings = dataclasses.replace(training.settings, seed=seed)
            one = dataclasses.replace(training, settings=settings)
            path = folder / f"seed-{seed}"
            run = TrainingRun(one, path, None, evaluated)
            need = run.trainer.need
            need.check(seeds if need.lasting else min(seeds, os.cpu_count() or 1))
            self.runs.append(run)

    @property
    def sound(self) -> list[TrainingRun]:
        """The runs that have not diverged."""
        return [run for run in self.runs if run.seed not in self.diverged]

    @property
    def finished(self) -> bool:
        """Whether all of them are, or have diverged."""
        return all(run.finished for run in self.sound)

    @property
    def done(self) -> int:
        """Iterations that each of them has done, or needs no more."""
        return min(run.iterations if run.finished else run.done for run in self.sound)

    @property
    def reached(self) -> int | None:
        """How many reached the goal, if there is one."""
        goal = self.training.goal
        return None if goal is None else sum(run.best >= goal for run in self.sound)

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Train in the block; see :meth:`TrainingRun.claimed`."""
        check_files(self.folder, CURVES, SPREAD)
        self._check_others()
        # PyTorch has one number of threads for all of this process.
        with torch_threads(1), contextlib.ExitStack() as folders:
            for run in self.runs:
                folders.enter_context(run.claimed())
            self._threads = ThreadPoolExecutor(os.cpu_count())
            # Which waits for runs that are in an iteration, before their folders are free for others.
            folders.callback(self._threads.shutdown, cancel_futures=True)
            yield
            self._write_spread()

    def _check_others(self) -> None:
        """Refuse a folder that has runs of other seeds, which its spread would be without."""
        own = {run.folder.path.name for run in self.runs}
        others = sorted(path.name for path in self.folder.glob("seed-*") if path.name not in own)
        if others:
            raise ArgumentError(
                f"{self.folder} holds {others[0]}, and this training has the seeds {self.runs[0].seed} to "
                f"{self.runs[-1].seed}: give the seeds that it had, or another --out"
            )

    def iterate(self) -> dict[str, Any] | None:
        """Go on by one iteration of each that is not finished; return means, if there were evaluations.

        Raises
        ------
        ArgumentError
            All have diverged.
        """
        assert self._threads is not None, "iterate() goes into a block of claimed()"
        going_on = [run for run in self.sound if not run.finished]
        results = [self._threads.submit(run.iterate) for run in going_on]
        wait(results)
        rows = []
        for run, result in zip(going_on, results, strict=True):
            try:
                row = result.result()
            except DivergedError as error:
                self.diverged[run.seed] = str(error)
            else:
                rows += [row] if row is not None else []
        if not self.sound:
            seed, why = next(iter(self.diverged.items()))
            raise ArgumentError(f"no seed can go on; of seed {seed}, {why}")
        if not rows:
            return None
        trained = [row["train_return"] for row in rows if row["train_return"] is not None]
        return {
            "eval_return": float(np.mean([row["eval_return"] for row in rows])),
            "train_return": float(np.mean(trained)) if trained else None,
        }

    def keep(self) -> None:
        """Keep all that is needed to go on later."""
        for run in self.sound:
            run.keep()

    def spread(self) -> list[dict[str, Any]]:
        """Return least, median, mean and greatest return of the seeds for each evaluation.

        A run that ended at its goal counts with its last return; one that has diverged does not count.
        """
        steps = sorted({row["agent_steps"] for run in self.sound for row in run.rows})
        returns = np.array([_returns_at(run.rows, steps) for run in self.sound])
        return [
            {
                "agent_steps": at,
                "least": column.min(),
                "median": np.median(column),
                "mean": column.mean(),
                "greatest": column.max(),
                "seeds": len(column),
                "diverged": len(self.diverged),
            }
            for at, column in zip(steps, returns.T, strict=True)
        ]

    def _write_spread(self) -> None:
        rows = self.spread()
        write_table(self.folder / SPREAD, rows)
        title = f"{self.runs[0].spec.name}: {self.runs[0].algorithm}, {len(self.sound)} seeds"
        with curve(self.folder / CURVES, title, "mean return of best actions", self.training.goal) as axes:
            for run in self.sound:
                own = [(row["agent_steps"] / 1e6, row["eval_return"]) for row in run.rows]
                axes.plot(*zip(*own, strict=True), color="grey", alpha=0.3, linewidth=0.7)
            columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
            steps = columns["agent_steps"] / 1e6
            axes.fill_between(steps, columns["least"], columns["greatest"], alpha=0.2)
            axes.plot(steps, columns["median"], label=f"median of {len(self.sound)} seeds")


def _returns_at(rows: Sequence[dict[str, Any]], steps: Sequence[int]) -> list[float]:
    """Return the return of a run's last evaluation until each number of steps; before its first, that."""
    evaluations = np.searchsorted([row["agent_steps"] for row in rows], steps, side="right") - 1
    return [rows[k]["eval_return"] for k in np.maximum(evaluations, 0)]
