"""The golden step of RobotWarehouse: robots bring shelves that are asked for to a goal, and put them back.

No robot can tell shelves apart, so a state does not. It lists column, row and direction of each robot and the
rack that the shelf it carries is from; then the cells of the shelves that are asked for, carried or not. In
every other rack a shelf stands. A robot may put its shelf into a rack that another one's is from; that one is
from the rack of the first from then on.

What looks arbitrary is the package's. Who moves is in :mod:`.moves`. As soon as a shelf has been brought,
another one is asked for. That may be the one at the second goal, and then it has been brought too.

Follows https://github.com/semitable/robotic-warehouse (2.0.0): G. Papoudakis, F. Christianos, L. Schäfer and
S. V. Albrecht, *Benchmarking Multi-Agent Deep Reinforcement Learning Algorithms in Cooperative Tasks*, 2021.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

from pearl_marl.golden import Draws, Word, another, inserted
from pearl_marl.layout import Array, Bits, Flag, Range
from pearl_marl.spec import Golden

from .moves import make_ties, movers
from .rules import WarehouseRules

FORWARD, TURN_LEFT, TURN_RIGHT, TOGGLE = range(1, 5)
UP, DOWN, LEFT, RIGHT = range(4)
AFTER_LEFT, AFTER_RIGHT = (LEFT, RIGHT, DOWN, UP), (RIGHT, LEFT, UP, DOWN)
"""A robot's direction after a turn, by the one before."""
NONE = 0
"""The rack that no shelf is from: the cell of that number is on a highway."""


Robot: TypeAlias = Any
"""A robot of a state."""


def make_golden(rules: WarehouseRules) -> Golden:
    """Return the state of a warehouse and its golden functions."""
    sight, beside = rules.sight, range(2 * rules.sight + 1)
    rack_row, rack_column = rack_tables(rules)
    seen_row, seen_column = rack_tables(rules, margin=sight)
    ties = make_ties(rules)
    column, row = Range[0, rules.width - 1], Range[0, rules.height - 1]

    class Robot(NamedTuple):
        x: column
        y: row
        direction: Bits[2]
        origin: Bits[rules.cell_bits]
        """The rack that the shelf it carries is from."""
        brought: Bits[rules.two_stage]
        """Whether it has brought what was asked for, and put nothing down since; only where that pays."""

    class State(NamedTuple):
        robots: Array[Robot, rules.robots]
        requests: Array[Bits[rules.cell_bits], rules.requests]

    class Cell(NamedTuple):
        robot: Flag
        up: Flag
        down: Flag
        left: Flag
        right: Flag
        shelf: Flag
        asked: Flag

    class View(NamedTuple):
        x: column
        y: row
        carries: Flag
        up: Flag
        down: Flag
        left: Flag
        right: Flag
        highway: Flag
        cells: Array[Cell, len(beside) ** 2]

    def initial(draws: Draws) -> State:
        """Put robots into different cells, and ask for some of the shelves."""
        taken: list[Word] = []
        asked: list[Word] = []
        places = []
        for _ in range(rules.robots):
            place, taken = another(draws, rules.width * rules.height, taken)
            places.append(place)
        robots = [Robot(p % rules.width, p // rules.width, draws.digit(4), NONE, 0) for p in places]
        for _ in range(rules.requests):
            _, asked = another(draws, len(rules.racks), asked)
        return State(robots, [rack(rules, number) for number in asked])

    def step(state: State, actions: Sequence[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
        """Let robots move, then take up shelves and put them down; pay for what is brought."""
        robots = state.robots
        cells = [rules.cell(robot.x, robot.y) for robot in robots]
        wishes = [wish(robots, k, action == FORWARD) for k, action in enumerate(actions)]
        targets = [target for _, _, target in wishes]
        goes = movers(cells, targets, [robot.direction for robot in robots], ties)
        places = [target if go else cell for go, target, cell in zip(goes, targets, cells, strict=True)]

        toggles = [
            action == TOGGLE and is_rack(robot.x, robot.y)
            for robot, action in zip(robots, actions, strict=True)
        ]
        robots, returned = toggled(robots, cells, toggles)
        for k, (x, y, _) in enumerate(wishes):
            robots[k] = robots[k]._replace(direction=turned(robots[k].direction, actions[k]))
            if goes[k]:
                robots[k] = robots[k]._replace(x=x, y=y)
        requests, racks = carried(state.requests, robots, cells, places)
        requests, rewards, brought = delivered(rules, requests, racks, robots, places, draws)
        robots = [
            robot._replace(brought=robot.brought | own) for robot, own in zip(robots, brought, strict=True)
        ]
        rewards = [reward | half for reward, half in zip(rewards, returned, strict=True)]
        return State(robots, requests), rewards, [0] * rules.robots

    def is_rack(x: Word, y: Word) -> Word:
        """Return whether there is a rack in a cell."""
        return (rack_row[y] & rack_column[x]) != 0

    def wish(robots: Sequence[Robot], k: int, forward: Word) -> tuple[Word, Word, Word]:
        """Return column, row and number of the cell that a robot wants to be in.

        An edge is in its way; and a standing shelf, if it carries one.
        """
        me = robots[k]
        up, down, left, right = (forward & (me.direction == way) for way in (UP, DOWN, LEFT, RIGHT))
        x = min(max(me.x + right - left, 0), rules.width - 1)
        y = min(max(me.y + down - up, 0), rules.height - 1)
        target = rules.cell(x, y)
        stands = is_rack(x, y) and not any(target == robot.origin for robot in robots)
        if me.origin != NONE and stands:
            return me.x, me.y, rules.cell(me.x, me.y)
        return x, y, target

    def observe(state: State, agent: int) -> tuple[Any, ...]:
        """Return what a robot sees: itself, and what is in the cells around it."""
        robots, me = state.robots, state.robots[agent]
        here = rules.cell(me.x, me.y)
        rows = [seen_row[me.y + down] for down in beside]
        columns = [seen_column[me.x + right] for right in beside]
        cells = [rules.cell(robot.x, robot.y) for robot in robots]
        loaded = [robot.origin != NONE for robot in robots]
        ways = [[robot.direction == way for robot in robots] for way in (UP, DOWN, LEFT, RIGHT)]
        seen = []
        for down in beside:
            for right in beside:
                near = here + rules.cell(right - sight, down - sight)
                own = (down, right) == (sight, sight)
                there = [int(k == agent) if own else cell == near for k, cell in enumerate(cells)]
                _, *sides = (both(there, way) for way in ways)
                empty = any(near == robot.origin for robot in robots)
                stands = (rows[down] & columns[right]) != 0 and not empty
                # Where no robot is, the package says that it faces up.
                seen += [any(there), not any(sides), *sides]
                seen += [stands | both(there, loaded), near in state.requests]
        highway = (rows[sight] & columns[sight]) == 0
        return me.x, me.y, loaded[agent], *(way[agent] for way in ways), highway, *seen

    return Golden(State, initial, step, observe, view=View)


def rack(rules: WarehouseRules, number: Word) -> Word:
    """Return the cell of a rack by its number, from the top left to the bottom right."""
    cell, before, widest = 0, 0, len(rules.rack_columns[0])
    for columns, rows in zip(rules.rack_columns, rules.rack_rows, strict=True):
        count = len(columns)
        if rows:
            within = min(max(number - before, 0), count * len(rows) - 1)
            row, column = within // count, within % count
            # A highway is behind every two columns, and three more in the middle of the lowest racks.
            queue = 3 * (column >= count // 2) if count < widest else 0
            x, y = columns[0] + column + column // 2 + queue, rows[0] + row + row // rules.column_height
            if number >= before:
                cell = rules.cell(x, y)
            before += count * len(rows)
    return cell


def rack_tables(rules: WarehouseRules, margin: int = 0) -> tuple[list[int], list[int]]:
    """Return tables by row and column: where they have a bit in common there is a rack.

    A table has an entry for each number, and for so many neighbours to each side.
    """
    kinds = [kind for kind, rows in enumerate(rules.rack_rows) if rows]

    def table(size: int, where: Sequence[Sequence[int]]) -> list[int]:
        numbers = range(-margin, size + margin)
        return [sum((n in where[kind]) << i for i, kind in enumerate(kinds)) for n in numbers]

    return table(rules.height, rules.rack_rows), table(rules.width, rules.rack_columns)


def turned(direction: Word, action: Word) -> Word:
    """Return a direction after an action."""
    if action == TURN_LEFT:
        return AFTER_LEFT[direction]
    return AFTER_RIGHT[direction] if action == TURN_RIGHT else direction


def toggled(
    robots: Sequence[Robot], cells: Sequence[Word], toggles: Sequence[Word]
) -> tuple[list[Robot], list[Word]]:
    """Let robots take up shelves and put them down; return also who has put one down that it had brought."""
    origins, brought, returned = [robot.origin for robot in robots], [], []
    for k, (robot, cell, toggle) in enumerate(zip(robots, cells, toggles, strict=True)):
        own = origins[k]
        puts = toggle and own != NONE
        if toggle and own == NONE and cell not in origins:
            origins[k] = cell
        if puts:
            origins = [own if origin == cell else origin for origin in origins]
            origins[k] = NONE
        returned.append(puts and robot.brought)
        brought.append(0 if puts else robot.brought)
    changed = zip(robots, origins, brought, strict=True)
    return [robot._replace(origin=origin, brought=flag) for robot, origin, flag in changed], returned


def carried(
    requests: Sequence[Word], robots: Sequence[Robot], cells: Sequence[Word], places: Sequence[Word]
) -> tuple[list[Word], list[Word]]:
    """Move shelves that are asked for with their robots; return their cells, and the racks they are from."""
    now, racks = list(requests), list(requests)
    for robot, cell, place in zip(robots, cells, places, strict=True):
        for r, request in enumerate(requests):
            if request == cell and robot.origin != NONE:
                now[r], racks[r] = place, robot.origin
    return now, racks


def delivered(
    rules: WarehouseRules,
    requests: Sequence[Word],
    racks: Sequence[Word],
    robots: Sequence[Robot],
    places: Sequence[Word],
    draws: Draws,
) -> tuple[list[Word], list[Word], list[Word]]:
    """Ask for others than the shelves at the goals; return their cells, the rewards, and who brought one."""
    now, brought, total = list(requests), [0] * len(robots), 0
    # The racks of the shelf that the first goal had, and of the one that is asked for instead.
    old, new = NONE, NONE
    asked: list[Word] = []
    for number in racks:
        asked = inserted(asked, number)
    for goal in rules.goals:
        arrived = [request == goal for request in now]
        delivery = any(arrived)
        found = unasked(rules, draws.below(len(rules.racks) - len(racks)), asked)
        # The second goal chooses among as many: the first goal's shelf is in place of the one chosen there.
        found = old if found == new else found
        cell = found
        for robot, place in zip(robots, places, strict=True):
            if robot.origin == found:
                cell = place
        for r, here in enumerate(arrived):
            if here:
                now[r], old = cell, racks[r]
        new = found if delivery else new
        brought = [flag | (delivery & (place == goal)) for flag, place in zip(brought, places, strict=True)]
        total += delivery
    return now, [total] * len(robots) if rules.reward == "global" else brought, brought


def unasked(rules: WarehouseRules, rank: Word, asked: Sequence[Word]) -> Word:
    """Return the rack of this rank among those whose shelves are not asked for; ``asked`` is in order."""
    for number in asked:
        rank += rack(rules, rank) >= number
    return rack(rules, rank)


def both(some: Sequence[Word], others: Sequence[Word]) -> Word:
    """Return whether any of some flags is set together with the other one in its place."""
    return any(a & b for a, b in zip(some, others, strict=True))
