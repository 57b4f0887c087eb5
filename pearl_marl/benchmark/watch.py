"""The clock of a training. It stands still while the policy is evaluated, for all trainers alike."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.evaluation.run import Evaluation
from pearl_marl.spec import EnvSpec

EVALUATED = 200
"""Agents whose first episodes are an evaluation, on our environment."""


class Watch:
    """Notes how far a training is, and says when it is over.

    A trainer calls ``start`` when all is made and compiled, then the watch itself after every iteration, with
    the number of agent-steps so far and a function from observations to the best actions.

    Attributes
    ----------
    points
        Seconds of training and agent-steps, after every ``task.every`` iterations.
    reached, reached_steps
        The seconds and the agent-steps after which the goal was reached, or None.
    started
        When it began, by ``time.perf_counter``.
    best
        The best mean return of all evaluations; None without any.
    """

    def __init__(self, task: TrainingTask) -> None:
        self.task = task
        self.points: list[tuple[float, int]] = []
        self.reached: float | None = None
        self.reached_steps: int | None = None
        self.best: float | None = None
        self.iterations = 0
        self.started = self._began = 0.0

    def start(self) -> None:
        """Begin to count seconds."""
        self.started = self._began = time.perf_counter()

    def __call__(self, agent_steps: int, choose: Callable[[Any], Any]) -> bool:
        """Note an iteration; return whether the training is over."""
        self.iterations += 1
        if self.iterations % self.task.every:
            return False
        stopped = time.perf_counter()
        seconds = stopped - self._began
        self.points.append((seconds, agent_steps))
        if self.task.goal is not None and self.reached is None:
            mean = mean_return(self.task.spec, choose)
            self.best = mean if self.best is None else max(self.best, mean)
            if mean >= self.task.goal:
                self.reached, self.reached_steps = seconds, agent_steps
        self._began += time.perf_counter() - stopped
        satisfied = self.task.goal is None or self.reached is not None
        return seconds >= self.task.seconds or (satisfied and self.iterations >= self.task.least)

    @property
    def rate(self) -> float:
        """Agent-steps a second, of all but what came before the first point: caches are cold then."""
        (first, before), (last, steps) = self.points[0], self.points[-1]
        return (steps - before) / (last - first) if steps > before else steps / last


def mean_return(spec: EnvSpec, choose: Callable[[Any], Any], limit: int | None = None) -> float:
    """Return the mean of :data:`EVALUATED` episodes; ``limit`` is for those without a time limit."""
    evaluation = Evaluation(spec, choose, EVALUATED, seed=1, max_cycles=spec.max_cycles or limit)
    for _ in evaluation.run():
        pass
    return float(evaluation.returns.mean())
