"""Returns and lengths of the episodes under way, held against a loop over slots."""

from __future__ import annotations

import numpy as np
import pytest

import pearl_marl
from pearl_marl.evaluation.episodes import RunningEpisodes

N = 9


@pytest.mark.parametrize("limit", [3, 40])
def test_running_episodes(limit: int) -> None:
    env = pearl_marl.parallel_env("CartPole", N, max_cycles=limit)
    running = RunningEpisodes(N)
    generator = np.random.default_rng(0)
    finished = 0
    for seed in (0, 1):
        env.reset_batch(seed)
        running.clear()
        rewards: list[list[float]] = [[] for _ in range(N)]
        for _ in range(60):
            step = env.step_batch(generator.integers(2, size=N))
            ended = running.add(step)
            for total, reward in zip(rewards, step.rewards.tolist(), strict=True):
                total.append(reward)
            assert ended.slots.tolist() == np.flatnonzero(step.ended).tolist()
            for slot, total, length, truncated in zip(*ended, strict=True):
                assert total == sum(rewards[slot])
                assert length == len(rewards[slot])
                assert truncated == (not step.terminations[slot])
                rewards[slot] = []
            finished += ended.slots.size
    assert finished > N
