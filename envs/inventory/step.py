"""The golden step of Inventory: a chain of stages, of which each orders from the next one.

Customers buy from stage 0, stage 0 orders from 1, 1 from 2, and 2 from a plant that has all it needs. Orders
arrive some periods later; what a supplier does not have is lost.

Follows https://github.com/JGIoA/or-gymnasium (``or-gymnasium`` 0.1.0, ``InvManagement-v1``), after C. Hubbs
et al., *OR-Gym: A Reinforcement Learning Library for Operations Research Problems*, 2020.
"""

import math
from itertools import accumulate
from operator import mul
from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Range

PERIODS, MEAN_DEMAND, MOST_STORED = 30, 20, 3000
"""A stage never gets as many units as it could store."""
CHANCES = [math.exp(-MEAN_DEMAND) * MEAN_DEMAND**k / math.factorial(k) for k in range(54)]
DEMANDS = [round(chance * 2**32) for chance in accumulate(CHANCES)]
"""Below which 32-bit draw a demand, of Poisson's distribution, is at most 0, 1, 2 and so on."""
CAPACITY, LEAD, START = (100, 90, 80), (3, 5, 10), (100, 100, 200)
"""Of each stage the most that it can order, after how many periods that arrives, and what it has at first."""
PRICE, PENALTY = (80, 60, 40, 30), (4, 3, 2, 1)
"""What the stages and the plant get for a unit, and lose by one that they lack, in whole fortieths."""
COST, PLANT_COST, HOLDING = (60, 40, 30), 20, (6, 4, 2)
"""What a unit costs the stages, what it costs the plant, and what the stages pay for one that they keep."""
FRACTION = 12
WORTH = tuple(round(0.97**period / 40 * 2 ** (FRACTION + 12)) for period in range(PERIODS))
"""What a fortieth is worth in each period, with twelve bits more behind the point than the reward."""


class State(NamedTuple):
    """What each stage has, what is on its way to it, all orders of the last ten periods, and the period."""

    stored: Array[Range[0, MOST_STORED], 3]
    coming_0: Array[Range[0, CAPACITY[0]], LEAD[0]]
    coming_1: Array[Range[0, CAPACITY[1]], LEAD[1]]
    coming_2: Array[Range[0, CAPACITY[2]], LEAD[2]]
    orders: Array[Range[0, CAPACITY[0]], max(LEAD), 3]
    period: Range[0, PERIODS - 1]


class View(NamedTuple):
    """What each stage has, and the orders."""

    stored: Array[Range[0, MOST_STORED], 3]
    orders: Array[Range[0, CAPACITY[0]], max(LEAD), 3]


def initial(draws: Draws) -> State:
    """Return what the first period begins with: nothing has been ordered."""
    return State(list(START), [0] * LEAD[0], [0] * LEAD[1], [0] * LEAD[2], [[0] * 3] * max(LEAD), 0)


def step(state: State, action: list[Word], draws: Draws) -> tuple[State, Word, Word]:
    """Let each stage order, receive what comes and sell what it can; the reward is the profit of all."""
    draw = draws.bits()
    demand = sum(draw >= threshold for threshold in DEMANDS)
    stored, coming = state.stored, [state.coming_0, state.coming_1, state.coming_2]
    orders = [min(units, most) for units, most in zip(action, CAPACITY, strict=True)]
    # A supplier ships what it has before anything arrives.
    shipped = [min(orders[0], stored[1]), min(orders[1], stored[2]), orders[2]]
    stored = [min(units + first, MOST_STORED) for units, (first, *_) in zip(stored, coming, strict=True)]
    sold = [min(demand, stored[0]), *shipped]
    stored = [max(units - taken, 0) for units, taken in zip(stored, sold[:3], strict=True)]
    missed = [asked - taken for asked, taken in zip([demand, *orders], sold, strict=True)]
    costs = sum(map(mul, COST, shipped)) + PLANT_COST * shipped[2]
    costs += sum(map(mul, PENALTY, missed))
    costs += sum(map(mul, HOLDING, stored))
    profit = (sum(map(mul, PRICE, sold)) - costs) * WORTH[state.period] >> 12
    first, second, third = ([*later, units] for (_, *later), units in zip(coming, shipped, strict=True))
    period = min(state.period + 1, PERIODS - 1)
    return State(stored, first, second, third, [*state.orders[1:], orders], period), profit, False


def observe(state: State) -> View:
    """Return the observation, with the oldest orders first."""
    return View(state.stored, state.orders)
