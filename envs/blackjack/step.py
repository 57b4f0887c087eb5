"""The golden step of Blackjack.

A hand is its total and whether an ace in it counts 11 (a *usable* ace). No more of it matters: an ace
that counts 1 never counts 11 again, since totals only grow. Of the dealer's hand the state keeps the
two cards dealt; the rest is drawn within the step in which the player sticks.

Cards come from an endless deck, so they are digits of random numbers to the base of 13.

Follows https://gymnasium.farama.org/environments/toy_text/blackjack/ (Blackjack-v1), itself example 5.1
of Sutton and Barto, *Reinforcement Learning: An Introduction*, 2nd edition.
"""

from __future__ import annotations

from typing import NamedTuple

from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Bits, Flag

RANKS = 13
STICK, HIT = 0, 1
STANDS_ON = 17
MOST_DRAWN = 10
"""Cards that a dealer draws at most: from two aces four more, a 6, and five aces."""
FRACTION = 60
"""Bits of the number whose digits these cards are. 13 times it still fits 64 bits."""
LOSS, DRAW, WIN, NATURAL_WIN = 0, 1, 2, 3


class State(NamedTuple):
    """The player's hand, and the dealer's two cards, an ace 1."""

    player: Bits[5]
    ace: Flag
    showing: Bits[4]
    hidden: Bits[4]
    natural: Flag


class View(NamedTuple):
    """What the player sees."""

    player: Bits[5]
    showing: Bits[4]
    ace: Flag


def initial(draws: Draws) -> State:
    """Deal two cards to the dealer and two to the player.

    Each of the ``13**4`` deals is off by less than ``2**-17`` of its probability.
    """
    showing, hidden, first, second = map(value, draws.several(RANKS, RANKS, RANKS, RANKS))
    player, ace = add(*add(0, 0, first), second)
    return State(player, ace, showing, hidden, player == 21)


def make_step(natural_pays: bool, natural_wins: bool) -> GoldenFunction:
    """Return the golden step.

    Parameters
    ----------
    natural_pays
        Whether a win with a natural is a category of its own.
    natural_wins
        Whether a natural wins against all but a natural.
    """

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Hit or stick; each sequence of cards is off by less than ``2**-22`` of its probability."""
        player, ace, showing, hidden, natural = state
        number, cards = draws.bits() << FRACTION - 32 | draws.bits(FRACTION - 32), []
        for _ in range(MOST_DRAWN):
            number *= RANKS
            cards.append(value(number >> FRACTION))
            number &= (1 << FRACTION) - 1

        if action == HIT:
            player, ace = add(player, ace, cards[0])
            bust = player > 21
            return State(player, ace, showing, hidden, False), LOSS if bust else DRAW, bust

        least = showing + hidden  # of the dealer's hand, its aces counting 1
        has_ace = showing == 1 or hidden == 1
        # No card beats a natural of the dealer's, and it takes none.
        wins_outright = natural_wins and natural and total(least, has_ace) != 21
        for card in cards:
            if total(least, has_ace) < STANDS_ON:
                least, has_ace = least + card, has_ace or card == 1
        dealer = total(least, has_ace)
        if dealer > 21 or player > dealer or wins_outright:
            return state, NATURAL_WIN if natural_pays and natural else WIN, True
        return state, DRAW if player == dealer else LOSS, True

    return step


def observe(state: State) -> View:
    """Return what the player sees."""
    return View(state.player, state.showing, state.ace)


def value(rank: Word) -> Word:
    """Return what a card counts, an ace 1: the ranks 0 to 12 are ace, 2 to 10, jack, queen and king."""
    return min(rank + 1, 10)


def total(least: Word, has_ace: Word) -> Word:
    """Return the total of a hand that comes to ``least`` if all aces count 1."""
    return least + 10 if has_ace and least <= 11 else least


def add(total: Word, ace: Word, card: Word) -> tuple[Word, Word]:
    """Add a card to a hand; return its total and whether an ace counts 11."""
    # The five bits matter for hands that nobody holds: hardware wraps around there.
    least = (total - 10 if ace else total) + card & 31
    ace = (ace or card == 1) and least <= 11
    return least + 10 if ace else least, ace
