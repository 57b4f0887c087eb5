"""What a step takes for each agent as agents grow more, beside writing its results alone."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from pearl_marl import wrappers
from pearl_marl.batch.actions import random_actions
from pearl_marl.interfaces.parallel import parallel_env

COUNTS = 43_008, 344_064, 1_000_000, 10_000_000

SUBJECTS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "CliffWalking": ("CliffWalking", lambda env: env),
    "CliffWalking, clip_reward_v0": ("CliffWalking", lambda env: wrappers.clip_reward_v0(env, -1, 1)),
    "LevelBasedForaging": ("LevelBasedForaging", lambda env: env),
}
"""What is measured: an environment, and what is put around it."""


class Point(NamedTuple):
    """One subject at one size, in nanoseconds for each agent."""

    subject: str
    n_agents: int
    step: float
    """``step_batch`` with ``copy=False``, the same random actions again and again."""
    write: float
    """Filling the arrays of its results, by one thread."""


def growth(rounds: int, counts: tuple[int, ...] = COUNTS) -> Iterator[Point]:
    """Measure every subject at every size; of so many rounds the median counts."""
    for subject, (env_id, wrap) in SUBJECTS.items():
        for count in counts:
            yield _point(subject, env_id, wrap, count, rounds)
            gc.collect()  # an environment is large, and may refer to itself


def _point(subject: str, env_id: str, wrap: Callable[[Any], Any], n: int, rounds: int) -> Point:
    env = wrap(parallel_env(env_id, n, copy=False))
    env.reset_batch(seed=0)
    masks = env.action_masks
    actions = random_actions(env.unwrapped.spec, np.random.default_rng(0), n, masks)
    steps = [_timed(lambda: env.step_batch(actions)) for _ in range(rounds + 3)][3:]
    arrays = [np.empty_like(array) for array in env.step_batch(actions).arrays]

    def write() -> None:
        for array in arrays:
            array.fill(1)

    writes = [_timed(write) for _ in range(rounds + 1)][1:]
    env.close()
    return Point(subject, n, median(steps) / n * 1e9, median(writes) / n * 1e9)


def _timed(call: Callable[[], Any]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began
