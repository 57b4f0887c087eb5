"""The golden step of Overcooked, for any kitchen with two cooks.

A state lists for each cook the cell, the direction he faces and what he holds; then the counters, in bit
planes; then the soup and the clock of each pot; and then the time, as far as it matters. Cells, counters
and pots are numbered as :mod:`.kitchen` lists those within reach.

- Counter ``k`` has bit ``k`` of every plane. So putting down, picking up and looking for dishes on all
  counters take a few instructions, however many counters there are.
- A clock is 0 while a pot does not cook and 1 when its soup is done. In between it is the time left, plus 1.

What looks arbitrary is the package's:

- First both cooks act, cook 0 before cook 1; then both move; then pots cook. So a soup cooks in the very
  step that starts it.
- If both want the same cell, or each other's, nobody moves; but they turn.
- Any soup can be cooked and served, even one of a single ingredient. One that nobody ordered pays nothing.
- Taking a dish is useful if no dish lies on a counter and fewer are held than pots wait for one. Pots are
  counted as they were before anybody acted, without those that are full and do not cook. Dishes are counted
  as they are.

Follows https://github.com/HumanCompatibleAI/overcooked_ai (``overcooked-ai`` 1.1.0): M. Carroll et al., *On
the Utility of Learning about Humans for Human-AI Coordination*, 2019.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pearl_marl.golden import GoldenFunction, Word

from .kitchen import MORE, MOST, STATIONS, Kitchen

STAY, INTERACT = 4, 5
"""The actions before them are directions."""
NOTHING, POTTED, DISH_TAKEN, SOUP_TAKEN = range(4)
"""What came of a cook's action; from 4 on it is a soup served, by its price."""
URGENT = 40
"""A state is urgent if fewer steps are left than this."""


def last_calm(horizon: int) -> int:
    """Return the last time that is not urgent."""
    return horizon - URGENT


def rewards(kitchen: Kitchen, shaped: Sequence[float]) -> tuple[float, ...]:
    """Return the reward of each category, which is what came of a cook's action and what the other served.

    Both cooks get the price of a soup. ``shaped`` is what one gets for himself if he puts an ingredient
    into a pot, takes a dish that is useful, or takes a soup from its pot.
    """
    own = [0.0, *shaped, *kitchen.prices[1:]]
    return tuple(float(one + other) for one in own for other in kitchen.prices)


def make_initial(kitchen: Kitchen, horizon: int) -> GoldenFunction:
    """Return the golden function of the start: pots and hands are empty, and both cooks face north."""
    start = [word for cell in kitchen.starts for word in (cell, 0, 0)]
    start += [0] * (kitchen.item_bits + 2 * len(kitchen.pots) + has_time(horizon))

    def initial() -> tuple[Word, ...]:
        return tuple(start)

    return initial


def has_time(horizon: int) -> bool:
    """Return whether the state has the time, which it needs unless every step is urgent."""
    return horizon >= URGENT


def make_step(kitchen: Kitchen, horizon: int) -> GoldenFunction:
    """Return the golden step of a kitchen."""
    things, times, classes = kitchen.things, kitchen.times, kitchen.classes
    onion, dish, tomato, bits = kitchen.onion, kitchen.dish, kitchen.tomato, kitchen.item_bits
    counters, pots, floor = len(kitchen.counters), len(kitchen.pots), kitchen.first_floor
    onions, tomatoes, dishes, serving = range(floor - len(STATIONS), floor)
    any_soup, n_prices = (1 << kitchen.soup_bits) - 1, len(kitchen.prices)
    is_full = [len(kitchen.soups.get(soup, "")) == MOST for soup in range(any_soup + 1)]

    def step(*words: Word) -> tuple[Word, ...]:
        *state, action_0, action_1 = words
        actions = action_0, action_1
        cells, facing, holds = (list(state[k:6:3]) for k in range(3))
        planes = state[6 : 6 + bits]
        soups, clocks = (list(state[k : 6 + bits + 2 * pots : 2]) for k in (6 + bits, 7 + bits))
        facing = [np.where(action < STAY, action, old) for action, old in zip(actions, facing, strict=True)]
        faced = [things[cell << 2 | to] for cell, to in zip(cells, facing, strict=True)]

        waiting: Word = 0
        for soup, clock in zip(soups, clocks, strict=True):
            waiting = waiting + ((clock > 0) | ((soup > 0) & (is_full[soup] == 0)))
        outcomes: list[Word] = []
        served: list[Word] = []
        for k in range(2):
            acts, thing, held = actions[k] == INTERACT, faced[k], holds[k]
            empty = held == 0
            is_dish, is_onion, is_tomato = held == dish, held == onion, held == tomato
            is_soup = (empty | is_dish | is_onion | is_tomato) == 0

            # Hand and counter swap what they have, if one of them has nothing.
            counter = np.minimum(thing, counters - 1)
            there: Word = 0
            for bit, plane in enumerate(planes):
                there = there | (plane >> counter & 1) << bit
            change = np.where(acts & (thing < counters) & (empty | (there == 0)), held ^ there, 0)
            planes = [plane ^ (change >> bit & 1) << counter for bit, plane in enumerate(planes)]

            takes = acts & empty
            takes_dish = takes & (thing == dishes)
            useful = takes_dish & (on_counters(planes, dish) == 0)
            useful = useful & ((holds[0] == dish) + (holds[1] == dish) < waiting)
            serves = acts & is_soup & (thing == serving)
            price = np.where(serves, classes[held], 0)

            potted: Word = 0
            soup_taken: Word = 0
            new: Word = held ^ change
            for pot in range(pots):
                here, soup, clock = acts & (thing == counters + pot), soups[pot], clocks[pot]
                starts = here & empty & (soup > 0) & (clock == 0)
                dished = here & is_dish & (clock == 1)
                added = here & (is_onion | is_tomato) & (clock == 0) & (is_full[soup] == 0)
                more = np.where(added, np.where(is_onion, MORE["o"], MORE["t"]), 0)
                soups[pot] = np.where(dished, 0, (soup + more) & any_soup)
                clocks[pot] = np.where(starts, times[soup] + 1, np.where(dished, 0, clock))
                new = np.where(dished, soup, new)
                potted, soup_taken = potted | added, soup_taken | dished
            new = np.where(takes & (thing == onions), onion, new)
            if tomato > 0:
                new = np.where(takes & (thing == tomatoes), tomato, new)
            new = np.where(takes_dish, dish, new)
            holds[k] = np.where(potted | serves, 0, new)
            outcome = np.where(useful, DISH_TAKEN, np.where(potted, POTTED, NOTHING))
            outcome = np.where(soup_taken, SOUP_TAKEN, outcome)
            outcomes.append(np.where(price > 0, SOUP_TAKEN + price, outcome))
            served.append(price)

        ahead = [
            np.where((action < STAY) & (thing >= floor), np.maximum(thing - floor, 0), cell)
            for action, thing, cell in zip(actions, faced, cells, strict=True)
        ]
        crossing = (ahead[0] == cells[1]) & (ahead[1] == cells[0])
        blocked = (ahead[0] == ahead[1]) | crossing
        cells = [np.where(blocked, old, new) for old, new in zip(cells, ahead, strict=True)]
        clocks = [clock - (clock > 1) for clock in clocks]

        result: list[Word] = []
        for k in range(2):
            result += [cells[k], facing[k], holds[k]]
        result += planes
        for soup, clock in zip(soups, clocks, strict=True):
            result += [soup, clock]
        if has_time(horizon):
            result.append(np.minimum(state[-1] + 1, last_calm(horizon) + 1))
        for k in range(2):
            result.append(outcomes[k] * n_prices + served[1 - k])
        return *result, 0, 0

    return step


def on_counters(planes: list[Word], item: int) -> Word:
    """Return a bit for each counter: whether an item lies there."""
    result: Word = -1
    for bit, plane in enumerate(planes):
        result = result & (plane if item >> bit & 1 else ~plane)
    return result


def make_observe(kitchen: Kitchen, horizon: int) -> GoldenFunction:
    """Return the golden function of what a cook sees: everything, himself first, and all pots in one word."""
    bits, pots = kitchen.item_bits, len(kitchen.pots)
    soup_bits = kitchen.soup_bits
    pot_bits = soup_bits + clock_bits(kitchen)

    def observe(*words: Word) -> tuple[Word, ...]:
        *state, agent = words
        own, other = state[3 * agent : 3 * agent + 3], state[3 - 3 * agent : 6 - 3 * agent]
        planes, soups = state[6 : 6 + bits], state[6 + bits : 6 + bits + 2 * pots]
        together: Word = 0
        for pot in range(pots):
            together = together | (soups[2 * pot] | soups[2 * pot + 1] << soup_bits) << pot_bits * pot
        urgent = state[-1] > last_calm(horizon) if has_time(horizon) else 1
        return *own, *other, *planes, together, urgent

    return observe


def clock_bits(kitchen: Kitchen) -> int:
    """Return how many bits a pot's clock takes."""
    return max(kitchen.times).bit_length()
