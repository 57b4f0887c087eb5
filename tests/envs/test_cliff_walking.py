"""CliffWalking against Gymnasium's ``CliffWalking-v1``: exactly where it can be, by statistics where not."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from scipy import stats

import pearl_marl
from pearl_marl import rng
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.golden import call_reference, u8, u32
from pearl_marl.rendering import HeatMap

STATES, ACTIONS = 48, 4
PAIRS = [(state, action) for state in range(STATES) for action in range(ACTIONS)]
REWARDS = (-1, -100)
THIRDS = (0, 2**32 // 3, 2 * 2**32 // 3 + 1)
"""The least draw of each of the three outcomes of the ice."""


def oracle(slippery: bool = False) -> Any:
    return gymnasium.make("CliffWalking-v1", is_slippery=slippery).unwrapped


def spec(slippery: bool = False) -> pearl_marl.EnvSpec:
    return pearl_marl.get_spec("CliffWalking").with_options(is_slippery=slippery)


def golden_step(slippery: bool, state: int, action: int, *draw: int) -> tuple[int, float, bool]:
    """Run the golden step on scalars; return Gymnasium's ``(state, reward, terminated)``."""
    row, column = divmod(state, 12)
    words = [u8(row), u8(column), u8(action), *map(u32, draw)]
    row, column, code, terminated = call_reference(spec(slippery).positional.step, words)
    return 12 * int(row) + int(column), REWARDS[code], bool(terminated)


def native_step(slippery: bool, states: np.ndarray, actions: np.ndarray, seed: int = 0) -> Any:
    """Put slots into ``states``, step them once, and return ``(arrived, rewards, terminations)``."""
    config = BatchConfig(spec=spec(slippery), n_envs=len(states))
    device = Native().open(config)
    device.reset(seed=seed)
    snapshot = device.snapshot()
    columns = SlotMemory(config.spec, len(states), snapshot.memory).columns
    columns["row"][:], columns["column"][:] = np.divmod(states, 12)
    np.testing.assert_array_equal(device.restore(snapshot), states)
    step = device.step(actions)
    device.close()
    return step.arrivals(), step.rewards, step.terminations


def test_start() -> None:
    assert call_reference(spec().positional.initial, ()) == (3, 0)
    assert oracle().initial_state_distrib.argmax() == 36


@pytest.mark.parametrize(("state", "action"), PAIRS)
def test_golden_step(state: int, action: int) -> None:
    ((probability, *outcome),) = oracle().P[state][action]
    assert probability == 1
    assert golden_step(False, state, action) == tuple(outcome)


def test_golden_step_on_ice() -> None:
    """Every state, action and outcome; each outcome at both ends of its third of the draws."""
    table = oracle(slippery=True).P
    for state, action in PAIRS:
        for k, (_, *outcome) in enumerate(table[state][action]):
            last = (*THIRDS[1:], 2**32)[k] - 1
            for draw in (THIRDS[k], THIRDS[k] + 1, last - 1, last):
                if k and draw == THIRDS[k]:
                    draw += 1  # the border itself may fall to either side: 2**32 is no multiple of 3
                assert golden_step(True, state, action, draw) == tuple(outcome), (state, action, draw)


def test_observation() -> None:
    for state in range(STATES):
        assert call_reference(spec().positional.observe, map(u8, divmod(state, 12))) == (state,)


def test_native_step() -> None:
    """All pairs at once, many times over, so that SIMD lanes and loop remainders both take part."""
    states, actions = np.tile(np.array(PAIRS, np.uint8), (11, 1)).T
    table = oracle().P
    expected = [table[s][a][0][1:] for s, a in zip(states.tolist(), actions.tolist(), strict=True)]
    for part in (slice(None), slice(0, 192), slice(0, 2101), slice(0, 1)):
        arrived, rewards, terminations = native_step(False, states[part], actions[part].copy())
        got = list(zip(arrived.tolist(), rewards.tolist(), terminations.tolist(), strict=True))
        assert got == expected[part]


def test_native_step_on_ice() -> None:
    """Every pair under every outcome: the draws are known, so each slot's outcome is exact."""
    states, actions = np.repeat(np.array(PAIRS, np.uint8), 60, axis=0).T
    draws = rng.draws(rng.seed_words(5), np.arange(len(states)), tick=0, index=0)
    outcomes = (draws.astype(object) * 3 >> 32).astype(int)
    triples = set(zip(states.tolist(), actions.tolist(), outcomes.tolist(), strict=True))
    assert len(triples) == STATES * ACTIONS * 3, "some outcome of some pair is not in the sample"
    table = oracle(slippery=True).P
    arrived, rewards, terminations = native_step(True, states, actions.copy(), seed=5)
    for i, (state, action, k) in enumerate(zip(states.tolist(), actions.tolist(), outcomes, strict=True)):
        assert (arrived[i], rewards[i], terminations[i]) == table[state][action][k][1:]


def test_slip_frequencies() -> None:
    """From the middle of the grid the three outcomes lead to three cells; 1/3 each, by chi-squared."""
    n, start = 30_000, 17
    counts = np.zeros(STATES, int)
    for action in range(ACTIONS):
        arrived, _, _ = native_step(True, np.full(n, start), np.full(n, action, np.uint8), seed=action)
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


def episodes_of_ours(n: int, seed: int, choices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the length and return of the first episode of ``n`` agents under the random policy."""
    env = pearl_marl.parallel_env("CliffWalking", n, copy=False)
    env.reset_batch(seed=0)
    generator = np.random.default_rng(seed)
    lengths, returns = np.zeros(n, int), np.zeros(n)
    running = np.ones(n, bool)
    while running.any():
        step = env.step_batch(choices[generator.integers(len(choices), size=n)])
        lengths += running
        returns += np.where(running, step.rewards, 0)
        running &= ~step.ended
    env.close()
    return lengths, returns


def episodes_of_gymnasiums(n: int, seed: int, choices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the same from Gymnasium's ``P`` table, stepped with NumPy for all episodes at once.

    ``env.step`` itself takes minutes for this many episodes; it does nothing but look into ``P``.
    """
    table = np.array([[oracle().P[s][a][0][1:] for a in range(ACTIONS)] for s in range(STATES)])
    generator = np.random.default_rng(seed)
    states, where = np.full(n, 36), np.arange(n)
    lengths, returns = np.zeros(n, int), np.zeros(n)
    while len(where):
        new, rewards, terminated = table[states, choices[generator.integers(len(choices), size=len(where))]].T
        lengths[where] += 1
        returns[where] += rewards
        states, where = new[terminated == 0].astype(int), where[terminated == 0]
    return lengths, returns


@pytest.mark.parametrize(
    ("choices", "n"),
    [
        # Random, but twice as fond of RIGHT: a tenth of the steps to the goal.
        pytest.param([0, 1, 1, 2, 3], 20_000, id="fond of right"),
        pytest.param([0, 1, 2, 3], 6_000, id="uniform", marks=pytest.mark.slow),
    ],
)
def test_episodes_of_a_random_policy(choices: list[int], n: int) -> None:
    """Lengths and returns have one distribution, by Kolmogorov and Smirnov."""
    weighted = np.array(choices, np.uint8)
    ours, theirs = episodes_of_ours(n, 1, weighted), episodes_of_gymnasiums(n, 2, weighted)
    for mine, other in zip(ours, theirs, strict=True):
        assert stats.ks_2samp(mine, other).pvalue > 0.001


@pytest.mark.parametrize("mode", ["ansi", "rgb_array"])
def test_pictures_are_gymnasiums(mode: str) -> None:
    pytest.importorskip("pygame", reason="Gymnasium draws with pygame")
    env = pearl_marl.parallel_env("CliffWalking", 2, render_mode=mode)
    gym = gymnasium.make("CliffWalking-v1", render_mode=mode)
    env.reset(seed=0)
    gym.reset(seed=0)
    np.testing.assert_array_equal(env.render(), gym.render())
    pictures = set()
    # agent_1 walks the shortest path; agent_0 stands in its corner.
    for action in [0, *[1] * 11]:
        obs, *_ = env.step([3, action])
        gym.unwrapped.s, gym.unwrapped.lastaction = int(obs["agent_1"]), None
        picture = env.render("agent_1")
        np.testing.assert_array_equal(picture, gym.render())
        pictures.add(np.asarray(picture).tobytes())
        assert env.render() is not None
    assert len(pictures) == 12
    env.close()
    gym.close()


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
