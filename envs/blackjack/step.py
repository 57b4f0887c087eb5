"""The golden step of Blackjack.

A hand is its total and whether an ace in it counts 11 (a *usable* ace). No more of it matters: an ace
that counts 1 never counts 11 again, since totals only grow. Of the dealer's hand the state keeps the
two cards dealt; the rest is drawn within the step in which the player sticks.

Cards come from an endless deck, so they are digits of random numbers to the base of 13: the upper
part of ``number * 13`` is a digit, the lower part the number for the next one.

Follows https://gymnasium.farama.org/environments/toy_text/blackjack/ (Blackjack-v1), itself example 5.1
of Sutton and Barto, *Reinforcement Learning: An Introduction*, 2nd edition.
"""

from __future__ import annotations

import numpy as np

from pearl_marl.golden import GoldenFunction, Word, u32, uniform_below

RANKS = 13
STANDS_ON = 17
MOST_DRAWN = 10
"""Cards that a dealer draws at most: from two aces four more, a 6, and five aces."""
FRACTION = 60
"""Bits of the number whose digits these cards are. 13 times it still fits 64 bits."""
LOSS, DRAW, WIN, NATURAL_WIN = 0, 1, 2, 3


def initial(draw: Word) -> tuple[Word, Word, Word, Word, Word]:
    """Deal two cards to the dealer and two to the player; return ``(player, ace, showing, hidden, natural)``.

    Each of the ``13**4`` deals is off by less than ``2**-17`` of its probability.
    """
    showing, draw = _card(draw)
    hidden, draw = _card(draw)
    first, draw = _card(draw)
    second, draw = _card(draw)
    player, ace = _add(*_add(0, 0, first), second)
    return player, ace, showing, hidden, player == 21


def make_step(natural_pays: bool, natural_wins: bool) -> GoldenFunction:
    """Return the golden step.

    Parameters
    ----------
    natural_pays
        Whether a win with a natural is a category of its own.
    natural_wins
        Whether a natural wins against all but a natural.
    """

    def step(
        player: Word,
        ace: Word,
        showing: Word,
        hidden: Word,
        natural: Word,
        action: Word,
        high: Word,
        low: Word,
    ) -> tuple[Word, Word, Word, Word, Word, Word, Word]:
        """Hit or stick; each sequence of cards is off by less than ``2**-22`` of its probability."""
        number = (high << FRACTION - 32) | (low >> 64 - FRACTION)
        hit = action == 1

        least = showing + hidden  # of the dealer's hand, its aces counting 1
        has_ace = (showing == 1) | (hidden == 1)
        # No card beats a natural of the dealer's, and it takes none.
        wins_outright = natural_wins & natural & (_total(least, has_ace) != 21)
        for k in range(MOST_DRAWN):
            number = number * RANKS
            card, number = _value(number >> FRACTION), number & (1 << FRACTION) - 1
            if k == 0:  # no choice on data: the loop unrolls
                player, ace = _add(player, ace, np.where(hit, card, 0))
            takes = _total(least, has_ace) < STANDS_ON
            least, has_ace = np.where(takes, least + card, least), has_ace | (takes & (card == 1))

        dealer = _total(least, has_ace)
        dealer = np.where(dealer <= 21, dealer, 0)
        won = (player > dealer) | wins_outright
        after_sticking = np.where(won, np.where(natural_pays & natural, NATURAL_WIN, WIN), player == dealer)
        bust = player > 21
        reward = np.where(hit, np.where(bust, LOSS, DRAW), after_sticking)
        return player, ace, showing, hidden, natural & (action == 0), reward, bust | (action == 0)

    return step


def observe(player: Word, ace: Word, showing: Word, hidden: Word, natural: Word) -> tuple[Word, Word, Word]:
    """Return the observation, ``(player, showing, ace)``."""
    return player, showing, ace


def _card(draw: Word) -> tuple[Word, Word]:
    """Return what the card counts that a digit of the draw is, and the next draw."""
    return _value(uniform_below(draw, RANKS)), u32(draw * RANKS)


def _value(rank: Word) -> Word:
    """Return what a card counts, an ace 1: the ranks 0 to 12 are ace, 2 to 10, jack, queen and king."""
    return np.minimum(rank + 1, 10)


def _total(least: Word, has_ace: Word) -> Word:
    """Return the total of a hand that comes to ``least`` if all aces count 1."""
    return np.where(has_ace & (least <= 11), least + 10, least)


def _add(total: Word, ace: Word, card: Word) -> tuple[Word, Word]:
    """Add a card to a hand, or none where ``card`` is 0; return its total and whether an ace counts 11."""
    # The five bits matter for hands that nobody holds: hardware wraps around there.
    least = (np.where(ace, total - 10, total) + card) & 31
    has_ace = ace | (card == 1)
    return _total(least, has_ace), has_ace & (least <= 11)
