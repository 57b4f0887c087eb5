"""CliffWalking against Gymnasium's ``CliffWalking-v1``: exactly where it can be, by statistics where not."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from scipy import stats

import pearl_marl
from pearl_marl.golden import call_reference, u8
from pearl_marl.porting.oracle import Rules
from pearl_marl.rendering import HeatMap
from pearl_marl.testing import assert_same_play, compare_pictures, compare_steps, first_episodes, step_from

from .fixed import drawing
from .tabular import compare_draws, table_episodes, table_oracle

STATES, ACTIONS = 48, 4
PAIRS = [(state, action) for state in range(STATES) for action in range(ACTIONS)]
THIRDS = (0, 2**32 // 3, 2 * 2**32 // 3 + 1)
"""The least draw of each of the three outcomes of the ice."""


def oracle(slippery: bool = False) -> Any:
    return gymnasium.make("CliffWalking-v1", is_slippery=slippery).unwrapped


def spec(slippery: bool = False) -> pearl_marl.EnvSpec:
    return pearl_marl.get_spec("CliffWalking").with_options(is_slippery=slippery)


def table(slippery: bool) -> Rules:
    """Return ``P``; of the ice, the outcome is the third that the draw is in."""

    def third(draws: np.ndarray) -> np.ndarray:
        return (draws.astype(object) * 3 >> 32).astype(int)[:, 0] if slippery else np.zeros(len(draws), int)

    return table_oracle(oracle(slippery), lambda state: 12 * state[0] + state[1], third)


def test_start() -> None:
    assert call_reference(spec().positional.initial, ()) == (3, 0)
    assert oracle().initial_state_distrib.argmax() == 36


def test_every_step_on_ice() -> None:
    """Every state, action and outcome; each outcome at both ends of its third of the draws."""
    for k, first in enumerate(THIRDS):
        last = (*THIRDS[1:], 2**32)[k] - 1
        # The border itself may fall to either side: 2**32 is no multiple of 3.
        draws = (first + (k > 0), first + 1, last - 1, last)
        states, actions = np.array(PAIRS).T
        compare_draws(spec(True), table(True), list(np.divmod(states, 12)), actions, draws)


def test_observation() -> None:
    for state in range(STATES):
        assert call_reference(spec().positional.observe, map(u8, divmod(state, 12))) == (state,)


@pytest.mark.parametrize(("slippery", "times"), [(False, 11), (True, 60)])
def test_every_step(slippery: bool, times: int) -> None:
    """Every state and action many times, on the CPU device, too: SIMD lanes and loop remainders take part."""
    states, actions = np.tile(np.array(PAIRS), (times, 1)).T
    for part in (slice(None), slice(0, 192), slice(0, 2101), slice(0, 1)):
        words = list(np.divmod(states[part], 12))
        move = compare_steps(spec(slippery), table(slippery), words, actions[part], seed=5)
        if slippery and part == slice(None):
            outcomes = move.draws[:, 0].astype(object) * 3 >> 32
            triples = set(zip(states.tolist(), actions.tolist(), outcomes.tolist(), strict=True))
            assert len(triples) == STATES * ACTIONS * 3, "some outcome of some pair is not in the sample"


def test_slip_frequencies() -> None:
    """From the middle of the grid the three outcomes lead to three cells; 1/3 each, by chi-squared."""
    n, start = 30_000, 17
    counts = np.zeros(STATES, int)
    for action in range(ACTIONS):
        words = [np.full(n, word) for word in divmod(start, 12)]
        arrived = step_from(spec(True), words, np.full(n, action, np.uint8), seed=action).arrivals()
        cells, seen = np.unique(arrived, return_counts=True)
        assert set(cells) == {new for _, new, _, _ in oracle(True).P[start][action]}
        assert stats.chisquare(seen).pvalue > 0.001
        counts += np.bincount(arrived, minlength=STATES)
    around = [start - 12, start - 1, start + 1, start + 12]
    assert counts[around].sum() == 4 * n
    assert stats.chisquare(counts[around]).pvalue > 0.001


def policy(observations: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Follow the shortest path three times out of four, so that episodes end; fall off now and then."""
    row, column = np.divmod(observations, 12)
    shortest = np.where((row == 3) & (column < 11), 0, np.where(column < 11, 1, 2))
    anything = generator.integers(4, size=len(observations))
    return np.where(generator.random(len(observations)) < 0.75, shortest, anything)


@pytest.mark.parametrize("limit", [None, 17])
@pytest.mark.parametrize("mode", AutoresetMode, ids=lambda mode: mode.name)
def test_vector_env_equals_gymnasiums(mode: AutoresetMode, limit: int | None) -> None:
    n, generator = 12, np.random.default_rng(7)
    theirs = SyncVectorEnv(
        [lambda: gymnasium.make("CliffWalking-v1", max_episode_steps=limit)] * n, autoreset_mode=mode
    )
    ours = pearl_marl.make_vec("CliffWalking", n, autoreset_mode=mode, max_cycles=limit)
    assert ours.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"]
    for ours_space, theirs_space in (
        (ours.observation_space, theirs.observation_space),
        (ours.action_space, theirs.action_space),
        (ours.single_observation_space, theirs.single_observation_space),
        (ours.single_action_space, theirs.single_action_space),
    ):
        assert ours_space == theirs_space
    obs, _ = ours.reset(seed=0)
    np.testing.assert_array_equal(obs, theirs.reset(seed=0)[0])
    assert obs.dtype == theirs.observation_space.dtype
    terminated, truncated = 0, 0
    for t in range(400):
        actions = policy(obs, generator)
        a, b = ours.step(actions), theirs.step(actions)
        for name, mine, other in zip(
            ("obs", "reward", "termination", "truncation"), a[:4], b[:4], strict=True
        ):
            np.testing.assert_array_equal(mine, other, f"{name} at step {t}")
        ended = a[2] | a[3]
        terminated, truncated = terminated + a[2].sum(), truncated + a[3].sum()
        assert ("final_obs" in a[4]) == ("final_obs" in b[4])
        if "final_obs" in b[4]:
            np.testing.assert_array_equal(a[4]["_final_obs"], b[4]["_final_obs"])
            np.testing.assert_array_equal(a[4]["final_obs"], b[4]["final_obs"])
            np.testing.assert_array_equal(a[4]["_final_info"], b[4]["_final_info"])
        obs = a[0]
        if mode is AutoresetMode.DISABLED and ended.any():
            mask = {"reset_mask": ended.copy()}
            obs, _ = ours.reset(options=dict(mask))
            np.testing.assert_array_equal(obs, theirs.reset(options=dict(mask))[0])
    assert terminated > 5 * n
    assert truncated > (5 * n if limit else -1)
    ours.close()
    theirs.close()


@pytest.mark.parametrize(
    ("choices", "n"),
    [
        # Random, but twice as fond of RIGHT: a tenth of the steps to the goal.
        pytest.param([0, 1, 1, 2, 3], 20_000, id="fond of right"),
        pytest.param([0, 1, 2, 3], 6_000, id="uniform", marks=pytest.mark.exhaustive),
    ],
)
def test_episodes_of_a_random_policy(choices: list[int], n: int) -> None:
    """Lengths and returns have one distribution, by Kolmogorov and Smirnov."""

    def weighted(observations: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        return np.array(choices, np.uint8)[generator.integers(len(choices), size=len(observations))]

    theirs = table_episodes(oracle(), n, 2, weighted, limit=10**6)
    assert_same_play(first_episodes(spec(), n, 1, weighted), theirs)


@pytest.mark.parametrize("mode", ["ansi", "rgb_array"])
def test_pictures_are_gymnasiums(mode: str) -> None:
    env = drawing(spec(), mode)

    def drawn(state: Any) -> Any:
        env.unwrapped.s, env.unwrapped.lastaction = 12 * state.row + state.column, None
        return env.render()

    # The shortest path.
    compare_pictures(spec(), mode, drawn, [0, *[1] * 11], different=12)


def test_heat_map_counts_arrivals(tmp_path: Any) -> None:
    env = pearl_marl.parallel_env("CliffWalking", 100)
    env.reset_batch(seed=0)
    heat = HeatMap(env.spec)
    path = [0, *[1] * 11, 2]
    for action in path:
        heat.add(env.step_batch(np.full(100, action)))
    expected = np.zeros((4, 12), int)
    expected[2, :] = expected[3, 11] = 100
    np.testing.assert_array_equal(heat.counts, expected)
    lines = heat.text().splitlines()
    assert [len(line) for line in lines] == [24] * 4
    assert lines[2] == "█" * 24
    assert lines[3] == " " * 22 + "██"
    heat.save(tmp_path / "new" / "heat.png")
    assert (tmp_path / "new" / "heat.png").read_bytes().startswith(b"\x89PNG")
    env.close()
