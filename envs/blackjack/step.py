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

from pearl_marl.golden import GoldenFunction, Word, u8, u32, u64, uniform_below

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
    showing = _value(uniform_below(draw, RANKS))
    draw = u32(draw * u32(RANKS))
    hidden = _value(uniform_below(draw, RANKS))
    draw = u32(draw * u32(RANKS))
    player, ace = _add(u8(0), u8(0), _value(uniform_below(draw, RANKS)))
    draw = u32(draw * u32(RANKS))
    player, ace = _add(player, ace, _value(uniform_below(draw, RANKS)))
    return player, ace, showing, hidden, u8(player == 21)


def make_step(natural_pays: bool, natural_wins: bool) -> GoldenFunction:
    """Return the golden step.

    Parameters
    ----------
    natural_pays
        Whether a win with a natural is a category of its own.
    natural_wins
        Whether a natural wins against all but a natural.
    """
    pays, wins = int(natural_pays), int(natural_wins)

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
        number = u64(u64(u64(high) << u64(FRACTION - 32)) | u64(u64(low) >> u64(64 - FRACTION)))
        hit = u8(action)
        hit_mask = u8(u8(0) - hit)

        least = u8(showing + hidden)  # of the dealer's hand, its aces counting 1
        has_ace = u8(u8(showing == 1) | u8(hidden == 1))
        # No card beats a natural of the dealer's, and it takes none.
        wins_outright = u8(u8(natural & u8(wins)) & u8(_total(least, has_ace) != 21))
        for k in range(MOST_DRAWN):
            number = u64(number * u64(RANKS))
            card = _value(u64(number >> u64(FRACTION)))
            number = u64(number & u64((1 << FRACTION) - 1))
            if k == 0:  # no choice on data: the compiler unrolls the loop
                player, ace = _add(player, ace, u8(card & hit_mask))
            card = u8(card & u8(u8(0) - u8(_total(least, has_ace) < STANDS_ON)))
            least, has_ace = u8(least + card), u8(has_ace | u8(card == 1))

        dealer = _total(least, has_ace)
        bust = u8(player > 21)
        dealer = u8(dealer & u8(u8(0) - u8(dealer <= 21)))
        won = u8(u8(player > dealer) | wins_outright)
        drew = u8(u8(player == dealer) & u8(won ^ u8(1)))
        won_natural = u8(u8(won & natural) & u8(pays))
        stuck = u8(u8(u8(won << u8(1)) | drew) | won_natural)
        reward = u8(u8(u8(bust ^ u8(1)) & hit_mask) | u8(stuck & u8(~hit_mask)))
        terminated = u8(bust | u8(hit ^ u8(1)))
        return player, ace, showing, hidden, u8(natural & u8(~hit_mask)), reward, terminated

    return step


def observe(player: Word, ace: Word, showing: Word, hidden: Word, natural: Word) -> tuple[Word, Word, Word]:
    """Return the observation, ``(player, showing, ace)``."""
    return player, showing, ace


def _value(rank: Word) -> Word:
    """Return what a card counts, an ace 1: the ranks 0 to 12 are ace, 2 to 10, jack, queen and king."""
    rank = u8(rank)
    # 9 and above count 10.
    over = u8(u8(0) - u8(rank > 9))
    return u8(u8(u8(rank & u8(~over)) | u8(u8(9) & over)) + u8(1))


def _total(least: Word, has_ace: Word) -> Word:
    """Return the total of a hand that comes to ``least`` if all aces count 1."""
    return u8(least + u8(u8(10) & u8(u8(0) - u8(has_ace & u8(least <= 11)))))


def _add(total: Word, ace: Word, card: Word) -> tuple[Word, Word]:
    """Add a card to a hand, or none where ``card`` is 0; return its total and whether an ace counts 11."""
    # The five bits matter for hands that nobody holds: hardware wraps around there.
    least = u8(u8(u8(total - u8(u8(10) & u8(u8(0) - ace))) + card) & u8(31))
    has_ace = u8(ace | u8(card == 1))
    return _total(least, has_ace), u8(has_ace & u8(least <= 11))
