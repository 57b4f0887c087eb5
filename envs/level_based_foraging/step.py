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

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

from pearl_marl.envs.free_cells import CellWords, count_of
from pearl_marl.golden import Draws, Word, another, inserted
from pearl_marl.layout import Array, Bits, Range, Signed
from pearl_marl.spec import Golden

NORTH, SOUTH, WEST, EAST, LOAD = range(1, 6)
NOTHING, FAILED, LOADED = 0, 1, 2
"""Categories of reward; what is loaded counts from the last."""
Thing: TypeAlias = Any
"""A player or a food: its `row`, its `column` and its `level`."""
NOTHING_SEEN = -1, -1, 0
FAR = -2
"""A row that no cell is in or beside."""


class ForagingRules(NamedTuple):
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


def differ(levels: Sequence[object]) -> bool:
    """Return whether it matters who has which levels."""
    return len(set(levels)) > 1


def rewards(rules: ForagingRules, penalty: float) -> tuple[float, ...]:
    """Return the reward of each category.

    Beside nothing and the penalty it is the player's level times the food's. Normalized, it is divided by the
    product of the levels of all who load it and those of all food.
    """
    numbers = itertools.product(*(range(low, high + 1) for low, high in rules.limits))
    # Rounded once, as the package does it.
    loaded = (own * food / (shared[0] * shared[1] if shared else 1) for own, food, *shared in numbers)
    return 0.0, 0 - penalty, *loaded


def make_golden(rules: ForagingRules) -> Golden:
    """Return the state of a game and its golden functions."""
    size, last, grid = rules.size, rules.size - 1, CellWords(rules.size)
    weakest, strongest = zip(*rules.player_levels, strict=True)
    lightest, heaviest = zip(*rules.food_levels, strict=True)
    most_levels = max(most - least for least, most in rules.player_levels) + 1
    players_differ, foods_differ = differ(rules.player_levels), differ(rules.food_levels)
    (lowest, highest), *shared = rules.limits
    weight = math.prod(high - low + 1 for low, high in shared)
    place, seen_place = Range[0, last], Signed[last.bit_length() + 1]
    player_level, food_level = Range[0, rules.strongest], Range[0, rules.most_food]

    class Player(NamedTuple):
        row: place
        column: place
        level: player_level

    class Food(NamedTuple):
        row: place
        column: place
        level: food_level

    class State(NamedTuple):
        players: Array[Player, rules.players]
        foods: Array[Food, rules.foods]
        all_food: Bits[(rules.foods * rules.most_food).bit_length() * rules.normalized]

    class SeenFood(NamedTuple):
        row: seen_place
        column: seen_place
        level: food_level

    class SeenPlayer(NamedTuple):
        row: seen_place
        column: seen_place
        level: Bits[rules.strongest.bit_length() * rules.shows_levels]

    class View(NamedTuple):
        foods: Array[SeenFood, rules.foods]
        players: Array[SeenPlayer, rules.players]

    def initial(draws: Draws) -> State:
        """Put players and food onto a new grid.

        Players are in different cells. Food comes to any cell that is free, not on an edge and far enough
        from other food, each as likely; where there is none left, there is no more food. (The package tries
        cells by chance, up to 1000 times.)
        """
        cells: list[Word] = []
        levels: list[Word] = []
        given: list[Word] = []
        players, which = [], 0
        free = grid.all_free()
        for _ in range(rules.players):
            cell, cells = another(draws, size * size, cells)
            if players_differ:
                which, given = another(draws, rules.players, given)
            level = weakest[which] + draws.digit(strongest[which] - weakest[which] + 1, most_levels)
            level = min(level, rules.strongest)  # it is no more, which the compiler cannot see
            player = Player(cell // size, cell % size, level)
            players.append(player)
            levels = inserted(levels, level)
            free = grid.without(free, player.row, player.column)

        foods: list[tuple[Word, Word]] = []
        which, given = 0, []
        for _ in range(rules.foods):
            counts = [count_of(word) for word in free]
            room = sum(counts)
            cell = grid.chosen(free, counts, draws.digit(room, (size - 2) ** 2))
            row, column = cell if room else (1, last - 1)
            if foods_differ:
                which, given = another(draws, rules.foods, given)
            most = sum(levels[:3]) if heaviest[0] is None else heaviest[which]
            least = most if rules.greatest_only else lightest[which]
            level = least + draws.digit(most - least + 1, rules.most_food - rules.least_food + 1)
            level = min(level, rules.most_food) if room else 0
            free = grid.far_from(free, row, column, 2)
            # Into its place among the others, which are in order.
            food = row * size + column, level
            for k, other in enumerate(foods):
                if food[0] < other[0]:
                    foods[k], food = food, other
            foods.append(food)
        placed = [Food(cell // size, cell % size, level) for cell, level in foods]
        return State(players, placed, sum(level for _, level in foods))

    def step(state: State, actions: Sequence[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
        """Let players move and load; an action that the mask leaves out is a wait, as in the package."""
        foods = foods_of(state)
        players = list(zip(state.players, actions, strict=True))
        wishes = [wish(player, action, foods) for player, action in players]
        moved = []
        for k, (player, cell) in enumerate(zip(state.players, wishes, strict=True)):
            contested = any(cell == other for other in wishes[:k] + wishes[k + 1 :])
            row, column = (player.row, player.column) if contested else cell
            moved.append(player._replace(row=row, column=column))

        # Who loads does not move, so it does not matter that others have.
        left = []
        loads = [NOTHING] * rules.players
        for food in foods:
            loading = [action == LOAD and is_beside(player, food) for player, action in players]
            strength = sum(player.level for (player, _), own in zip(players, loading, strict=True) if own)
            taken = food.level != 0 and strength >= food.level
            left.append(0 if taken else food.level)
            outcome = LOADED + number((food.level, strength, state.all_food)) if taken else FAILED
            loads = [outcome if own else other for own, other in zip(loading, loads, strict=True)]
        rewards = [
            load + (min(max(player.level, lowest), highest) - lowest) * weight if load >= LOADED else load
            for player, load in zip(state.players, loads, strict=True)
        ]
        over = not any(left)
        remaining = [food._replace(level=level) for food, level in zip(state.foods, left, strict=True)]
        return state._replace(players=moved, foods=remaining), rewards, [over] * rules.players

    def wish(player: Thing, action: Word, foods: Sequence[Thing]) -> tuple[Word, Word]:
        """Return row and column that a player wants to be in: edges and food are in its way."""
        row = min(max(player.row + (action == SOUTH) - (action == NORTH), 0), last)
        column = min(max(player.column + (action == EAST) - (action == WEST), 0), last)
        return (player.row, player.column) if is_food(foods, row, column) else (row, column)

    def number(parts: Sequence[Word]) -> Word:
        """Return the number of what is loaded among :func:`rewards`, for a player of the lowest level."""
        result = 0
        for part, (low, high) in zip(parts[: len(shared)], shared, strict=True):
            result = result * (high - low + 1) + min(max(part, low), high) - low
        return result

    def masks(state: State, agent: int) -> tuple[Word, ...]:
        """Return which actions are possible: food and edges are in the way, players are not."""
        player, foods = state.players[agent], foods_of(state)
        row, column, _ = player
        return (
            1,
            row > 0 and not is_food(foods, row - 1, column),
            row < last and not is_food(foods, row + 1, column),
            column > 0 and not is_food(foods, row, column - 1),
            column < last and not is_food(foods, row, column + 1),
            any(is_beside(player, food) for food in foods),
        )

    def observe(state: State, agent: int) -> tuple[list[Thing], list[Thing]]:
        """Return what a player sees: foods, itself, and other players."""
        me, sight = state.players[agent], rules.sight
        others = state.players[:agent] + state.players[agent + 1 :]
        shown = [food.level != 0 for food in state.foods]
        if rules.sees_all:
            foods, players = closed_up(state.foods, shown), [me, *others]
        else:
            top, left = max(me.row - sight, 0), max(me.column - sight, 0)
            for k, food in enumerate(state.foods):
                shown[k] &= (abs(food.row - me.row) <= sight) & (abs(food.column - me.column) <= sight)
            mine, *theirs = [(p.row - top, p.column - left, p.level) for p in (me, *others)]
            near = [0 <= row <= 2 * sight and 0 <= column <= 2 * sight for row, column, _ in theirs]
            foods = closed_up([(f.row - top, f.column - left, f.level) for f in state.foods], shown)
            players = [mine, *closed_up(theirs, near)]
        return foods, players if rules.shows_levels else [player[:2] for player in players]

    return Golden(State, initial, step, observe, masks, View)


def foods_of(state: Any) -> list[Thing]:
    """Return the foods; those that are none are far from every cell."""
    return [food if food.level else food._replace(row=FAR) for food in state.foods]


def is_food(foods: Sequence[Thing], row: Word, column: Word) -> Word:
    """Return whether there is food in a cell."""
    return any(food.row == row and food.column == column for food in foods)


def is_beside(player: Thing, food: Thing) -> Word:
    """Return whether food is next to a player, in a row or a column."""
    return abs(food.row - player.row) + abs(food.column - player.column) == 1


def closed_up(things: Sequence[Thing], flags: Sequence[Word]) -> list[Thing]:
    """Return the things with a flag without gaps in between, and after them nothing."""
    result, count = [NOTHING_SEEN] * len(things), 0
    for thing, flag in zip(things, flags, strict=True):
        if flag:
            result[count] = thing
        count += flag
    return result
