"""The golden step of RobotWarehouse: robots bring shelves that are asked for to a goal, and put them back.

No robot can tell shelves apart, so a state does not. It lists column, row and direction of each robot, and the rack
that the shelf it carries is from; then the cells of the shelves that are asked for, carried or not. In every other
rack a shelf stands. Who puts a shelf into a rack that another robot's is from leaves it the rack of its own.

What looks arbitrary is the package's: who moves is in :mod:`~pearl_marl.envs.robot_warehouse.moves`. For a shelf that
has been brought another one is asked for at once, which may stand at the second goal, and is brought by that.

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
    """Whether it has brought a shelf that was asked for, and put none down since; only where that pays."""


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
    return 5 if rules.two_stage else 4


def decisions(rules: Rules) -> list[int]:
    """Return how many outcomes each decision of a start has."""
    places, racks = rules.width * rules.height, len(rules.racks)
    return [
        *(places - k for k in range(rules.robots)),
        *[len(AFTER_LEFT)] * rules.robots,
        *(racks - k for k in range(rules.requests)),
    ]


def make_initial(rules: Rules) -> GoldenFunction:
    """Return the golden function that puts robots into different cells, and asks for some of the shelves."""
    k, outcomes = rules.robots, decisions(rules)

    def initial(*draws: Word) -> tuple[Word, ...]:
        decided = digits(draws, outcomes)
        taken: list[Word] = []
        robots = []
        for rank, direction in zip(decided[:k], decided[k : 2 * k], strict=True):
            place = another(rank, taken)
            taken = inserted(taken, place)
            robots.append(Robot(place % rules.width, place // rules.width, direction, NONE))
        asked: list[Word] = []
        for rank in decided[2 * k :]:
            asked = inserted(asked, another(rank, asked))
        return whole(rules, robots, [rack(rules, number) for number in asked])

    return initial


def rack(rules: Rules, number: Word) -> Word:
    """Return the cell of a rack by its number, from the top left to the bottom right."""
    cell, before = 0, 0
    for columns, rows in zip(rules.rack_columns, rules.rack_rows, strict=True):
        if rows:
            within = np.clip(number - before, 0, len(columns) * len(rows) - 1)
            row, column = within // len(columns), within % len(columns)
            # A highway is after every two columns, and in the middle of the lowest racks one more of three;
            # and after every block of rows.
            aside = column // 2 + (len(columns) < len(rules.rack_columns[0])) * 3 * (
                column >= len(columns) // 2
            )
            here = rules.cell(columns[0] + column + aside, rows[0] + row + row // rules.column_height)
            cell = np.where(number >= before, here, cell) if before else here
            before += len(columns) * len(rows)
    return cell


def rack_tables(rules: Rules, margin: int = 0) -> tuple[list[int], list[int]]:
    """Return tables by row and column: where they have a bit in common there is a rack.

    A table has an entry for each number that a field holds, and for so many neighbours to each side.
    """
    kinds = [kind for kind, rows in enumerate(rules.rack_rows) if rows]

    def table(size: int, where: Sequence[Sequence[int]]) -> list[int]:
        numbers = range(-margin, (1 << (size - 1).bit_length()) + margin)
        return [sum((n in where[kind]) << i for i, kind in enumerate(kinds)) for n in numbers]

    return table(rules.height, rules.rack_rows), table(rules.width, rules.rack_columns)


def make_step(rules: Rules) -> GoldenFunction:
    """Return the golden step."""
    k = rules.robots
    rack_row, rack_column = rack_tables(rules)
    ties = make_ties(rules)
    state_words = k * words_of_a_robot(rules) + rules.requests
    numbers = (1 << rules.cell_bits) - 1

    def step(*words: Word) -> tuple[Word, ...]:
        robots, requests = parts(rules, words)
        actions, draws = words[state_words : state_words + k], words[state_words + k :]
        cells = [rules.cell(robot.x, robot.y) & numbers for robot in robots]

        def is_rack(x: Word, y: Word) -> Word:
            return (rack_row[y] & rack_column[x]) != 0

        wishes: list[tuple[Word, Word]] = []
        targets: list[Word] = []
        for robot, action, cell in zip(robots, actions, cells, strict=True):
            x, y = ahead(rules, robot, action == FORWARD)
            # Who carries a shelf cannot pass under one that stands.
            stands = is_rack(x, y) & (any_of(rules.cell(x, y) == other.origin for other in robots) == 0)
            blocked = (robot.origin != NONE) & stands
            wishes.append((np.where(blocked, robot.x, x), np.where(blocked, robot.y, y)))
            targets.append(np.where(blocked, cell, rules.cell(x, y)))
        goes = movers(cells, targets, [robot.direction for robot in robots], ties)
        places = [np.where(go, target, cell) for go, target, cell in zip(goes, targets, cells, strict=True)]

        toggles = [
            (action == TOGGLE) & is_rack(robot.x, robot.y)
            for robot, action in zip(robots, actions, strict=True)
        ]
        robots, returned = toggled(robots, cells, toggles)
        robots = [
            robot._replace(
                x=np.where(go, x, robot.x), y=np.where(go, y, robot.y), direction=turned(robot, action)
            )
            for robot, go, (x, y), action in zip(robots, goes, wishes, actions, strict=True)
        ]
        requests, racks = carried(requests, robots, cells, places)
        requests, rewards, brought = delivered(rules, requests, racks, robots, places, draws)
        robots = [
            robot._replace(brought=robot.brought | own) for robot, own in zip(robots, brought, strict=True)
        ]
        rewards = [reward | half for reward, half in zip(rewards, returned, strict=True)]
        return *whole(rules, robots, requests), *rewards, *[0] * k

    return step


def ahead(rules: Rules, robot: Robot, forward: Word) -> tuple[Word, Word]:
    """Return column and row of where a robot wants to be: an edge is in its way."""
    up, down, left, right = (forward & (robot.direction == way) for way in (UP, DOWN, LEFT, RIGHT))
    x = np.clip(robot.x + right - left, 0, rules.width - 1)
    y = np.clip(robot.y + down - up, 0, rules.height - 1)
    return x, y


def turned(robot: Robot, action: Word) -> Word:
    """Return a robot's direction after its action."""
    right = np.where(action == TURN_RIGHT, AFTER_RIGHT[robot.direction], robot.direction)
    return np.where(action == TURN_LEFT, AFTER_LEFT[robot.direction], right)


def toggled(
    robots: Sequence[Robot], cells: Sequence[Word], toggles: Sequence[Word]
) -> tuple[list[Robot], list[Word]]:
    """Let robots take up the shelf that stands in their rack, or put theirs down; return who put one that was brought."""
    origins, brought, returned = [robot.origin for robot in robots], [], []
    for k, (robot, cell, toggle) in enumerate(zip(robots, cells, toggles, strict=True)):
        own = origins[k]
        from_here = [origin == cell for origin in origins]
        takes = toggle & (own == NONE) & (any_of(from_here) == 0)
        puts = toggle & (own != NONE)
        origins = [np.where(puts & here, own, old) for here, old in zip(from_here, origins, strict=True)]
        origins[k] = np.where(puts, NONE, np.where(takes, cell, own))
        returned.append(puts & robot.brought)
        brought.append(np.where(puts, 0, robot.brought))
    changed = zip(robots, origins, brought, strict=True)
    return [robot._replace(origin=origin, brought=flag) for robot, origin, flag in changed], returned


def carried(
    requests: Sequence[Word], robots: Sequence[Robot], cells: Sequence[Word], places: Sequence[Word]
) -> tuple[list[Word], list[Word]]:
    """Move the shelves that are asked for with who carries them; return their cells, and the racks they are from."""
    now, racks = list(requests), list(requests)
    for robot, cell, place in zip(robots, cells, places, strict=True):
        for r, request in enumerate(requests):
            on_it = (request == cell) & (robot.origin != NONE)
            now[r] = np.where(on_it, place, now[r])
            racks[r] = np.where(on_it, robot.origin, racks[r])
    return now, racks


def delivered(
    rules: Rules,
    requests: Sequence[Word],
    racks: Sequence[Word],
    robots: Sequence[Robot],
    places: Sequence[Word],
    draws: Sequence[Word],
) -> tuple[list[Word], list[Word], list[Word]]:
    """Ask for other shelves than those at the goals; return the cells of all, the rewards, and who brought one."""
    now = list(requests)
    brought: list[Word] = [0] * len(robots)
    total: Word = 0
    # The racks of the shelf that the first goal had, and of the one that is asked for instead.
    old: Word = NONE
    new: Word = NONE
    asked: list[Word] = []
    for number in racks:
        asked = inserted(asked, number)
    for goal, draw in zip(rules.goals, draws, strict=True):
        arrived = [request == goal for request in now]
        delivery = any_of(arrived)
        found = unasked(rules, uniform_below(draw, len(rules.racks) - len(racks)), asked)
        # The second goal has its choice among as many: what the first goal had, and not what was chosen for that.
        found = np.where(found == new, old, found)
        cell = found
        for robot, place in zip(robots, places, strict=True):
            cell = np.where(robot.origin == found, place, cell)
        now = [np.where(here, cell, request) for here, request in zip(arrived, now, strict=True)]
        for here, number in zip(arrived, racks, strict=True):
            old = np.where(here, number, old)
        new = np.where(delivery, found, new)
        brought = [flag | (delivery & (place == goal)) for flag, place in zip(brought, places, strict=True)]
        total = total + delivery
    return now, [total] * len(robots) if rules.reward == "global" else brought, brought


def unasked(rules: Rules, rank: Word, asked: Sequence[Word]) -> Word:
    """Return the rack of this rank among those whose shelves are not asked for; ``asked`` is in order."""
    for number in asked:
        rank = rank + (rack(rules, rank) >= number)
    return rack(rules, rank)


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
        cells = [rules.cell(robot.x, robot.y) for robot in robots]
        loaded = [robot.origin != NONE for robot in robots]
        ways = [[robot.direction == way for robot in robots] for way in (UP, DOWN, LEFT, RIGHT)]
        seen: list[Word] = []
        for down in beside:
            for right in beside:
                near = (here + rules.cell(right - sight, down - sight)) & numbers
                own = (down, right) == (sight, sight)
                there = [int(k == agent) if own else cell == near for k, cell in enumerate(cells)]
                _, *sides = (both(there, way) for way in ways)
                stands = ((rows[down] & columns[right]) != 0) & (
                    any_of(near == r.origin for r in robots) == 0
                )
                # Where no robot is, the package says that it faces up.
                seen += [any_of(there), any_of(sides) == 0, *sides]
                seen += [stands | both(there, loaded), any_of(near == request for request in requests)]
        highway = (rows[sight] & columns[sight]) == 0
        return me.x, me.y, loaded[agent], *(way[agent] for way in ways), highway, *seen

    return observe


def both(some: Sequence[Word], others: Sequence[Word]) -> Word:
    """Return whether any of some flags is set together with the other one in its place."""
    return any_of(a & b for a, b in zip(some, others, strict=True))
