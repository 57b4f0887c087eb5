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

from collections.abc import Sequence
from typing import Any, NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Bits, Flag, Layout
from pearl_marl.spec import Golden

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


def has_time(horizon: int) -> bool:
    """Return whether the state has the time, which it needs unless every step is urgent."""
    return horizon >= URGENT


def clock_bits(kitchen: Kitchen) -> int:
    """Return how many bits a pot's clock takes."""
    return max(kitchen.times).bit_length()


def make_golden(kitchen: Kitchen, horizon: int) -> Golden:
    """Return the golden functions of a kitchen with a time limit."""
    things, times, classes = kitchen.things, kitchen.times, kitchen.classes
    onion, dish, tomato = kitchen.onion, kitchen.dish, kitchen.tomato
    first_pot, floor = len(kitchen.counters), kitchen.first_floor
    onions, tomatoes, dishes, serving = range(floor - len(STATIONS), floor)
    soup_bits, pot_bits = kitchen.soup_bits, kitchen.soup_bits + clock_bits(kitchen)
    any_soup, n_prices = (1 << soup_bits) - 1, len(kitchen.prices)
    is_full = [len(kitchen.soups.get(soup, "")) == MOST for soup in range(any_soup + 1)]

    class Cook(NamedTuple):
        cell: Bits[kitchen.cell_bits]
        facing: Bits[2]
        holds: Bits[kitchen.item_bits]

    class Pot(NamedTuple):
        soup: Bits[soup_bits]
        clock: Bits[clock_bits(kitchen)]

    class State(NamedTuple):
        cooks: Array[Cook, 2]
        counters: Array[Bits[len(kitchen.counters)], kitchen.item_bits]
        pots: Array[Pot, len(kitchen.pots)]

    class TimedState(NamedTuple):
        cooks: Array[Cook, 2]
        counters: Array[Bits[len(kitchen.counters)], kitchen.item_bits]
        pots: Array[Pot, len(kitchen.pots)]
        time: Bits[max(1, (last_calm(horizon) + 1).bit_length())]

    class View(NamedTuple):
        own: Cook
        other: Cook
        counters: Array[Bits[len(kitchen.counters)], kitchen.item_bits]
        pots: Bits[len(kitchen.pots) * pot_bits]
        urgent: Flag

    state_class = TimedState if has_time(horizon) else State
    layout = Layout(state_class)
    start = dict.fromkeys((word.name for word in layout.fields), 0)
    start |= {f"cooks_{k}_cell": cell for k, cell in enumerate(kitchen.starts)}

    def initial(draws: Draws) -> Any:
        """Return the start: pots and hands are empty, and both cooks face north."""
        return layout.built(start.values())

    def step(state: Any, actions: list[Word], draws: Draws) -> tuple[Any, list[Word], list[Word]]:
        cells, facing, holds = ([cook[part] for cook in state.cooks] for part in range(3))
        planes, pots = list(state.counters), list(state.pots)
        facing = [action if action < STAY else old for action, old in zip(actions, facing, strict=True)]
        faced = [things[cell << 2 | to] for cell, to in zip(cells, facing, strict=True)]

        waiting = sum(pot.clock > 0 or (pot.soup > 0 and not is_full[pot.soup]) for pot in pots)
        outcomes, served = [NOTHING, NOTHING], [0, 0]
        for k in range(2):
            acts, thing, held = actions[k] == INTERACT, faced[k], holds[k]
            # Hand and counter swap what they have, if one of them has nothing.
            counter = min(thing, first_pot - 1)
            there = item_at(planes, counter)
            swaps = acts and thing < first_pot and (held == 0 or there == 0)
            change = held ^ there if swaps else 0
            planes = [plane ^ (change >> bit & 1) << counter for bit, plane in enumerate(planes)]
            holds[k] = held ^ change

            for number, pot in enumerate(pots):
                here = acts and thing == first_pot + number
                soup, clock = pot
                starts = here and held == 0 and soup > 0 and clock == 0
                takes = here and held == dish and clock == 1
                adds = here and held in (onion, tomato) and clock == 0 and not is_full[soup]
                more = 0
                if adds:
                    more = MORE["o"] if held == onion else MORE["t"]
                    holds[k], outcomes[k] = 0, POTTED
                new = (soup + more) & any_soup
                if takes:
                    holds[k], new, clock, outcomes[k] = soup, 0, 0, SOUP_TAKEN
                if starts:
                    clock = times[soup] + 1
                pots[number] = pot._replace(soup=new, clock=clock)
            if acts and held == 0:
                if thing == onions:
                    holds[k] = onion
                elif thing == tomatoes and tomato > 0:
                    holds[k] = tomato
                elif thing == dishes:
                    if on_counters(planes, dish) == 0 and sum(held == dish for held in holds) < waiting:
                        outcomes[k] = DISH_TAKEN
                    holds[k] = dish
            elif acts and thing == serving and held not in (dish, onion, tomato):
                holds[k] = 0
                served[k] = classes[held]
                if served[k] > 0:
                    outcomes[k] = SOUP_TAKEN + served[k]

        ahead = [
            thing - floor if action < STAY and thing >= floor else cell
            for action, thing, cell in zip(actions, faced, cells, strict=True)
        ]
        if ahead[0] != ahead[1] and not (ahead[0] == cells[1] and ahead[1] == cells[0]):
            cells = ahead
        after = state._replace(
            cooks=[
                old._replace(cell=c, facing=f, holds=h)
                for old, c, f, h in zip(state.cooks, cells, facing, holds, strict=True)
            ],
            counters=planes,
            pots=[pot._replace(clock=pot.clock - (pot.clock > 1)) for pot in pots],
        )
        if has_time(horizon):
            after = after._replace(time=min(state.time + 1, last_calm(horizon) + 1))
        return after, [outcomes[k] * n_prices + served[1 - k] for k in range(2)], [False, False]

    def observe(state: Any, agent: int) -> View:
        """Return what a cook sees: everything, himself first, and all pots in one word."""
        pots = 0
        for k, pot in enumerate(state.pots):
            pots = pots | (pot.soup | pot.clock << soup_bits) << pot_bits * k
        urgent = state.time > last_calm(horizon) if has_time(horizon) else True
        return View(state.cooks[agent], state.cooks[1 - agent], state.counters, pots, urgent)

    return Golden(state_class, initial, step, observe, view=View)


def item_at(planes: list[Word], counter: Word) -> Word:
    """Return the item that lies on a counter."""
    item = 0
    for bit, plane in enumerate(planes):
        item = item | (plane >> counter & 1) << bit
    return item


def on_counters(planes: list[Word], item: int) -> Word:
    """Return a bit for each counter: whether an item lies there."""
    result: Word = -1
    for bit, plane in enumerate(planes):
        result = result & (plane if item >> bit & 1 else ~plane)
    return result
