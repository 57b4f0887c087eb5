"""The golden step of CoinGame, on a torus of three rows and three columns.

A state lists row and column of the red player, the blue player, the red coin and the blue coin, and then the
steps of the game so far. After ``num_inner_steps`` a new game begins within the episode.

What looks arbitrary is the package's:

- Players may share a cell, and so may coins. A player who walks onto both coins takes both. If both players
  walk onto a coin, both take it.
- A new coin appears in any cell. One that appears under a player lies there until somebody walks onto it.
- The last step of a game pays nothing, and it leads to the start of the next game.

Follows https://github.com/FLAIROx/JaxMARL (``jaxmarl`` 0.2.0, ``coin_game``): A. Lerer and A. Peysakhovich,
*Maintaining cooperation in complex social dilemmas using deep reinforcement learning*, 2017.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pearl_marl.golden import GoldenFunction, Word, u32

SIZE = 3
RIGHT, LEFT, UP, DOWN, STAY = range(5)
"""Up is to the next row, and any other action is a stay."""
RED, BLUE, RED_COIN, BLUE_COIN = range(0, 8, 2)
"""Where the row of each stands in a state; the column is the next word."""
OWN, OTHERS, LOST, OF_BLUE = 1, 2, 4, 8
"""Bits of a category: the player took a coin of his own colour, he took one of the other's, and the other
took one of his. With the last bit set the category is one of blue's own, which he has if he is paid
differently."""


def digits(draw: Word, count: int) -> list[Word]:
    """Return independent numbers from 0 to 2, all equally likely: the digits of a fraction to base 3."""
    result: list[Word] = []
    for _ in range(count):
        product = draw * SIZE
        result.append(product >> 32)
        draw = u32(product)
    return result


def initial(draw: Word) -> tuple[Word, ...]:
    """Return the state of a new episode: players and coins are anywhere."""
    return *digits(draw, 8), 0


def moved(place: Word, forward: Word, backward: Word) -> Word:
    """Move a row or a column by one, around the torus."""
    further: Word = np.where(place >= SIZE - 1, 0, place + 1)
    back: Word = np.where(place == 0, SIZE - 1, place - 1)
    return np.where(forward, further, np.where(backward, back, place))


def make_step(inner_steps: int, shared: bool, alike: bool) -> GoldenFunction:
    """Return the golden step.

    With ``shared`` rewards a category has four bits: red took the red coin, red took the blue one, blue
    took the red one, blue took the blue one. ``alike`` says whether both players are paid by the same
    numbers.
    """

    def step(*words: Word) -> tuple[Word, ...]:
        *state, time, action_0, action_1, draw = words
        players: list[Word] = []
        for place, action in ((RED, action_0), (BLUE, action_1)):
            players.append(moved(state[place], action == UP, action == DOWN))
            players.append(moved(state[place + 1], action == RIGHT, action == LEFT))

        def takes(player: int, coin: int) -> Word:
            same_row: Word = players[player] == state[coin]
            return same_row & (players[player + 1] == state[coin + 1])

        red_red, red_blue = takes(RED, RED_COIN), takes(RED, BLUE_COIN)
        blue_red, blue_blue = takes(BLUE, RED_COIN), takes(BLUE, BLUE_COIN)
        last = time >= inner_steps - 1

        # A new game takes all the digits, new coins the first four.
        drawn = digits(draw, 8)
        coins = state[RED_COIN:]
        for coin, gone in ((0, red_red | blue_red), (2, red_blue | blue_blue)):
            for k in (coin, coin + 1):
                coins[k] = np.where(gone, drawn[k], coins[k])
        after = [np.where(last, new, old) for new, old in zip(drawn, [*players, *coins], strict=True)]

        if shared:
            codes = [red_red | red_blue << 1 | blue_red << 2 | blue_blue << 3] * 2
        else:
            blue = 0 if alike else OF_BLUE
            codes = [
                red_red * OWN | red_blue * OTHERS | blue_red * LOST,
                blue_blue * OWN | blue_red * OTHERS | red_blue * LOST | blue,
            ]
        codes = [np.where(last, 0, code) for code in codes]
        return *after, np.where(last, 0, time + 1), *codes, 0, 0

    return step


def make_observe(egocentric: bool) -> GoldenFunction:
    """Return the golden function of what a player sees: himself, the other, his own coin, the other's coin.

    With ``egocentric`` the torus is turned until he is in the middle, and he is left out.
    """

    def observe(*words: Word) -> tuple[Word, ...]:
        *state, _, agent = words
        order = (BLUE, RED, BLUE_COIN, RED_COIN) if agent else (RED, BLUE, RED_COIN, BLUE_COIN)
        seen = [state[place + k] for place in order for k in range(2)]
        if not egocentric:
            return tuple(seen)
        return tuple(around(word, seen[k % 2]) for k, word in enumerate(seen[2:]))

    return observe


def around(place: Word, own: Word) -> Word:
    """Return a row or a column as seen from one's own, which is 1."""
    number = place + 1 - own
    return np.where(number < 0, number + SIZE, np.where(number >= SIZE, number - SIZE, number))


def pay(payoff: Sequence[Sequence[float]], took: Sequence[Sequence[bool]], player: int) -> float:
    """Return what a player gets for the coins that both took: ``took[player][coin]``, red first.

    Added up in the order and the type of the package, so that it is the same to the last bit.
    """
    sum_ = np.float32(0)
    own, lost = payoff[player], took[1 - player][player]
    for taken, amount in ((took[player][0], own[0]), (took[player][1], own[1]), (lost, own[2])):
        sum_ = np.float32(sum_ + np.float32(amount)) if taken else sum_
    return float(sum_)


def rewards(payoff: Sequence[Sequence[float]], shared: bool, alike: bool) -> tuple[float, ...]:
    """Return the reward of each category of :func:`make_step`."""
    result = []
    if shared:
        for code in range(16):
            took = [[bool(code >> 2 * player + coin & 1) for coin in range(2)] for player in range(2)]
            red, blue = (np.float32(pay(payoff, took, player)) for player in range(2))
            result.append(float(red + blue))
        return tuple(result)
    for player in range(1 if alike else 2):
        for code in range(8):
            took = [[False, False], [False, False]]
            took[player][player] = bool(code & OWN)
            took[player][1 - player] = bool(code & OTHERS)
            took[1 - player][player] = bool(code & LOST)
            result.append(pay(payoff, took, player))
    return tuple(result)
