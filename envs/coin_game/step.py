"""The golden step of CoinGame, on a torus of three rows and three columns.

After ``num_inner_steps`` a new game begins within the episode.

What looks arbitrary is the package's:

- Players may share a cell, and so may coins. A player who walks onto both coins takes both. If both players
  walk onto a coin, both take it.
- A new coin appears in any cell. One that appears under a player lies there until somebody walks onto it.
- The last step of a game pays nothing, and it leads to the start of the next game.

Follows https://github.com/FLAIROx/JaxMARL (``jaxmarl`` 0.2.0, ``coin_game``): A. Lerer and A. Peysakhovich,
*Maintaining cooperation in complex social dilemmas using deep reinforcement learning*, 2017.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Bits
from pearl_marl.spec import Golden

SIZE = 3
RIGHT, LEFT, UP, DOWN, STAY = range(5)
"""Up is to the next row, and any other action is a stay."""
OWN, OTHERS, LOST, OF_BLUE = 1, 2, 4, 8
"""Bits of a category: the player took a coin of his own colour, he took one of the other's, and the other
took one of his. With the last bit set the category is one of blue's own, which he has if he is paid
differently."""


class Place(NamedTuple):
    """A cell of the torus."""

    row: Bits[2]
    column: Bits[2]


class View(NamedTuple):
    """What a player sees."""

    own: Place
    other: Place
    own_coin: Place
    other_coin: Place


class Around(NamedTuple):
    """What a player sees who is always in the middle."""

    other: Place
    own_coin: Place
    other_coin: Place


def anywhere(draws: Draws) -> list[Place]:
    """Return four cells, all equally likely."""
    numbers = draws.several(*[SIZE] * 8)
    return [Place(numbers[k], numbers[k + 1]) for k in range(0, 8, 2)]


def moved(place: Place, action: Word) -> Place:
    """Return the cell next to one, around the torus."""
    row, column = place
    if action == UP:
        row = row + 1 if row < SIZE - 1 else 0
    elif action == DOWN:
        row = row - 1 if row > 0 else SIZE - 1
    elif action == RIGHT:
        column = column + 1 if column < SIZE - 1 else 0
    elif action == LEFT:
        column = column - 1 if column > 0 else SIZE - 1
    return Place(row, column)


def make_golden(inner_steps: int, egocentric: bool, shared: bool, alike: bool) -> Golden:
    """Return the golden functions of games of so many steps.

    With ``egocentric`` the torus is turned until a player is in the middle, and he is left out of what he
    sees. With ``shared`` rewards a category has four bits: red took the red coin, red took the blue one, blue
    took the red one, blue took the blue one. ``alike`` says whether both players are paid by the same
    numbers.
    """

    class State(NamedTuple):
        """Players and coins, red before blue, and the steps of the game so far."""

        players: Array[Place, 2]
        coins: Array[Place, 2]
        time: Bits[max((inner_steps - 1).bit_length(), 1)]

    def initial(draws: Draws) -> State:
        """Put players and coins anywhere."""
        places = anywhere(draws)
        return State(places[:2], places[2:], 0)

    def step(state: State, actions: list[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
        # A new game takes all the numbers, new coins the first four.
        new = anywhere(draws)
        if state.time >= inner_steps - 1:
            return State(new[:2], new[2:], 0), [0, 0], [False, False]
        red, blue = (moved(state.players[k], actions[k]) for k in range(2))
        red_coin, blue_coin = state.coins
        red_red, red_blue = red == red_coin, red == blue_coin
        blue_red, blue_blue = blue == red_coin, blue == blue_coin
        coins = [
            new[0] if red_red or blue_red else red_coin,
            new[1] if red_blue or blue_blue else blue_coin,
        ]
        if shared:
            codes = [red_red | red_blue << 1 | blue_red << 2 | blue_blue << 3] * 2
        else:
            codes = [
                red_red * OWN | red_blue * OTHERS | blue_red * LOST,
                blue_blue * OWN | blue_red * OTHERS | red_blue * LOST | (0 if alike else OF_BLUE),
            ]
        return State([red, blue], coins, state.time + 1), codes, [False, False]

    def observe(state: State, agent: int) -> View | Around:
        """Return what a player sees."""
        players, coins = state.players, state.coins
        seen = View(players[agent], players[1 - agent], coins[agent], coins[1 - agent])
        return Around(*[around(place, seen.own) for place in seen[1:]]) if egocentric else seen

    return Golden(State, initial, step, observe, view=Around if egocentric else View)


def around(place: Place, own: Place) -> Place:
    """Return a cell as seen from one's own, which is in row and column 1."""
    return Place((place.row + 1 - own.row) % SIZE, (place.column + 1 - own.column) % SIZE)


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
    """Return the reward of each category of the step of :func:`make_golden`."""
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
