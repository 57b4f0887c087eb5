"""Taxi against Gymnasium's ``Taxi-v4``: exactly where it can be, by statistics where not."""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference, u8, u32
from pearl_marl.porting.oracle import Outcome, Rules
from pearl_marl.rendering import HeatMap
from pearl_marl.testing import assert_same_play, compare_pictures, compare_steps, first_episodes, step_from
from pearl_marl.testing.oracles import p_of_one_law

from ..sampling import sampled
from .fixed import drawing
from .tabular import compare_draws, first_observations, table_episodes, table_of

STATES, ACTIONS = 500, 6
DRY, RAINY = {}, {"is_rainy": True}
FICKLE, BOTH = {"fickle_passenger": True}, {"is_rainy": True, "fickle_passenger": True}
STORM = {"is_rainy": True, "rainy_probability": 0.25, "fickle_passenger": True, "fickle_probability": 0.9}
PAIRS = np.array(list(itertools.product(range(STATES), range(ACTIONS)))).T
spec = pearl_marl.get_spec("Taxi").with_options


def oracle(**options: Any) -> Any:
    return gymnasium.make("Taxi-v4", **options).unwrapped


def decode(states: np.ndarray) -> list[np.ndarray]:
    """Return row, column, passenger and destination of Gymnasium's states."""
    return [u8(states // 100), u8(states // 20 % 5), u8(states // 4 % 5), u8(states % 4)]


def number(state: list[np.ndarray]) -> np.ndarray:
    """Return Gymnasium's states: the inverse of :func:`decode`."""
    row, column, passenger, destination = (column.astype(int) for column in state[:4])
    return ((row * 5 + column) * 5 + passenger) * 4 + destination


def slip_edges(ours: pearl_marl.EnvSpec) -> list[int]:
    """Return the least remainder with which a taxi slips to the left, and to the right."""
    forward = ours.options["rainy_probability"] if ours.options["is_rainy"] else 1.0
    return [max(1, round(share * 2**32)) for share in (forward, (1 + forward) / 2)]


def draw_of(ours: pearl_marl.EnvSpec, outcome: int, third: int) -> tuple[int, int]:
    """Return the least and the greatest draw of a slip (0 none, 1 left, 2 right) and a new destination."""
    edges = [0, *slip_edges(ours), 2**32]
    low, after = (third * 2**32 + edge for edge in edges[outcome : outcome + 2])
    return -(-low // 3), (after - 1) // 3


def table(ours: pearl_marl.EnvSpec) -> Rules:
    """Return ``P``, and the new destinations of the fickle: the other three, by the thirds of the draws."""
    p = table_of(oracle(**ours.options))

    def step(state: list[np.ndarray], actions: np.ndarray, draws: np.ndarray) -> Outcome:
        states, action, fickle = number(state), actions[:, 0], state[4] == 1
        third, outcome = np.zeros((2, len(states)), int)
        if ours.step_draws:
            tripled = 3 * draws[:, 0].astype(object)
            third, rest = (tripled >> 32).astype(int), (tripled % 2**32).astype(int)
            # Serving has one outcome, whatever the rain.
            outcome = np.where(action < 4, sum((rest >= edge).astype(int) for edge in slip_edges(ours)), 0)
        new = p.state[states, action, outcome]
        changes = fickle & (states // 4 % 5 == 4) & (new // 20 != states // 20)
        other = third + (third >= states % 4)
        after = np.where(changes, new // 4 * 4 + other, new)
        which = states, action, outcome
        return Outcome(after, p.reward[which], p.terminated[which], state={"fickle": fickle & ~changes})

    return Rules(step)


@pytest.mark.parametrize("options", sampled([DRY, RAINY, FICKLE, BOTH, STORM], [DRY, BOTH]), ids=str)
def test_every_step(options: dict[str, Any]) -> None:
    """Every state, action and slip, with passengers who are fickle and who are not."""
    ours = spec(**options)
    outcomes = table_of(oracle(**options)).probability
    assert outcomes.shape[2] == (3 if ours.options["is_rainy"] else 1)
    states, actions = PAIRS
    for k in range(outcomes.shape[2]):
        share = sum(len(range(*draw_of(ours, k, third))) + 1 for third in range(3)) / 2**32
        assert abs(share - outcomes[0, 0, k]) < 2**-31 if ours.step_draws else share == 1
        ends = [draw_of(ours, k, third)[end] for third in range(3) for end in range(2)]
        for fickle in range(1 + ours.options["fickle_passenger"]):
            words = [*decode(states), np.full(len(states), fickle)]
            compare_draws(ours, table(ours), words, actions, ends[: 6 if ours.step_draws else 1])


class Injected:
    """Stands in for the oracle's generator: the slip and the new destination are given."""

    def __init__(self) -> None:
        self.number, self.third = 0.0, 0

    def random(self) -> float:
        return self.number

    def choice(self, destinations: list[int]) -> int:
        return destinations[self.third]


@pytest.mark.parametrize("options", [FICKLE, BOTH], ids=str)
def test_golden_step_of_the_fickle(options: dict[str, Any]) -> None:
    """Every state of a fickle passenger, action, slip and choice, against the oracle's own ``step``."""
    gym, ours = oracle(**options), spec(**options)
    gym.reset(seed=0)
    gym._np_random = injected = Injected()
    numbers = (0.1, 0.85, 0.95) if ours.options["is_rainy"] else (0.1,)
    states, actions = PAIRS
    changed = 0
    for (k, number), third in itertools.product(enumerate(numbers), range(3)):
        injected.number, injected.third = number, third
        words = [*decode(states), np.ones(len(states), np.uint8), u8(actions)]
        draws = np.full(len(states), draw_of(ours, k, third)[0], np.uint32)
        *moved, code, terminated = call_reference(ours.positional.step, [*words, draws])
        (observed,) = call_reference(ours.positional.observe, moved)
        assert ours.rewards is not None
        got = zip(observed.tolist(), np.array(ours.rewards)[code], terminated, moved[4], strict=True)
        for state, action, mine in zip(states.tolist(), actions.tolist(), got, strict=True):
            gym.s, gym.fickle_step = state, True
            new, reward, ended, _, _ = gym.step(action)
            assert mine == (new, reward, ended, gym.fickle_step), (state, action, k, third)
            changed += not gym.fickle_step
    assert changed > 800


def test_scalars_do_what_arrays_do() -> None:
    generator = np.random.default_rng(0)
    ours, n = spec(**BOTH).positional, 2000
    limits = (8, 8, 8, 4, 2, 6, 2**32)
    columns = [generator.integers(limit, size=n) for limit in limits]
    cases = [*map(u8, columns[:-1]), u32(columns[-1])]
    whole = call_reference(ours.step, cases)
    starts = call_reference(ours.initial, cases[-1:])
    for i in range(n):
        one = [column[i] for column in cases]
        assert call_reference(ours.step, one) == tuple(result[i] for result in whole)
        assert call_reference(ours.initial, one[-1:]) == tuple(result[i] for result in starts)


def test_every_legal_start_has_its_share_of_the_draws() -> None:
    """The 300 starts are cut out of the draws in order, each as wide as the next, to a draw."""
    firsts = np.array([-(-i * 2**32 // 300) for i in range(300)])
    lasts = np.array([-(-(i + 1) * 2**32 // 300) - 1 for i in range(300)])
    ours = spec().positional
    seen = [
        call_reference(ours.observe, call_reference(ours.initial, [u32(draws)]))[0]
        for draws in (firsts, lasts)
    ]
    np.testing.assert_array_equal(*seen)
    np.testing.assert_array_equal(np.sort(seen[0]), np.flatnonzero(oracle().initial_state_distrib))


def test_the_fickle_have_their_share_of_every_start() -> None:
    ours = spec(**FICKLE)
    for i in range(300):
        low, high = -(-i * 2**32 // 300), -(-(i + 1) * 2**32 // 300)
        flags = call_reference(ours.positional.initial, [np.arange(low, high, 16411, dtype=np.uint32)])[4]
        # They are the first of each start's draws, so their number is known to a draw.
        assert np.all(np.diff(flags.astype(int)) <= 0)
        assert abs(flags.mean() - 0.3) < 16411 * 300 / 2**32
    for options, share in ((FICKLE | {"fickle_probability": 0}, 0), (DRY, 0), (STORM, 0.9)):
        drawn = call_reference(
            spec(**options).positional.initial, [np.arange(0, 2**32, 99991, dtype=np.uint32)]
        )[4]
        assert drawn.mean() == pytest.approx(share, abs=1e-4)


def test_distribution_of_starts() -> None:
    probability = oracle().initial_state_distrib
    legal = np.flatnonzero(probability)
    n = 60_000
    seen = np.bincount(first_observations(spec(), n, seed=2), minlength=STATES)
    assert seen[legal].sum() == n
    p = stats.chisquare(seen[legal], n * probability[legal]).pvalue
    print(f"starts: p = {p:.3f}")
    assert p > 0.001


def test_distribution_of_the_fickle() -> None:
    """Their share, and that neither row nor destination tells who is."""
    n = 60_000
    env = pearl_marl.parallel_env("Taxi", n, fickle_passenger=True)
    env.reset_batch(seed=8)
    row, _, _, destination, fickle = env.state().T.astype(int)
    p_share = stats.binomtest(int(fickle.sum()), n, 0.3).pvalue
    p_values = [p_share] + [
        stats.chi2_contingency(stats.contingency.crosstab(part, fickle).count).pvalue
        for part in (row, destination)
    ]
    print("the fickle, share and independence of row and destination: p =", np.round(p_values, 3))
    assert min(p_values) > 0.001
    env.close()


@pytest.mark.parametrize("options", [DRY, BOTH], ids=str)
def test_many_steps(options: dict[str, Any]) -> None:
    """Every pair many times over, on the CPU device, too."""
    ours = spec(**options)
    states, actions = np.tile(PAIRS, 7)[:, : 9 * 2048 + 77]
    fickle = np.arange(len(states)) // len(PAIRS.T) % 2 * int(ours.options["fickle_passenger"])
    move = compare_steps(ours, table(ours), [*decode(states), fickle], actions, seed=5)
    changed = move.before[4].astype(bool) & ~move.after[4].astype(bool)
    assert changed.sum() > (500 if ours.step_draws else -1)


@pytest.mark.parametrize("options", sampled([RAINY, STORM], [RAINY]), ids=str)
def test_slip_frequencies(options: dict[str, Any]) -> None:
    """From the middle of the town every direction is free, and every slip leads elsewhere."""
    table, n, middle = table_of(oracle(**options)), 30_000, 12 * 20 + 1
    for action in range(4):
        fields = [*decode(np.full(n, middle)), np.zeros(n, np.uint8)]
        actions = np.full(n, action, np.uint8)
        arrived = step_from(spec(**options), fields, actions, action).arrivals()
        seen = np.bincount(arrived, minlength=STATES)[table.state[middle, action]]
        assert seen.sum() == n
        p = stats.chisquare(seen, n * table.probability[middle, action]).pvalue
        print(f"{options}, action {action}: p = {p:.3f}")
        assert p > 0.001


@pytest.mark.parametrize("destination", range(4))
def test_new_destinations(destination: int) -> None:
    """The other three, each as likely, whichever way the taxi slips."""
    n, middle = 30_000, 12 * 20 + 16 + destination
    fields = [*decode(np.full(n, middle)), np.ones(n, np.uint8)]
    arrived = step_from(spec(**BOTH), fields, np.zeros(n, np.uint8), destination).arrivals()
    others = [k for k in range(4) if k != destination]
    counts = stats.contingency.crosstab(arrived // 20, arrived % 4)
    np.testing.assert_array_equal(counts.elements[1], others)
    p_values = (
        stats.chisquare(counts.count.sum(axis=0)).pvalue,
        stats.chi2_contingency(counts.count).pvalue,
    )
    print("new destinations, share and independence of the slip: p =", np.round(p_values, 3))
    assert min(p_values) > 0.001


@cache
def good_actions() -> np.ndarray:
    """Return an action that is best in dry weather for each state, by value iteration on ``P``."""
    table = table_of(oracle())
    best = np.zeros(STATES)
    for _ in range(40):
        values = table.reward[..., 0] + np.where(table.terminated[..., 0], 0, best[table.state[..., 0]])
        best = values.max(axis=1)
    return values.argmax(axis=1)


def policy(share: float) -> Any:
    """Return a policy that takes a good action with this probability, and any otherwise."""

    def act(observations: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        n = len(observations)
        anything = generator.integers(ACTIONS, size=n)
        return u8(np.where(generator.random(n) < share, good_actions()[observations], anything))

    return act


@pytest.mark.parametrize("options", [DRY, RAINY], ids=str)
@pytest.mark.parametrize(
    "share", [0.6, pytest.param(0.0, marks=pytest.mark.slow)], ids=["mostly good", "uniform"]
)
def test_episodes_of_a_random_policy(options: dict[str, Any], share: float) -> None:
    """20,000 episodes of each: lengths and returns have one distribution."""
    ours = first_episodes(spec(**options), 20_000, 1, policy(share))
    theirs = table_episodes(oracle(**options), 20_000, 2, policy(share), limit=200)
    assert (ours[0] == 200).any() if share == 0 else (ours[0] < 200).mean() > 0.9
    assert_same_play(ours, theirs)


@pytest.mark.exhaustive
def test_episodes_with_fickle_passengers() -> None:
    """The same, but the oracle's own ``step`` has to do it, one slot after the other."""
    eager = {"fickle_passenger": True, "fickle_probability": 0.9}
    env, generator, n = gymnasium.make("Taxi-v4", **eager), np.random.default_rng(5), 8_000
    lengths, returns = np.zeros(n, int), np.zeros(n)
    env.reset(seed=3)
    act = policy(0.9)
    for i in range(n):
        observation, _ = env.reset()
        ended = False
        while not ended:
            action = int(act(np.array([observation]), generator)[0])
            observation, reward, terminated, truncated, _ = env.step(action)
            lengths[i] += 1
            returns[i] += float(reward)
            ended = terminated or truncated
    ours = first_episodes(spec(**eager), n, 1, policy(0.9))
    assert_same_play(ours, (lengths, returns))
    eager["fickle_passenger"] = False
    steadfast = first_episodes(spec(**eager), n, 1, policy(0.9))
    assert p_of_one_law(steadfast[0], lengths) < 1e-6, "this test cannot tell the fickle"


@pytest.mark.parametrize("mode", ["ansi", "rgb_array"])
def test_pictures_are_gymnasiums(mode: str) -> None:
    env = drawing(spec(), mode)

    def drawn(state: Any) -> Any:
        row, column, passenger, destination, _ = state
        env.unwrapped.s = ((row * 5 + column) * 5 + passenger) * 4 + destination
        return env.render()

    # Of the second world's episode, the actions that lead to its end.
    compare_pictures(spec(), mode, drawn, journey(1, 14), different=8)


def journey(slot: int, steps: int) -> list[int]:
    """Return good actions for a slot, from where it starts on."""
    state = int(first_observations(spec(), slot + 1, seed=0)[slot])
    actions = []
    for _ in range(steps):
        actions.append(int(good_actions()[state]))
        ((_, state, _, ended),) = oracle().P[state][actions[-1]]
        if ended:
            break
    return actions


def test_heat_map_counts_the_taxis() -> None:
    env = pearl_marl.parallel_env("Taxi", 200)
    env.reset_batch(seed=0)
    heat = HeatMap(env.spec)
    for _ in range(4):
        env.step_batch(np.zeros(200, int))
    heat.add(env.step_batch(np.zeros(200, int)))
    assert heat.counts[:4].sum() == 0
    np.testing.assert_array_equal(heat.counts[4], np.bincount(env.state()[:, 1].astype(int), minlength=5))
    env.close()


def test_options_and_limit() -> None:
    gym = gymnasium.make("Taxi-v4")
    assert gym.spec is not None
    assert spec().max_cycles == gym.spec.max_episode_steps == 200
    assert spec().options == {
        "is_rainy": False,
        "fickle_passenger": False,
        "rainy_probability": 0.8,
        "fickle_probability": 0.3,
    }
    # What is certain takes no draw.
    for options in (DRY, RAINY | {"rainy_probability": 1}, FICKLE | {"fickle_probability": 0}):
        assert spec(**options).step_draws == 0
    for options in (RAINY, FICKLE, BOTH):
        assert spec(**options).step_draws == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"is_rainy": 1}, "is_rainy is 1; it must be True or False"),
        ({"fickle_passenger": "no"}, "fickle_passenger is 'no'; it must be True or False"),
        ({"rainy_probability": 1.5}, "rainy_probability is 1.5; it must be a number from 0 to 1"),
        ({"rainy_probability": True}, "rainy_probability is True"),
        ({"fickle_probability": -1}, "fickle_probability is -1"),
        ({"fickle_probability": float("nan")}, "fickle_probability is nan"),
        ({"fickle_probability": None}, "fickle_probability is None"),
        ({"rainy": True}, "unknown argument 'rainy', did you mean 'is_rainy'"),
    ],
)
def test_refused_arguments(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        pearl_marl.parallel_env("Taxi", 2, **options)
