"""FrozenLake against Gymnasium's ``FrozenLake-v1``: exactly where it can be, by statistics where not."""

from __future__ import annotations

import itertools
import json
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.toy_text.frozen_lake import MAPS, generate_random_map
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import pearl_marl
from pearl_marl.errors import ArgumentError, SavedStateError
from pearl_marl.golden import call_reference, u8, u32
from pearl_marl.porting.oracle import Rules
from pearl_marl.rendering import HeatMap
from pearl_marl.testing import compare_pictures, compare_steps, first_episodes, step_from

from ..sampling import sampled
from .fixed import drawing
from .tabular import compare_draws, first_observations, table_of, table_oracle

ACTIONS = 4
THREE_STARTS = ["SFHSFGS", "GHSFFFF", "FSFHFHS"]
LAKES = [
    {},
    {"map_name": "8x8"},
    {"desc": THREE_STARTS},
    {"desc": ["SG"], "success_rate": 0.25},
    {"success_rate": 0},
    {"success_rate": 1},
    {"success_rate": 1 - 2**-40},
    {"map_name": "8x8", "success_rate": 0.8, "reward_schedule": (10, -5.5, -0.25)},
    {"desc": THREE_STARTS, "is_slippery": False, "reward_schedule": (0, 1, 2)},
    {"desc": ["FFFFFFFF"] * 7 + ["FFFFHGSF"]},
]
spec = pearl_marl.get_spec("FrozenLake").with_options


def oracle(**options: Any) -> Any:
    return gymnasium.make("FrozenLake-v1", **options).unwrapped


def pairs(gym: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return every state that an episode can go on from, with every action.

    A goal or a hole ends the episode, so nothing is ever stepped from there.
    """
    goes_on = np.flatnonzero(~np.isin(gym.desc, [b"G", b"H"]).ravel())
    return np.repeat(goes_on, ACTIONS), np.tile(np.arange(ACTIONS), len(goes_on))


def outcome_draws(ours: pearl_marl.EnvSpec) -> list[tuple[int, int]]:
    """Return the first and the last draw of each turn of the ice: back, not at all, on."""
    back = round((1 - ours.options["success_rate"]) / 2 * 2**32)
    edges = [0, back, 2**32 - back, 2**32]
    return [(first, after - 1) for first, after in itertools.pairwise(edges)]


def table(gym: Any, ours: pearl_marl.EnvSpec) -> Rules:
    """Return ``P``, of which the draw decides on the turn of the ice."""
    several = table_of(gym).probability.shape[2] > 1

    def outcome(draws: np.ndarray) -> np.ndarray:
        if ours.step_draws:
            return np.searchsorted([last for _, last in outcome_draws(ours)], draws[:, 0])
        return np.full(len(draws), int(several))

    return table_oracle(gym, lambda state: gym.ncol * state[0].astype(int) + state[1], outcome)


def check_every_transition(options: dict[str, Any]) -> int:
    """Compare every state, action and outcome with ``P``; return how many outcomes that were."""
    gym, ours = oracle(**options), spec(**options)
    probability, (states, actions) = table_of(gym).probability, pairs(gym)
    draws = [0]
    if ours.step_draws:
        draws = []
        for k, ends in enumerate(outcome_draws(ours)):
            share = (ends[1] - ends[0] + 1) / 2**32
            assert np.abs(share - probability[states, actions, k]).max() <= 2**-32
            draws += ends if (probability[states, actions, k] > 2**-32).all() else ()
    compare_draws(ours, table(gym, ours), list(np.divmod(states, gym.ncol)), actions, draws)
    return len(draws) * len(states)


@pytest.mark.parametrize("options", LAKES, ids=str)
def test_golden_step(options: dict[str, Any]) -> None:
    assert check_every_transition(options) > 0


@st.composite
def lakes(draw: st.DrawFn) -> list[str]:
    columns = draw(st.integers(2, 8))
    rows = draw(st.lists(st.text("SFHG", min_size=columns, max_size=columns), min_size=1, max_size=8))
    row, column = draw(st.integers(0, len(rows) - 1)), draw(st.integers(0, columns - 1))
    rows[row] = rows[row][:column] + "S" + rows[row][column + 1 :]
    return rows


@settings(max_examples=40)
@given(lakes(), st.booleans(), st.floats(0, 1))
def test_golden_step_of_any_map(desc: list[str], is_slippery: bool, success_rate: float) -> None:
    assert check_every_transition({"desc": desc, "is_slippery": is_slippery, "success_rate": success_rate})


def test_scalars_do_what_arrays_do() -> None:
    draws = (0, 2**32 // 3, 2**31, 2**32 - 1)
    cases = np.array([(r, c, a, d) for r in range(8) for c in range(8) for a in range(4) for d in draws])
    ours = spec(map_name="8x8").positional
    whole = call_reference(ours.step, [*map(u8, cases.T[:3]), u32(cases[:, 3])])
    for i, (row, column, action, draw) in enumerate(cases.tolist()):
        one = call_reference(ours.step, [u8(row), u8(column), u8(action), u32(draw)])
        assert one == tuple(result[i] for result in whole)


@pytest.mark.parametrize("options", LAKES, ids=str)
def test_starts_and_observations(options: dict[str, Any]) -> None:
    """Each start is drawn by a share of the draws that is off by less than one draw."""
    gym, ours = oracle(**options), spec(**options)
    starts = np.flatnonzero(gym.initial_state_distrib)
    assert ours.reset_draws == (len(starts) > 1)
    for k, cell in enumerate(starts.tolist()):
        for draw in (-(-k * 2**32 // len(starts)), -(-(k + 1) * 2**32 // len(starts)) - 1):
            state = call_reference(ours.positional.initial, [u32(draw)][: ours.reset_draws])
            assert call_reference(ours.positional.observe, state) == (cell,)
    cells = np.arange(gym.nrow * gym.ncol)
    np.testing.assert_array_equal(
        call_reference(ours.positional.observe, map(u8, np.divmod(cells, gym.ncol)))[0], cells
    )


def test_distribution_of_starts() -> None:
    gym = oracle(desc=THREE_STARTS)
    starts = np.flatnonzero(gym.initial_state_distrib)
    seen = np.bincount(first_observations(spec(desc=THREE_STARTS), 30_000, 3), minlength=21)
    assert seen[starts].sum() == 30_000
    p = stats.chisquare(seen[starts], 30_000 * gym.initial_state_distrib[starts]).pvalue
    print(f"starts: p = {p:.3f}")
    assert p > 0.001


@pytest.mark.parametrize("options", sampled([LAKES[k] for k in (0, 2, 5, 7, 8)], [LAKES[2]]), ids=str)
def test_many_steps(options: dict[str, Any]) -> None:
    """Every pair many times over, on the CPU device, too."""
    gym, ours = oracle(**options), spec(**options)
    states, actions = (np.resize(part, 2048 * 2 + 101) for part in pairs(gym))
    move = compare_steps(ours, table(gym, ours), list(np.divmod(states, gym.ncol)), actions, seed=5)
    if ours.step_draws:
        outcomes = np.searchsorted([last for _, last in outcome_draws(ours)], move.draws[:, 0])
        assert len(np.unique(outcomes)) == (table_of(gym).probability[states[0], 0] > 2**-32).sum()


@pytest.mark.parametrize("success_rate", [1 / 3, 0.8])
def test_slip_frequencies(success_rate: float) -> None:
    """From the middle of a lake without holes the three outcomes lead to three cells."""
    options = {"desc": ["FFF", "FFF", "FFS"], "success_rate": success_rate}
    table, n = table_of(oracle(**options)), 30_000
    for action in range(ACTIONS):
        middle = [np.ones(n, int), np.ones(n, int)]
        actions = np.full(n, action, np.uint8)
        arrived = step_from(spec(**options), middle, actions, action).arrivals()
        seen = np.bincount(arrived, minlength=9)[table.state[4, action]]
        assert seen.sum() == n
        p = stats.chisquare(seen, n * table.probability[4, action]).pvalue
        print(f"success_rate {success_rate:.2f}, action {action}: p = {p:.3f}")
        assert p > 0.001


@pytest.mark.parametrize(
    "options", sampled([{}, {"map_name": "8x8"}, {"desc": ["FFG", "HSF"]}], [{}]), ids=str
)
@pytest.mark.parametrize("mode", AutoresetMode, ids=lambda mode: mode.name)
def test_vector_env_equals_gymnasiums(mode: AutoresetMode, options: dict[str, Any]) -> None:
    """Without ice nothing is random, and whole runs have to be the same, time limit included."""
    n, generator = 8, np.random.default_rng(7)
    name = "FrozenLake8x8-v1" if "map_name" in options else "FrozenLake-v1"
    theirs = SyncVectorEnv(
        [lambda: gymnasium.make(name, is_slippery=False, **options)] * n, autoreset_mode=mode
    )
    ours = pearl_marl.make_vec("FrozenLake", n, autoreset_mode=mode, is_slippery=False, **options)
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.single_action_space == theirs.single_action_space
    np.testing.assert_array_equal(ours.reset(seed=0)[0], theirs.reset(seed=0)[0])
    ends = np.zeros(2, int)
    for t in range(450):
        # Every other slot only walks up and down at the left edge, where it meets its time limit.
        actions = np.where(np.arange(n) % 2, generator.integers(4, size=n), generator.choice([0, 3], n))
        a, b = ours.step(actions), theirs.step(actions)
        for name, mine, other in zip(
            ("obs", "reward", "termination", "truncation"), a[:4], b[:4], strict=True
        ):
            np.testing.assert_array_equal(mine, other, f"{name} at step {t}")
        if "final_obs" in b[4]:
            np.testing.assert_array_equal(a[4]["final_obs"], b[4]["final_obs"])
        ends += a[2].sum(), a[3].sum()
        ended = a[2] | a[3]
        if mode is AutoresetMode.DISABLED and ended.any():
            masks = {"reset_mask": ended.copy()}, {"reset_mask": ended.copy()}
            np.testing.assert_array_equal(ours.reset(options=masks[0])[0], theirs.reset(options=masks[1])[0])
    assert (ends >= n).all()
    ours.close()
    theirs.close()


@pytest.mark.parametrize(
    "options",
    [{}, {"map_name": "8x8"}, {"is_slippery": False}, {"desc": THREE_STARTS, "success_rate": 0.7}],
    ids=str,
)
def test_episodes_of_a_random_policy(options: dict[str, Any]) -> None:
    """Length and end of 30,000 episodes, against their exact distribution by dynamic programming on ``P``."""
    gym, ours = oracle(**options), spec(**options, reward_schedule=(3, 2, 0))
    n, limit = 30_000, ours.max_cycles
    assert limit is not None
    table = table_of(oracle(**options, reward_schedule=(3, 2, 0)))
    there, reaches = gym.initial_state_distrib, np.zeros((limit, 4))  # by time and by return
    for t in range(limit):
        weights = there[:, None, None] * table.probability / ACTIONS
        for value in (2, 3):
            reaches[t, value] = weights[table.terminated & (table.reward == value)].sum()
        moved = np.bincount(table.state.ravel(), (weights * ~table.terminated).ravel(), len(there))
        there = moved
    reaches[-1, 0] = there.sum()
    assert reaches.sum() == pytest.approx(1)

    def policy(observations: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        return generator.integers(ACTIONS, size=n, dtype=np.uint8)

    lengths, returns = first_episodes(ours, n, 1, policy)
    seen = np.zeros((limit, 4))
    np.add.at(seen, (lengths - 1, returns.astype(int)), 1)
    assert not seen[reaches == 0].any()
    common = n * reaches >= 8
    observed = np.append(seen[common], seen[~common].sum())
    expected = np.append(n * reaches[common], n * reaches[~common].sum())
    if expected[-1] < 1e-6:
        observed, expected = observed[:-1], expected[:-1]
    p = stats.chisquare(observed, expected).pvalue
    print(f"{options}: {len(expected)} kinds of episodes, p = {p:.3f}")
    assert p > 0.001


@pytest.mark.parametrize("options", [{}, {"map_name": "8x8"}, {"desc": ["SHG", "FFF"]}], ids=str)
@pytest.mark.parametrize("mode", ["ansi", "rgb_array"])
def test_pictures_are_gymnasiums(mode: str, options: dict[str, Any]) -> None:
    env = drawing(spec(**options), mode)

    def drawn(state: Any) -> Any:
        env.unwrapped.s, env.unwrapped.lastaction = env.unwrapped.ncol * state.row + state.column, None
        return env.render()

    compare_pictures(spec(**options), mode, drawn, [1, *[2] * 19], different=3, device="reference")


def test_heat_map_counts_arrivals() -> None:
    desc = ["SFF", "FFF"]
    env = pearl_marl.parallel_env("FrozenLake", 100, device="reference", desc=desc, is_slippery=False)
    env.reset_batch(seed=0)
    heat = HeatMap(env.spec)
    for action in (2, 2, 1, 1):
        heat.add(env.step_batch(np.full(100, action)))
    np.testing.assert_array_equal(heat.counts, [[0, 100, 100], [0, 0, 200]])
    env.close()


def test_maps_and_limits_are_gymnasiums() -> None:
    for name, gym_id in (("4x4", "FrozenLake-v1"), ("8x8", "FrozenLake8x8-v1")):
        gym = gymnasium.make(gym_id)
        ours = spec(map_name=name)
        assert gym.spec is not None
        assert ours.max_cycles == gym.spec.max_episode_steps
        assert ours.observation_space == gym.observation_space
        given = spec(desc=MAPS[name])
        assert ours.behaviour == given.behaviour
    assert spec(map_name="8x8").with_options(desc=["SG"]).max_cycles == 100
    assert spec().options == {
        "desc": None,
        "map_name": "4x4",
        "is_slippery": True,
        "success_rate": 1 / 3,
        "reward_schedule": [1, 0, 0],
    }


def test_random_maps_of_gymnasium_are_taken() -> None:
    for seed in range(3):
        assert check_every_transition({"desc": generate_random_map(8, seed=seed)}) > 0


def test_saved_states_know_their_map() -> None:
    options = {"desc": tuple(THREE_STARTS), "success_rate": 0.7, "reward_schedule": (5, 4, 3)}
    device = {"device": "reference"}
    env = pearl_marl.parallel_env("FrozenLake", 9, **device, **options)
    env.reset_batch(seed=0)
    for _ in range(5):
        env.step_batch(np.full(9, 2))
    saved = env.save_state()
    again = pearl_marl.parallel_env("FrozenLake", 9, **device, **json.loads(json.dumps(options)))
    again.load_state(saved)
    np.testing.assert_array_equal(env.step_batch(np.full(9, 1)).obs, again.step_batch(np.full(9, 1)).obs)
    options["desc"] = [*THREE_STARTS[:2], "FSFFFHS"]
    other = pearl_marl.parallel_env("FrozenLake", 9, **device, **options)
    with pytest.raises(SavedStateError, match="FSFFFHS"):
        other.load_state(saved)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"map_name": "5x5"}, "map_name is '5x5'; possible are '4x4' and '8x8'; or give a map of your own"),
        ({"map_name": None}, "map_name is None.*generate_random_map"),
        ({"map_name": ["4x4"]}, "map_name is"),
        ({"desc": "SFFG"}, "desc is 'SFFG'; it must be a list of strings"),
        ({"desc": [["S", "G"]]}, "it must be a list of strings"),
        ({"desc": 4}, "desc is 4; it must be a list of strings"),
        ({"desc": []}, "0 rows of no cells; possible are 1 to 8 rows of 2 to 8"),
        ({"desc": ["", ""]}, "2 rows of 0 cells; possible are 1 to 8"),
        ({"desc": ["SFFFFFFFG"]}, "1 rows of 9 cells; possible are 1 to 8"),
        ({"desc": ["SF"] * 9}, "9 rows of 2 cells; possible are 1 to 8"),
        ({"desc": ["S", "G"]}, "2 rows of 1 cells; possible are 1 to 8 rows of 2 to 8"),
        ({"desc": ["SFF", "FG"]}, "row 1 of desc has 2 cells, row 0 has 3"),
        ({"desc": ["SFF", "FXG"]}, "row 1 of desc has the letter 'X'; possible are S"),
        ({"desc": ["sFF", "FFG"]}, "the letter 's'"),
        ({"desc": ["FFF", "FFG"]}, "desc has no S; put one where episodes are to start"),
        ({"is_slippery": 1}, "is_slippery is 1; it must be True or False"),
        ({"success_rate": 1.5}, "success_rate is 1.5; it must be a number from 0 to 1"),
        ({"success_rate": -0.1}, "success_rate is -0.1"),
        ({"success_rate": float("nan")}, "success_rate is nan"),
        ({"success_rate": True}, "success_rate is True"),
        ({"success_rate": "1/3"}, "success_rate is '1/3'"),
        ({"reward_schedule": (1, 0)}, r"reward_schedule is \(1, 0\); it must be three finite numbers"),
        ({"reward_schedule": 1}, "reward_schedule is 1"),
        ({"reward_schedule": (1, 0, None)}, "reward_schedule is"),
        ({"reward_schedule": (1, 0, float("inf"))}, "reward_schedule is"),
        ({"reward_schedule": "abc"}, "reward_schedule is 'abc'"),
        ({"slippery": False}, "unknown argument 'slippery', did you mean 'is_slippery'"),
    ],
)
def test_refused_arguments(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        pearl_marl.parallel_env("FrozenLake", 2, **options)
