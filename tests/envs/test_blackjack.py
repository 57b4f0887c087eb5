"""Blackjack against Gymnasium's ``Blackjack-v1``: the same cards into both, and the cards themselves."""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.toy_text import blackjack
from scipy import stats

import pearl_marl
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference, u8, u32
from pearl_marl.porting.oracle import Games, Outcome, compare
from pearl_marl.testing import compare_pictures, compare_steps, first_episodes, step_from
from pearl_marl.testing.oracles import random_actions_of

from ..sampling import sampled
from .fixed import drawing

RULES = [{"natural": natural, "sab": sab} for natural in (False, True) for sab in (False, True)]
DECK = np.array(blackjack.deck)
CHANCE = np.bincount(DECK, minlength=11) / 13
spec = pearl_marl.get_spec("Blackjack").with_options


def oracle(**options: Any) -> Any:
    return gymnasium.make("Blackjack-v1", **options).unwrapped


def cards_of(high: int, low: int, bits: int, count: int) -> list[int]:
    """Return the cards that a number of ``bits`` stands for, worked out with Python's own integers."""
    number, cards = (high << 32 | low) >> (64 - bits), []
    for _ in range(count):
        rank, number = divmod(number * 13, 1 << bits)
        cards.append(int(DECK[rank]))
    return cards


def draws_for(cards: list[int], bits: int) -> list[int]:
    """Return draws, of ``bits`` in all, that the given cards come from; the inverse of :func:`cards_of`."""
    number = 0
    for card in cards:
        number = number * 13 + card - 1
    number = -(-(number << bits) // 13 ** len(cards)) << (64 - bits)
    return [number >> 32, number & 0xFFFFFFFF][: 1 + (bits > 32)]


def test_most_cards_that_a_dealer_draws() -> None:
    """The longest way to 17, by trying every card in every hand."""

    @cache
    def longest(hand: tuple[int, ...]) -> int:
        if blackjack.sum_hand(hand) >= 17:
            return 0
        return 1 + max(longest(tuple(sorted((*hand, card)))) for card in range(1, 11))

    assert max(longest(pair) for pair in itertools.combinations_with_replacement(range(1, 11), 2)) == 10


class Dealt:
    """Gymnasium's games, each dealt the cards that our draws stand for."""

    def __init__(self, ours: pearl_marl.EnvSpec, n: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self.pile: list[int] = []
        monkeypatch.setattr(blackjack, "draw_card", lambda _: self.pile.pop(0))
        self.games = Games(
            ours,
            [oracle(**ours.options) for _ in range(n)],
            self.pose,
            self.step,
            lambda gym: Outcome(gym._get_obs()),
        )

    def pose(self, gym: Any, state: Any) -> None:
        # Three cards that add up to the total, or the two of a natural.
        total = state.player
        three = [1, 0, total - 11] if state.ace else [total - 2, 0, 2]
        gym.player, gym.dealer = [1, 10] if state.natural else three, [state.showing, state.hidden]

    def step(self, gym: Any, actions: list[int], draws: list[int]) -> Outcome:
        self.pile[:] = cards_of(*draws, 60, 10)
        seen, reward, terminated, _, _ = gym.step(actions[0])
        return Outcome(seen, reward, terminated)


@pytest.mark.parametrize("options", RULES, ids=str)
def test_whole_episodes(options: dict[str, bool], monkeypatch: pytest.MonkeyPatch) -> None:
    """The same cards for both, and every step of 800 episodes and more, naturals often among them."""
    n, ours, seen, episodes = 50, spec(**options), set[float](), 0

    def draws(generator: np.random.Generator, games: int, count: int) -> np.ndarray:
        if count == 1:  # a deal
            dealt = generator.choice(DECK, (games, 4))
            dealt[::4, 2:] = 1, 10
            dealt[::12, :2] = 1, 10
            return np.array([draws_for(cards, 32) for cards in dealt.tolist()])
        # Small cards make dealers draw many.
        few = generator.choice([1, 1, 1, 2, 6], (games, 10))
        drawn = np.where(generator.random((games, 1)) < 1 / 3, few, generator.choice(DECK, (games, 10)))
        return np.array([draws_for(cards, 60) for cards in drawn.tolist()])

    for move in compare(ours, Dealt(ours, n, monkeypatch).games, n, 32, draws=draws, seed=3):
        seen |= set(move.outcome.rewards.ravel().tolist())
        episodes += int(move.ended.sum())
    assert episodes >= 800
    assert seen == ({-1, 0, 1, 1.5} if options["natural"] and not options["sab"] else {-1, 0, 1})


@pytest.mark.parametrize("options", sampled(RULES, RULES[1:3]), ids=str)
def test_every_hand(options: dict[str, bool], monkeypatch: pytest.MonkeyPatch) -> None:
    """Every hand there is, to hit and to stick, on the CPU device, too."""
    hands = [(total, 0, False) for total in range(4, 22)] + [(total, 1, False) for total in range(12, 22)]
    hands.append((21, 1, True))
    cases = list(itertools.product(hands, range(1, 11), range(1, 11), range(2)))
    states = np.array([(*hand[:2], up, down, hand[2]) for hand, up, down, _ in cases])
    actions = np.array([action for *_, action in cases], np.uint8)
    ours = spec(**options)
    compare_steps(ours, Dealt(ours, len(cases), monkeypatch).games, list(states.T), actions, seed=4)


def test_scalars_do_what_arrays_do() -> None:
    generator, n = np.random.default_rng(0), 1000
    ours = spec(natural=True, sab=False).positional
    cases = [u8(generator.integers(limit, size=n)) for limit in (32, 2, 16, 16, 2, 2)]
    cases += [generator.integers(2**32, size=n, dtype=np.uint32) for _ in range(2)]
    step, start = call_reference(ours.step, cases), call_reference(ours.initial, cases[-1:])
    for i in range(n):
        one = [column[i] for column in cases]
        assert call_reference(ours.step, one) == tuple(result[i] for result in step)
        assert call_reference(ours.initial, one[-1:]) == tuple(result[i] for result in start)


def test_every_deal_has_its_share_of_the_draws() -> None:
    """The deals are cut out of the draws in order, each as wide as the next, to a draw."""
    ours = spec().positional
    numbers = np.arange(13**4)
    firsts = -(-(numbers << 32) // 13**4)
    widths = np.diff(np.append(firsts, 1 << 32))
    assert abs(widths / (2**32 / 13**4) - 1).max() < 2**-17
    deals = DECK[np.array(np.unravel_index(numbers, (13,) * 4))]
    for draws in (firsts, firsts + widths - 1):
        player, ace, showing, hidden, natural = call_reference(ours.initial, [u32(draws)])
        np.testing.assert_array_equal(showing, deals[0])
        np.testing.assert_array_equal(hidden, deals[1])
        hands = deals[2:]
        soft = (hands == 1).any(axis=0)  # two cards are never too many for one ace
        np.testing.assert_array_equal(ace, soft)
        np.testing.assert_array_equal(player, hands.sum(axis=0) + 10 * soft)
        np.testing.assert_array_equal(natural, soft & (hands.sum(axis=0) == 11))


def test_frequencies_of_cards() -> None:
    """Both of the dealer's cards, and the one that a hit takes, each by chi-squared, and any two together."""
    n = 100_000
    env = pearl_marl.parallel_env("Blackjack", n)
    env.reset_batch(seed=1)
    _, _, showing, hidden, _ = env.state().T.astype(int)
    env.close()
    fields = [np.full(n, 4), np.zeros(n), showing, hidden, np.zeros(n)]
    taken = step_from(spec(), fields, np.ones(n, np.uint8), seed=1).arrivals()[:, 0] - 4
    taken[taken == 11] = 1
    cards = {"showing": showing, "hidden": hidden, "taken": taken}
    p_values = {
        name: stats.chisquare(np.bincount(part, minlength=11)[1:], n * CHANCE[1:]).pvalue
        for name, part in cards.items()
    }
    for (one, a), (other, b) in itertools.combinations(cards.items(), 2):
        table = stats.contingency.crosstab(a, b).count
        p_values[f"{one} and {other}"] = stats.chi2_contingency(table).pvalue
    print(", ".join(f"{name}: p = {p:.3f}" for name, p in p_values.items()))
    assert min(p_values.values()) > 0.001


@pytest.mark.parametrize("options", sampled(RULES, RULES[:1]), ids=str)
def test_episodes_of_a_random_policy(options: dict[str, bool]) -> None:
    """Length and return of 20,000 episodes of each, by a chi-squared test of homogeneity."""
    n, generator, gym = 20_000, np.random.default_rng(2), oracle(**options)
    gym.reset(seed=6)
    theirs: dict[tuple[int, float], int] = {}
    for _ in range(n):
        gym.reset()
        length, ended = 0, False
        while not ended:
            _, reward, ended, _, _ = gym.step(int(generator.integers(2)))
            length += 1
        theirs[length, reward] = theirs.get((length, reward), 0) + 1
    lengths, returns = first_episodes(spec(**options), n, 1, random_actions_of(spec()))
    kinds, counts = np.unique(np.array([lengths, returns]), axis=1, return_counts=True)
    ours = {(int(length), value): count for (length, value), count in zip(kinds.T, counts, strict=True)}
    common = [kind for kind in ours if ours[kind] + theirs.get(kind, 0) >= 20]
    table = np.array([[counts.get(kind, 0) for kind in common] for counts in (ours, theirs)])
    table = np.column_stack([table, n - table.sum(axis=1)])
    p = stats.chi2_contingency(table[:, table.sum(axis=0) > 0]).pvalue
    print(f"{options}: {table.shape[1]} kinds of episodes, p = {p:.3f}")
    assert p > 0.001


def test_pictures_are_gymnasiums() -> None:
    """Of the first states of many episodes."""
    env = drawing(spec())
    gym = env.unwrapped

    def drawn(state: Any) -> Any:
        player, showing = state.player, state.showing
        gym.player, gym.dealer = [1, player - 11] if state.ace else [player - 2, 2], [showing, state.hidden]
        gym.dealer_top_card_suit = "S"
        gym.dealer_top_card_value_str = {1: "A", 10: "K"}.get(showing, str(showing))
        return env.render()

    compare_pictures(spec(), "rgb_array", drawn, [0] * 30, different=16)


def test_options_are_gymnasiums() -> None:
    registered = gymnasium.spec("Blackjack-v1")
    assert spec().options == registered.kwargs
    assert spec().max_cycles is registered.max_episode_steps is None
    assert spec().observation_space == gymnasium.make("Blackjack-v1").observation_space


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"natural": 1}, "natural is 1; it must be True or False"),
        ({"sab": None}, "sab is None; it must be True or False"),
        ({"sap": True}, "unknown argument 'sap', did you mean 'sab'"),
    ],
)
def test_refused_arguments(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        pearl_marl.parallel_env("Blackjack", 2, **options)
