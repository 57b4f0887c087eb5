"""The golden step of RobotWarehouse: robots bring shelves that are asked for to a goal, and put them back.

No robot can tell shelves apart, so a state does not. It lists of each robot column, row, direction, and the rack that
the shelf it carries is from; then the cells of the shelves that are asked for, carried or not. Each rack holds a
shelf that none of those carried is from. Who puts a shelf into a rack that another robot's is from leaves it his own.

Follows https://github.com/semitable/robotic-warehouse (2.0.0): G. Papoudakis, F. Christianos, L. Schäfer and
S. V. Albrecht, *Benchmarking Multi-Agent Deep Reinforcement Learning Algorithms in Cooperative Tasks*, 2021.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from pearl_marl.golden import GoldenFunction, Word, another, digits, inserted, uniform_below

from .moves import any_of, make_ties, movers
from .rules import Rules

FORWARD, TURN_LEFT, TURN_RIGHT, TOGGLE = range(1, 5)
UP, DOWN, LEFT, RIGHT = range(4)
AFTER_LEFT, AFTER_RIGHT = (LEFT, RIGHT, DOWN, UP), (RIGHT, LEFT, UP, DOWN)
"""A robot's direction after a turn, by the one before."""
NONE = 0
"""The rack that no shelf is from: the cell of that number is on a highway."""


class Robot(NamedTuple):
    """The words of a robot."""

    x: Word
    y: Word
    direction: Word
    origin: Word
    """The rack that the shelf it carries is from."""
    brought: Word = 0
    """Whether it has brought a shelf that was asked for, and has not put it down since; only where that pays."""


def parts(rules: Rules, state: Sequence[Word]) -> tuple[list[Robot], list[Word]]:
    """Return the robots of a state, and the cells of the shelves that are asked for."""
    size = words_of_a_robot(rules)
    robots = [Robot(*state[k * size : (k + 1) * size]) for k in range(rules.robots)]
    return robots, list(state[rules.robots * size : rules.robots * size + rules.requests])


def whole(rules: Rules, robots: Iterable[Robot], requests: Iterable[Word]) -> tuple[Word, ...]:
    """Return the state that has these parts."""
    size = words_of_a_robot(rules)
    return *(word for robot in robots for word in robot[:size]), *requests


def words_of_a_robot(rules: Rules) -> int:
    """Return how many words of a state are a robot's."""
    return 5 if rules.reward == "two_stage" else 4


def decisions(rules: Rules) -> list[int]:
    """Return how many outcomes each decision of a start has."""
    places = rules.width * rules.height
    return [
        *(places - k for k in range(rules.robots)),
        *[len(AFTER_LEFT)] * rules.robots,
        *(rules.racks - k for k in range(rules.requests)),
    ]


def make_initial(rules: Rules) -> GoldenFunction:
    """Return the golden function that puts robots into different cells, and asks for some of the shelves."""
    k, outcomes = rules.robots, decisions(rules)

    def initial(*draws: Word) -> tuple[Word, ...]:
        decided = digits(draws, outcomes)
        taken: list[Word] = []
        places: list[Word] = []
        for rank in decided[:k]:
            places.append(another(rank, taken))
            taken = inserted(taken, places[-1])
        robots = [
            Robot(place % rules.width, place // rules.width, direction, NONE)
            for place, direction in zip(places, decided[k : 2 * k], strict=True)
        ]
        asked: list[Word] = []
        for rank in decided[2 * k :]:
            asked = inserted(asked, another(rank, asked))
        return whole(rules, robots, [rack(rules, number) for number in asked])

    return initial


def rack(rules: Rules, number: Word) -> Word:
    """Return the cell of a rack by its number, from the top left to the bottom right."""
    height, cell, before = rules.column_height, 0, 0
    for columns, rows in zip(rules.rack_columns, rules.rack_rows, strict=True):
        if rows:
            within = np.clip(number - before, 0, len(columns) * len(rows) - 1)
            row, column = within // len(columns), within % len(columns)
            # Between two columns of blocks is a highway, in the middle of the lowest a wide one; and between rows.
            gap = (column >= len(columns) // 2) * (len(rules.rack_columns[0]) - len(columns)) * 3 // 2
            here = rules.cell(1 + column + column // 2 + gap, rows[0] + row + row // height)
            cell = np.where(number >= before, here, cell) if before else here
            before += len(columns) * len(rows)
    return cell


def make_step(rules: Rules) -> GoldenFunction:
    """Return the golden step."""
    k = rules.robots
    rack_row, rack_column = rack_tables(rules)
    ties = make_ties(rules)
    goals = rules.goals
    state_words = k * words_of_a_robot(rules) + rules.requests
    numbers = (1 << rules.cell_bits) - 1
    shared = rules.reward == "global"

    def step(*words: Word) -> tuple[Word, ...]:
        robots, requests = parts(rules, words)
        actions, draws = words[state_words : state_words + k], words[state_words + k :]
        cells = [rules.cell(robot.x, robot.y) & numbers for robot in robots]
        origins = [robot.origin for robot in robots]

        def is_rack(x: Word, y: Word) -> Word:
            return (rack_column[x] & rack_row[y]) != 0

        # Where they want to be.
        wishes: list[tuple[Word, Word]] = []
        targets: list[Word] = []
        for robot, action, cell in zip(robots, actions, cells, strict=True):
            ahead = [(action == FORWARD) & (robot.direction == way) for way in range(4)]
            x = np.clip(robot.x + ahead[RIGHT] - ahead[LEFT], 0, rules.width - 1)
            y = np.clip(robot.y + ahead[DOWN] - ahead[UP], 0, rules.height - 1)
            target = rules.cell(x, y)
            # Who carries a shelf cannot pass under one that stands.
            stands = is_rack(x, y) & (any_of(target == origin for origin in origins) == 0)
            blocked = (robot.origin != NONE) & (target != cell) & stands
            wishes.append((np.where(blocked, robot.x, x), np.where(blocked, robot.y, y)))
            targets.append(np.where(blocked, cell, target))
        goes = movers(cells, targets, [robot.direction for robot in robots], ties)

        # What they do.
        brought = [robot.brought for robot in robots]
        paid: list[Word] = [0] * k
        for i, (robot, action, cell) in enumerate(zip(robots, actions, cells, strict=True)):
            toggles = (action == TOGGLE) & is_rack(robot.x, robot.y)
            free = origins[i] == NONE
            from_here = [origin == cell for origin in origins]
            # A shelf that stands here is taken up; or one is put down, and whose was from here has its origin then.
            taken = toggles & free & (any_of(from_here) == 0)
            put = toggles & (free == 0)
            origins = [np.where(put & here, origins[i], origin) for here, origin in zip(from_here, origins, strict=True)]
            origins[i] = np.where(put, NONE, np.where(taken, cell, origins[i]))
            paid[i] = put & brought[i]
            brought[i] = np.where(put, 0, brought[i])
        after = []
        for robot, action, (x, y), moves, origin in zip(robots, actions, wishes, goes, origins, strict=True):
            turned = np.where(
                action == TURN_LEFT,
                AFTER_LEFT[robot.direction],
                np.where(action == TURN_RIGHT, AFTER_RIGHT[robot.direction], robot.direction),
            )
            after.append(Robot(np.where(moves, x, robot.x), np.where(moves, y, robot.y), turned, origin))
        places = [np.where(moves, target, cell) for moves, target, cell in zip(goes, targets, cells, strict=True)]

        # Shelves that are carried move along. Each is known by its rack: where it stands or was taken from.
        racks = []
        for r, request in enumerate(requests):
            known = request
            for cell, place, origin in zip(cells, places, origins, strict=True):
                carried = (request == cell) & (origin != NONE)
                requests[r] = np.where(carried, place, requests[r])
                known = np.where(carried, origin, known)
            racks.append(known)
        asked: list[Word] = []
        for known in racks:
            asked = inserted(asked, known)

        # What has been brought; for it another shelf is asked for, that of the second goal maybe.
        rewards: list[Word] = list(paid)
        all_brought: Word = 0
        left: Word = NONE
        previous: Word = NONE
        for goal, draw in zip(goals, draws, strict=True):
            arrived = [request == goal for request in requests]
            delivered = any_of(arrived)
            new = unasked(rules, uniform_below(draw, rules.racks - rules.requests), asked)
            # The first goal's new shelf is not asked for any more, and the one that it took the place of may be.
            new = np.where(new == previous, left, new)
            place = new
            for origin, where in zip(origins, places, strict=True):
                place = np.where(origin == new, where, place)
            for r, here in enumerate(arrived):
                left = np.where(here, racks[r], left)
                requests[r] = np.where(here, place, requests[r])
            previous = np.where(delivered, new, previous)
            all_brought = all_brought + delivered
            for i in range(k):
                own = delivered & (places[i] == goal)
                rewards[i] = rewards[i] | own
                brought[i] = brought[i] | own
        if shared:
            rewards = [all_brought] * k
        after = [robot._replace(brought=flag) for robot, flag in zip(after, brought, strict=True)]
        return *whole(rules, after, requests), *rewards, *[0] * k

    return step


def unasked(rules: Rules, rank: Word, asked: Sequence[Word]) -> Word:
    """Return the rack of this rank among those whose shelves are not asked for; ``asked`` is in order."""
    for known in asked:
        rank = rank + (rack(rules, rank) >= known)
    return rack(rules, rank)


def rack_tables(rules: Rules, margin: int = 0) -> tuple[list[int], list[int]]:
    """Return tables by row and column: where they have a bit in common there is a rack.

    A table has an entry for each number that a field holds, and for so many neighbours to each side.
    """
    kinds = [kind for kind, rows in enumerate(rules.rack_rows) if rows]

    def table(size: int, where: Sequence[Sequence[int]]) -> list[int]:
        numbers = range(-margin, (1 << (size - 1).bit_length()) + margin)
        return [sum((n in where[kind]) << i for i, kind in enumerate(kinds)) for n in numbers]

    return table(rules.height, rules.rack_rows), table(rules.width, rules.rack_columns)


def make_observe(rules: Rules) -> GoldenFunction:
    """Return the golden function of what a robot observes: itself, and what is in the cells around it."""
    sight = rules.sight
    rack_row, rack_column = rack_tables(rules, margin=sight)
    beside = range(2 * sight + 1)
    numbers = (1 << rules.near_bits) - 1

    def observe(*words: Word) -> tuple[Word, ...]:
        robots, requests = parts(rules, words)
        agent: int = words[-1] if rules.robots > 1 else 0
        me = robots[agent]
        here = rules.cell(me.x, me.y)
        rows = [rack_row[me.y + down] for down in beside]
        columns = [rack_column[me.x + right] for right in beside]
        carries = [robot.origin != NONE for robot in robots]
        ways = [[robot.direction == way for way in range(4)] for robot in robots]
        cells = [rules.cell(robot.x, robot.y) for robot in robots]
        sensors: list[Word] = []
        for down in beside:
            for right in beside:
                near = (here + rules.cell(right - sight, down - sight)) & numbers
                mine = (down, right) == (sight, sight)
                there = [int(j == agent) if mine else cell == near for j, cell in enumerate(cells)]
                sides = [any_of(at & way[side] for at, way in zip(there, ways, strict=True)) for side in (DOWN, LEFT, RIGHT)]
                stands = ((rows[down] & columns[right]) != 0) & (any_of(near == r.origin for r in robots) == 0)
                shelf = stands | any_of(at & loaded for at, loaded in zip(there, carries, strict=True))
                asked = any_of(near == request for request in requests)
                # Where nobody is, the package shows the first direction.
                sensors += [any_of(there), any_of(sides) == 0, *sides, shelf, asked]
        highway = (rows[sight] & columns[sight]) == 0
        return me.x, me.y, carries[agent], *ways[agent], highway, *sensors

    return observe
