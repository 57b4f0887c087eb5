"""The golden step of Level-Based Foraging: players walk on a grid and pick up food together.

A state lists row, column and level of each player, then those of the foods from the top left to the bottom
right, as they are observed, and then what all food was worth at the start, where rewards are shares of that.
A food of level 0 is none.

What looks arbitrary is the package's:

- A player moves if nobody else wants to be where he would be, not even by staying. Two may change places. And
  one may follow another who then cannot move himself: so two can be in one cell.
- Food starts neither on an edge nor near other food, so that a player is never beside two of them.
- Who does not see the whole grid gives places from the top left corner of what he sees, which the grid's
  upper and left edge cut off. Whether he sees a player goes by these numbers; so near those edges he sees
  players farther than food.

Follows https://github.com/semitable/lb-foraging (2.0.0): F. Christianos, L. Schäfer and S. V. Albrecht,
*Shared Experience Actor-Critic for Multi-Agent Reinforcement Learning*, 2020.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from pearl_marl.golden import GoldenFunction, Word, another, draws_of, inserted, u32

NORTH, SOUTH, WEST, EAST, LOAD = range(1, 6)
NOTHING, FAILED, LOADED = 0, 1, 2
"""Categories of reward; what is loaded counts from the last."""
PAIRS, NIBBLES, BYTES, SHORTS, WORDS = 0x55555555, 0x33333333, 0x0F0F0F0F, 0x00FF00FF, 0x0000FFFF

Thing: TypeAlias = tuple[Word, Word, Word]
"""Row, column and level of a player or a food."""
NOWHERE: Thing = (-1, -1, 0)


class Rules(NamedTuple):
    """What the options come to."""

    size: int
    player_levels: tuple[tuple[int, int], ...]
    """The least and the greatest of each player; who has which is drawn."""
    food_levels: tuple[tuple[int, int | None], ...]
    """The same; where the greatest is None, it is the sum of the three lowest players' levels."""
    greatest_only: bool
    """Whether all food is of its greatest level."""
    sight: int
    shows_levels: bool
    """Whether players see levels of players."""
    normalized: bool

    @property
    def players(self) -> int:
        """How many play."""
        return len(self.player_levels)

    @property
    def foods(self) -> int:
        """How many foods there are at most."""
        return len(self.food_levels)

    @property
    def strongest(self) -> int:
        """The greatest level of a player that there can be."""
        return max(most for _, most in self.player_levels)

    @property
    def most_food(self) -> int:
        """The greatest level of a food that there can be."""
        given = [most for _, most in self.food_levels if most is not None]
        return max(given) if given else sum(sorted(most for _, most in self.player_levels)[:3])

    @property
    def least_food(self) -> int:
        """The least."""
        if not self.greatest_only:
            return min(least for least, _ in self.food_levels)
        given = [most for _, most in self.food_levels if most is not None]
        return min(given) if given else sum(sorted(least for least, _ in self.player_levels)[:3])

    @property
    def sees_all(self) -> bool:
        """Whether every player sees the whole grid from everywhere."""
        return self.sight >= self.size - 1

    @property
    def limits(self) -> tuple[tuple[int, int], ...]:
        """The least and the greatest of each number that a reward is made of, as :func:`rewards` has them."""
        weakest = min(least for least, _ in self.player_levels)
        own, food = (weakest, self.strongest), (self.least_food, self.most_food)
        if not self.normalized:
            return own, food
        together = sum(most for _, most in self.player_levels)
        return own, food, (weakest, together), (self.least_food, self.foods * self.most_food)

    @property
    def draws(self) -> list[int]:
        """Which draw makes each decision at the start, in the order of :func:`make_initial`."""
        outcomes: list[int] = []
        for k in range(self.players):
            outcomes += [self.size**2 - k, *([self.players - k] if differ(self.player_levels) else [])]
            outcomes.append(max(most - least for least, most in self.player_levels) + 1)
        for k in range(self.foods):
            outcomes += [(self.size - 2) ** 2, *([self.foods - k] if differ(self.food_levels) else [])]
            outcomes.append(self.most_food - self.least_food + 1)
        return draws_of(outcomes)


def differ(levels: Sequence[object]) -> bool:
    """Return whether it matters who has which levels."""
    return len(set(levels)) > 1


def rewards(rules: Rules, penalty: float) -> tuple[float, ...]:
    """Return the reward of each category.

    Beside nothing and the penalty it is the player's level times the food's. Normalized, it is divided by the
    product of the levels of all who load it and those of all food.
    """
    numbers = itertools.product(*(range(low, high + 1) for low, high in rules.limits))
    # Rounded once, as the package does it.
    loaded = (own * food / (shared[0] * shared[1] if shared else 1) for own, food, *shared in numbers)
    return 0.0, 0 - penalty, *loaded


def make_initial(rules: Rules) -> GoldenFunction:
    """Return the golden function that puts players and food onto a new grid.

    Players are in different cells. Food comes to any cell that is free, not on an edge and far enough from
    other food, each as likely; where there is none left, there is no more food. (The package tries cells by
    chance, up to 1000 times.) The decisions are digits of the draws: the upper half of a product is one, its
    lower half serves as the next draw.
    """
    size, inner = rules.size, range(1, rules.size - 1)
    weakest, strongest = zip(*rules.player_levels, strict=True)
    lightest, heaviest = zip(*rules.food_levels, strict=True)
    players_differ, foods_differ = differ(rules.player_levels), differ(rules.food_levels)

    def initial(*words: Word) -> tuple[Word, ...]:
        left, order = list(words), iter(rules.draws)

        def decide(n: Word) -> Word:
            k = next(order)
            product = left[k] * n
            left[k] = u32(product)
            return product >> 32

        state: list[Word] = []
        cells: list[Word] = []
        levels: list[Word] = []
        which: Word = 0
        given: list[Word] = []
        free: list[Word] = [sum(1 << column for column in inner)] * size  # a bit a column
        for k in range(rules.players):
            cell = another(decide(size * size - k), cells)
            row, column = cell // size, cell % size
            if players_differ:
                which = another(decide(rules.players - k), given)
                given = inserted(given, which)
            level = weakest[which] + decide(strongest[which] - weakest[which] + 1)
            level = np.minimum(level, rules.strongest)  # it is no more, which the compiler cannot see
            state += [row, column, level]
            cells, levels = inserted(cells, cell), inserted(levels, level)
            free = [free[r] & ~np.where(row == r, 1 << column, 0) for r in range(size)]

        which, given = 0, []
        foods: list[tuple[Word, Word]] = []
        total: Word = 0
        for k in range(rules.foods):
            counts = [ones(free[r]) for r in inner]
            room = sum(counts)
            row, column = chosen([free[r] for r in inner], counts, decide(room))
            if foods_differ:
                which = another(decide(rules.foods - k), given)
                given = inserted(given, which)
            most = sum(levels[:3]) if heaviest[0] is None else heaviest[which]
            least = most if rules.greatest_only else lightest[which]
            level = np.minimum(least + decide(most - least + 1), rules.most_food)
            level = np.where(room == 0, 0, level)
            free = [free[r] & ~around(row - r, column) for r in range(size)]
            total = total + level
            # Into its place among the others, which are in order.
            food, placed = (row * size + column, level), []
            for other in foods:
                first = food[0] < other[0]
                placed.append((np.where(first, food[0], other[0]), np.where(first, food[1], other[1])))
                food = np.where(first, other[0], food[0]), np.where(first, other[1], food[1])
            foods = [*placed, food]
        for cell, level in foods:
            state += [cell // size, cell % size, level]
        return *state, *([total] if rules.normalized else [])

    return initial


def ones(word: Word) -> Word:
    """Count the ones of up to 32 bits."""
    for width, kept in ((1, PAIRS), (2, NIBBLES), (4, BYTES), (8, SHORTS), (16, WORDS)):
        word = (word & kept) + (word >> width & kept)
    return word


def chosen(lines: Sequence[Word], counts: Sequence[Word], rank: Word) -> tuple[Word, Word]:
    """Return row and column of one of the ones in ``lines``, which are the rows from 1."""
    before: Word = 0
    row: Word = 1
    line: Word = 0
    within: Word = 0
    for k, (bits, count) in enumerate(zip(lines, counts, strict=True)):
        here = (rank >= before) & (rank < before + count)
        row, line = np.where(here, k + 1, row), np.where(here, bits, line)
        within = np.where(here, rank - before, within)
        before = before + count
    passed: Word = 0
    column: Word = 1
    for k in range(1, len(lines)):
        passed = passed + (line >> k & 1)
        column = column + (passed <= within)
    return row, column


def around(below: Word, column: Word) -> Word:
    """Return the columns of a row where no more food may be, for food that is so many rows below it."""
    distance = abs(below)
    nearest, near, far = (31 << column) >> 2, (7 << column) >> 1, 1 << column
    far = np.where(distance == 2, far, 0)
    return np.where(distance == 0, nearest, np.where(distance == 1, near, far))


def parts(rules: Rules, state: Sequence[Word]) -> tuple[list[Thing], list[Thing]]:
    """Return the players and the foods of a state."""
    things = [tuple(state[3 * k : 3 * k + 3]) for k in range(rules.players + rules.foods)]
    return things[: rules.players], things[rules.players :]


def make_step(rules: Rules) -> GoldenFunction:
    """Return the golden step.

    An action that the mask leaves out is a wait, as it is in the package.
    """
    count, last = rules.players, rules.size - 1
    state_words = 3 * (count + rules.foods) + rules.normalized

    def step(*words: Word) -> tuple[Word, ...]:
        state, actions = words[:state_words], words[state_words : state_words + count]
        players, foods = parts(rules, state)
        targets = []
        for (row, column, _), action in zip(players, actions, strict=True):
            up_down = np.clip(row + (action == SOUTH) - (action == NORTH), 0, last)
            aside = np.clip(column + (action == EAST) - (action == WEST), 0, last)
            blocked = any_of((level != 0) & (r == up_down) & (c == aside) for r, c, level in foods)
            targets.append((np.where(blocked, row, up_down), np.where(blocked, column, aside)))

        moved = []
        for k, ((row, column, level), (r, c)) in enumerate(zip(players, targets, strict=True)):
            others = targets[:k] + targets[k + 1 :]
            contested = any_of((r == other[0]) & (c == other[1]) for other in others)
            moved.append((np.where(contested, row, r), np.where(contested, column, c), level))

        # Who loads does not move, so it does not matter that others have.
        loading = [
            [(action == LOAD) & is_beside(player, food) for food in foods]
            for player, action in zip(players, actions, strict=True)
        ]
        left: list[Thing] = []
        food_of: list[Word] = [0] * count
        strength_of: list[Word] = [0] * count
        outcome_of: list[Word] = [NOTHING] * count
        for f, (row, column, level) in enumerate(foods):
            strength = sum(loads[f] * player[2] for loads, player in zip(loading, players, strict=True))
            taken = (level != 0) & (strength >= level)
            left.append((row, column, np.where(taken, 0, level)))
            for k in range(count):
                here = loading[k][f]
                food_of[k] = np.where(here, level, food_of[k])
                strength_of[k] = np.where(here, strength, strength_of[k])
                outcome_of[k] = np.where(here, np.where(taken, LOADED, FAILED), outcome_of[k])
        categories = []
        for k, outcome in enumerate(outcome_of):
            numbers = players[k][2], food_of[k], strength_of[k], state[-1]
            what: Word = 0
            for number, (low, high) in zip(numbers[: len(rules.limits)], rules.limits, strict=True):
                what = what * (high - low + 1) + np.clip(number, low, high) - low
            categories.append(np.where(outcome == LOADED, LOADED + what, outcome))
        over = any_of(level for _, _, level in left) == 0
        after = [word for thing in (*moved, *left) for word in thing]
        return *after, *state[len(after) :], *categories, *[over] * count

    return step


def any_of(flags: Iterator[Word]) -> Word:
    """Return a word that is 0 where all of these are."""
    result: Word = 0
    for flag in flags:
        result = result | flag
    return result


def is_beside(player: Thing, food: Thing) -> Word:
    """Return whether food is next to a player, in a row or a column."""
    return (food[2] != 0) & (abs(food[0] - player[0]) + abs(food[1] - player[1]) == 1)


def make_masks(rules: Rules) -> GoldenFunction:
    """Return the golden function of an agent's mask: food and edges are in the way, players are not."""

    def masks(*words: Word) -> tuple[Word, ...]:
        players, foods = parts(rules, words)
        row, column, _ = player = players[agent_of(rules, words)]
        last = rules.size - 1

        def free(up_down: int, aside: int) -> Word:
            taken = ((f != 0) & (r == row + up_down) & (c == column + aside) for r, c, f in foods)
            return any_of(taken) == 0

        return (
            1,
            (row > 0) & free(-1, 0),
            (row < last) & free(1, 0),
            (column > 0) & free(0, -1),
            (column < last) & free(0, 1),
            any_of(is_beside(player, food) for food in foods),
        )

    return masks


def make_observe(rules: Rules) -> GoldenFunction:
    """Return the golden function of what an agent observes: foods, itself, and other players."""

    def observe(*words: Word) -> tuple[Word, ...]:
        players, foods = parts(rules, words)
        agent = agent_of(rules, words)
        row, column, _ = players[agent]
        corner, sight = (0, 0), rules.sight
        if not rules.sees_all:
            corner = np.maximum(row - sight, 0), np.maximum(column - sight, 0)

        def placed(things: Sequence[Thing]) -> list[Thing]:
            return [(r - corner[0], c - corner[1], level) for r, c, level in things]

        def in_sight(row: Word, column: Word) -> Word:
            return (row >= 0) & (row <= 2 * sight) & (column >= 0) & (column <= 2 * sight)

        shown = [f != 0 for _, _, f in foods]
        others = placed(players[:agent] + players[agent + 1 :])
        if not rules.sees_all:
            near = [(abs(r - row) <= sight) & (abs(c - column) <= sight) for r, c, _ in foods]
            shown = [a & b for a, b in zip(shown, near, strict=True)]
            others = closed_up(others, [in_sight(r, c) for r, c, _ in others])
        seen = closed_up(placed(foods), shown)
        result = [word for food in seen for word in food]
        for thing in (*placed(players[agent : agent + 1]), *others):
            result += thing if rules.shows_levels else thing[:2]
        return tuple(result)

    return observe


def agent_of(rules: Rules, words: Sequence[Word]) -> int:
    """Return the agent, the last of an observer's words; who plays alone is not named."""
    agent: int = words[-1] if rules.players > 1 else 0
    return agent


def closed_up(things: Sequence[Thing], flags: Sequence[Word]) -> list[Thing]:
    """Return the things with a flag without gaps in between, and after them nothing."""
    result: list[Thing] = []
    for place in range(len(things)):
        rank: Word = 0
        found = NOWHERE
        for thing, flag in zip(things, flags, strict=True):
            found = tuple(
                np.where(flag & (rank == place), new, old) for new, old in zip(thing, found, strict=True)
            )
            rank = rank + flag
        result.append(found)
    return result
