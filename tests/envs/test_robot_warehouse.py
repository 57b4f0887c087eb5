"""RobotWarehouse against the package ``rware``: its starts, and what comes of the same actions and draws."""

from __future__ import annotations

import functools
import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import gymnasium
import networkx
import numpy as np
import pytest
from rware.warehouse import Direction, RewardType, Shelf, Warehouse
from scipy import stats

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.envs.robot_warehouse import picture
from pearl_marl.envs.robot_warehouse.moves import AHEAD, make_ties
from pearl_marl.envs.robot_warehouse.rules import WarehouseRules
from pearl_marl.envs.robot_warehouse.spec import rules_of
from pearl_marl.envs.robot_warehouse.step import make_golden
from pearl_marl.envs.robot_warehouse.ties import in_a_set
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import reference
from pearl_marl.layout import Layout
from pearl_marl.porting.oracle import Games, Ours, Outcome, compare

from ..sampling import sampled
from .starts import started

Array = np.ndarray[Any, Any]
NOOP, FORWARD, TURN_LEFT, TURN_RIGHT, TOGGLE = range(5)
LIMIT = 500

CASES: dict[str, dict[str, Any]] = {
    "tiny-2ag": {},
    "tiny-4ag": {"robots": 4},
    "small-4ag": {"size": "small", "robots": 4},
    "tiny-3ag-hard": {"robots": 3, "request_queue_size": 1},
    "medium-4ag-easy": {"size": "medium", "robots": 4, "request_queue_size": 8},
}
"""Warehouses that the package registers, by its names."""

OTHERS: dict[str, dict[str, Any]] = {
    "global": {"size": "small", "robots": 2, "reward_type": "global"},
    "two-stage": {"robots": 2, "reward_type": "two_stage", "request_queue_size": 3},
    "large, far": {"size": "large", "sensor_range": 2, "robots": 1, "request_queue_size": 5},
    "low": {"size": "small", "column_height": 2, "robots": 4, "request_queue_size": 11},
}


def spec_of(given: dict[str, Any]) -> EnvSpec:
    return pearl_marl.get_spec("RobotWarehouse").with_options(**given)


def rules_for(spec: EnvSpec) -> WarehouseRules:
    return rules_of(**{name: value for name, value in spec.options.items() if name != "max_steps"})


class Robot(NamedTuple):
    """What a state holds of a robot."""

    x: Any
    y: Any
    direction: Any
    origin: Any
    brought: Any = 0


@functools.cache
def layout_of(rules: WarehouseRules) -> Layout:
    return Layout(make_golden(rules).state)


def parts(rules: WarehouseRules, state: Iterable[Any]) -> tuple[list[Robot], list[Any]]:
    """Return the robots of a state, and the cells of the shelves that are asked for."""
    robots, requests = layout_of(rules).built(state)
    return [Robot(*robot) for robot in robots], requests


def whole(rules: WarehouseRules, robots: Sequence[Robot], requests: Sequence[Any]) -> tuple[Any, ...]:
    """Return the words of the state that has these parts."""
    words = 5 if rules.two_stage else 4
    return *(word for robot in robots for word in robot[:words]), *requests


class Package:
    """The package's warehouse, put where ours is, with draws of ours.

    Its shelves have names and ours have not: here a shelf is known by the rack that it stands in or is from.
    """

    def __init__(self, rules: WarehouseRules) -> None:
        self.rules = rules
        self.env = Warehouse(
            shelf_columns=rules.shelf_columns,
            column_height=rules.column_height,
            shelf_rows=rules.shelf_rows,
            n_agents=rules.robots,
            msg_bits=0,
            sensor_range=rules.sight,
            request_queue_size=rules.requests,
            max_inactivity_steps=None,
            max_steps=LIMIT,
            reward_type=RewardType[rules.reward.upper()],
        )
        self.env.reset(seed=0)
        self.env._np_random = self
        self.racks = [self.cell(shelf) for shelf in self.env.shelfs]
        self.homes: dict[Shelf, int] = {}

    def cell(self, thing: Any) -> int:
        return int(self.rules.cell(thing.x, thing.y))

    def put(self, state: Any) -> None:
        """Start where ours does."""
        env, (robots, requests) = self.env, state
        env._cur_steps = 0
        shelves = dict(zip(self.racks, env.shelfs, strict=True))
        for rack, shelf in shelves.items():
            shelf.y, shelf.x = divmod(rack, self.rules.stride)
        for agent, robot in zip(env.agents, robots, strict=True):
            agent.x, agent.y, agent.dir = robot.x, robot.y, Direction(robot.direction)
            agent.carrying_shelf = shelves.get(robot.origin)
            agent.has_delivered = bool(getattr(robot, "brought", 0))
            if agent.carrying_shelf:
                agent.carrying_shelf.x, agent.carrying_shelf.y = robot.x, robot.y
        where = {self.cell(shelf): shelf for shelf in env.shelfs}
        env.request_queue = [where[cell] for cell in requests]
        assert (len(where), len(set(env.request_queue))) == (len(self.racks), self.rules.requests)
        env._recalc_grid()
        self.homes = {shelf: rack for rack, shelf in shelves.items()}

    def step(self, actions: list[int], draws: list[int]) -> Outcome:
        """Step the package."""
        self.homes = {shelf: self.rack(shelf) for shelf in self.env.shelfs}
        self.draws, self.chosen = draws, None
        observations, rewards, done, _, _ = self.env.step(actions)
        ends = [False] * len(rewards)
        return Outcome(np.stack(observations), rewards, ends, truncated=done)

    def look(self) -> Outcome:
        return Outcome(np.stack([self.env._make_obs(agent) for agent in self.env.agents]))

    def rack(self, shelf: Shelf) -> int:
        """Return the rack that a shelf stands in or was taken from."""
        carried = any(agent.carrying_shelf is shelf for agent in self.env.agents)
        return self.homes[shelf] if carried else self.cell(shelf)

    def choice(self, candidates: list[Shelf]) -> Shelf:
        """Be the package's generator: choose the shelf that is asked for next, by our draw."""
        env = self.env
        (x, y), _ = env.goals
        at_first = env.grid[1, y, x]
        if self.chosen is None:
            order = sorted(candidates, key=self.rack)
            draw = self.draws[0 if at_first and env.shelfs[at_first - 1] in env.request_queue else 1]
        else:
            # The shelf at the first goal has taken the place of the one that was chosen for it.
            order, index = self.chosen
            order[index] = env.shelfs[at_first - 1]
            draw = self.draws[1]
        assert len(order) == len(candidates)
        assert set(order) == set(candidates)
        self.chosen = order, draw * len(order) >> 32
        return order[self.chosen[1]]

    def state(self) -> tuple[Any, ...]:
        """Return all that a state tells: the robots, racks without a shelf, cells of shelves asked for."""
        env = self.env
        robots = [(a.x, a.y, a.dir.value, a.carrying_shelf is not None, a.has_delivered) for a in env.agents]
        carried = {agent.carrying_shelf for agent in env.agents}
        standing = {self.cell(shelf) for shelf in env.shelfs if shelf not in carried}
        return robots, set(self.racks) - standing, {self.cell(shelf) for shelf in env.request_queue}


def told(rules: WarehouseRules, state: list[int]) -> tuple[Any, ...]:
    """Return what :meth:`Package.state` does, of ours."""
    robots, requests = parts(rules, state)
    return (
        [(r.x, r.y, r.direction, r.origin != 0, bool(r.brought)) for r in robots],
        {r.origin for r in robots} - {0},
        set(requests),
    )


def places(rules: WarehouseRules, state: list[Array]) -> Array:
    """Return columns and rows of the robots, of shape ``(n, robots, 2)``."""
    return np.stack([np.stack([robot.x, robot.y], 1) for robot in parts(rules, state)[0]], 1)


# ---- Robots in each other's way


def crowded(rules: WarehouseRules, generator: np.random.Generator) -> list[int]:
    """Return a state in which robots are close together."""
    if generator.random() < 0.6:
        return loaded(rules, generator, queued(rules, generator))
    wide, high = [(2, 2), (3, 2), (2, 3), (3, 3)][generator.integers(4)]
    left, top = generator.integers(rules.width - wide + 1), generator.integers(rules.height - high + 1)
    if generator.random() < 0.5:  # at the goals
        left, top = rules.width // 2 - 1 - generator.integers(wide - 1), rules.height - high
    cells = generator.permutation(wide * high)[: rules.robots]
    directions = generator.integers(4, size=rules.robots).tolist()
    if (wide, high) == (2, 2) and generator.random() < 0.7:
        # In a ring, this way or that.
        ring = [(3, 1, 0, 2), (1, 2, 3, 0)][generator.integers(2)]
        directions = [ring[cell] for cell in cells]
    robots = [(int(left + c % wide), int(top + c // wide), d) for c, d in zip(cells, directions, strict=True)]
    return loaded(rules, generator, robots)


def queued(rules: WarehouseRules, generator: np.random.Generator) -> list[tuple[int, int, int]]:
    """Return robots of which two or more want the same cell, and others want theirs or are anywhere."""
    robots: dict[tuple[int, int], int] = {}

    def anywhere() -> tuple[int, int]:
        return int(generator.integers(rules.width)), int(generator.integers(rules.height))

    wanted, another, plan = anywhere(), anywhere(), generator.integers(4)
    while len(robots) < rules.robots:
        chance, way, count = generator.random(), int(generator.integers(4)), len(robots)
        if chance < 0.1 or (count < 2 and chance < 0.9):
            x, y = wanted
        elif chance < 0.9 and plan == 0:  # a queue behind each of the two
            x, y = list(robots)[count - 2]
        elif chance < 0.9 and plan == 1:
            x, y = list(robots)[generator.integers(count)]
        elif chance < 0.9 and plan == 2:
            x, y = another
        else:
            x, y = anywhere()
        place = x - AHEAD[way][0], y - AHEAD[way][1]
        inside = 0 <= place[0] < rules.width and 0 <= place[1] < rules.height
        if inside and place not in robots and place not in (wanted, another):
            robots[place] = way
    order = generator.permutation(rules.robots)
    return [(*place, way) for place, way in (list(robots.items())[k] for k in order)]


def loaded(
    rules: WarehouseRules, generator: np.random.Generator, robots: list[tuple[int, int, int]]
) -> list[int]:
    """Give shelves to some of the robots, and ask for some of them; return the state."""
    cells = [rules.cell(x, y) for x, y, _ in robots]
    carriers = [k for k in range(len(robots)) if generator.random() < 0.4]
    # Who carries a shelf where a rack is stands in an empty one.
    empty = [cells[k] for k in carriers if cells[k] in rules.racks]
    free = [rack for rack in rules.racks if rack not in empty]
    empty += generator.choice(free, size=len(carriers) - len(empty), replace=False).tolist()
    origins = dict(zip(carriers, generator.permutation(empty).tolist(), strict=True))
    asked = [cells[k] for k in carriers if generator.random() < 0.7][: rules.requests]
    standing = [rack for rack in rules.racks if rack not in empty]
    asked += generator.choice(standing, size=rules.requests - len(asked), replace=False).tolist()
    brought = generator.integers(2, size=len(robots)).tolist() if rules.two_stage else [0] * len(robots)
    words = enumerate(zip(robots, brought, strict=True))
    made = [Robot(*robot, int(origins.get(k, 0)), flag) for k, (robot, flag) in words]
    return list(whole(rules, made, asked))


def worked(rules: WarehouseRules, state: list[Array], generator: np.random.Generator) -> Array:
    """Return actions that bring shelves to the goals and back, most of them."""
    robots, requests = parts(rules, state)
    actions = generator.choice(5, p=[0.1, 0.5, 0.15, 0.15, 0.1], size=(len(state[0]), len(robots)))
    for k, robot in enumerate(robots):
        for i in np.flatnonzero(generator.random(len(actions)) < 0.85):
            x, y, way, origin = (int(word[i]) for word in robot[:4])
            actions[i, k] = errand(rules, x, y, way, origin, [int(cell[i]) for cell in requests], k)
    return actions


def errand(rules: WarehouseRules, x: int, y: int, way: int, origin: int, requests: list[int], k: int) -> int:
    """Return the action of a robot that fetches, brings, or returns a shelf, if nobody is in its way."""
    last, cell = rules.height - 1, rules.cell(x, y)
    home_y, home_x = divmod(origin or requests[k % len(requests)], rules.stride)
    if not origin:
        step = (home_x - x, 0) if y == home_y else (0, home_y - y)
    elif cell in requests:
        aside = (0, -1, 1)[x % 3]
        goal = rules.goals[k % 2] % rules.stride
        step = (goal - x, 0) if y == last else (aside, 0) if aside else (0, 1)
    else:
        # By the highway beside the rack that it is from.
        beside = home_x + (0, -1, 1)[home_x % 3]
        on_row = y == last or y % (rules.column_height + 1) == 0
        step = (beside - x, 0) if on_row and x != beside else (0, home_y - y)
        step = (home_x - x, 0) if y == home_y else step
    if step == (0, 0):
        return TOGGLE
    wanted = AHEAD.index((int(np.sign(step[0])), 0) if step[0] else (0, int(np.sign(step[1]))))
    return FORWARD if way == wanted else TURN_RIGHT


def packages(spec: EnvSpec, n: int) -> Games:
    """Return games of the package."""
    games = [Package(rules_for(spec)) for _ in range(n)]
    return Games(spec, games, Package.put, Package.step, Package.look)


def compare_all(spec: EnvSpec, games: Games, **arguments: Any) -> Counter[str]:
    """Step both, compare all that either has, and count in how many steps there is what."""
    rules, count = rules_for(spec), Counter[str]()
    for move in compare(spec, games, len(games.games), **arguments):
        before, after = ([word.astype(np.int64) for word in words] for words in (move.before, move.after))
        for package, row in zip(games.games, np.stack(after, 1).tolist(), strict=True):
            assert package.state() == told(rules, row)
        count += counted(rules, before, after, move.actions, move.outcome.rewards > 0)
    return count


def counted(
    rules: WarehouseRules, before: list[Array], after: list[Array], actions: Array, codes: Array
) -> Counter[str]:
    """Count in how many steps there is what."""
    was, now = places(rules, before), places(rules, after)
    ways = np.stack([robot.direction for robot in parts(rules, before)[0]], 1)
    wish = was + np.where((actions == FORWARD)[..., None], np.array(AHEAD)[ways], 0)
    wish = np.clip(wish, 0, [rules.width - 1, rules.height - 1])
    cell, target, place = (rules.cell(each[..., 0], each[..., 1]) for each in (was, wish, now))
    moving, moved = target != cell, place != cell
    lifted = [np.stack([robot.origin != 0 for robot in parts(rules, s)[0]], 1) for s in (before, after)]

    def pairs(flags: Callable[[int, int], Array]) -> Array:
        every = [flags(a, b) for a, b in itertools.permutations(range(rules.robots), 2)]
        return np.any(every, 0) if every else np.zeros(len(cell), bool)

    def same(a: int, b: int) -> Array:
        return moving[:, a] & moving[:, b] & (target[:, a] == target[:, b])

    def onto(a: int, b: int) -> Array:
        return moving[:, a] & (target[:, a] == cell[:, b])

    contested, stepped_on = pairs(same), pairs(onto)
    return Counter(
        {
            "steps": len(cell),
            "collisions": int(((moving & ~moved).any(1) & (contested | stepped_on)).sum()),
            "contested": int(contested.sum()),
            "later first": int(pairs(lambda a, b: same(a, b) & moved[:, b] & (a < b)).sum()),
            "swaps": int(pairs(lambda a, b: onto(a, b) & onto(b, a)).sum()),
            "queues": int(pairs(lambda a, b: onto(a, b) & moved[:, a]).sum()),
            "rings": int((moved.all(1) & (np.sort(cell) == np.sort(place)).all(1)).sum()),
            "taken": int((~lifted[0] & lifted[1]).any(1).sum()),
            "put": int((lifted[0] & ~lifted[1]).any(1).sum()),
            "paid": int((codes > 0).any(1).sum()),
            "paid twice": int(((codes > 0).sum(1) > 1).sum()),
        }
    )


def jostled(name: str, turns: int, n: int) -> Counter[str]:
    """Take one step of many crowds, again and again; most often all robots go ahead."""
    spec, generator = spec_of((CASES | OTHERS)[name]), np.random.default_rng(turns)
    rules, games, count = rules_for(spec), packages(spec, n), Counter[str]()
    for turn in range(turns):
        rows = np.array([crowded(rules, generator) for _ in range(n)])
        actions = generator.choice(5, p=[0.05, 0.6, 0.1, 0.1, 0.15], size=(n, spec.agents))
        actions[generator.random(n) < 0.7] = FORWARD
        count += compare_all(spec, games, state=list(rows.T), actions=actions, seed=turn)
    return count


ONCE = sampled([(name, 1, 300) for name in (*CASES, *OTHERS)], [("small-4ag", 1, 300), ("two-stage", 1, 300)])
CROWDS = [
    pytest.param(name, turns, 100, marks=pytest.mark.exhaustive)
    for name, turns in (("tiny-2ag", 260), ("tiny-4ag", 160))
]
"""Two robots are in each other's way in 4 steps of 10, four in 6."""


@pytest.mark.parametrize(("name", "turns", "n"), [*ONCE, *CROWDS])
def test_robots_in_each_others_way(name: str, turns: int, n: int) -> None:
    seen = jostled(name, turns, n)
    print(name, dict(seen))
    robots = spec_of((CASES | OTHERS)[name]).agents
    due = {"taken", "put", "paid"}
    due |= {"collisions", "contested", "swaps", "queues"} if robots > 1 else set()
    due |= {"rings", "later first"} if robots > 3 else set()
    assert due <= {what for what, count in seen.items() if count}
    assert turns == 1 or seen["collisions"] >= 10_000


MANY = [pytest.param(name, 4, marks=pytest.mark.exhaustive) for name in ("tiny-2ag", "tiny-4ag", "small-4ag")]


@pytest.mark.parametrize(("name", "games"), [("tiny-2ag", 2), *MANY])
def test_whole_episodes(name: str, games: int) -> None:
    """To their time limits, by robots that are at work."""
    spec = spec_of(CASES[name])
    assert spec.max_cycles == LIMIT
    rules = rules_for(spec)

    def working(ours: Ours, generator: np.random.Generator) -> Array:
        return worked(rules, [word.astype(np.int64) for word in ours.words], generator)

    count = compare_all(spec, packages(spec, games), steps=LIMIT, actions=working, seed=games)
    print(name, dict(count))
    assert min(count[what] for what in ("taken", "put", "paid", "collisions")) >= games


def test_each_shelf_that_is_not_asked_for_is_as_likely_to_be_next() -> None:
    """As many draws as there are such shelves ask for each of them once, also for two goals at once."""
    spec = spec_of({"robots": 2, "request_queue_size": 3})
    rules, step = rules_for(spec), reference(spec.positional.step)
    count = len(rules.racks) - rules.requests
    draws = np.array([-(-(rank << 32) // count) for rank in range(count)])
    goals = [(goal % rules.stride, rules.height - 1) for goal in rules.goals]
    generator = np.random.default_rng(0)
    for case in range(8):
        first, second = generator.choice(rules.racks, size=2, replace=False).tolist()
        robots = [Robot(*goals[0], 0, first), Robot(*goals[1], 0, second)]
        others = generator.choice(sorted({*rules.racks} - {first, second}), size=3, replace=False).tolist()
        # Both have what is asked for, or one of them. What is asked for instead may be what the second has.
        asked = [[*rules.goals, others[0]], [rules.goals[0], *others[:2]], [rules.goals[1], *others[:2]]][
            case % 3
        ]
        state = whole(rules, robots, asked)
        a, b = (each.ravel() for each in np.meshgrid(draws, draws))
        results = step(*(np.full(len(a), word) for word in state), 0, 0, a, b)
        left = np.stack(parts(rules, results[: len(spec.state)])[1], 1)
        home = dict(zip(rules.goals, (first, second), strict=True))
        # A shelf that a robot has is known by its rack, as a standing one is.
        racks = {cell: home.get(cell, cell) for cell in [*rules.racks, *rules.goals]}
        after = Counter(tuple(sorted(racks[cell] for cell in row)) for row in left.tolist())
        expected = Counter[tuple[int, ...]]()
        before = {racks[cell] for cell in asked}
        for i in range(count):
            for j in range(count):
                queue = before
                for rack, rank in ((first, i), (second, j)):
                    if rack in queue:
                        free = sorted({*rules.racks} - queue)
                        queue = queue - {rack} | {free[rank]}
                expected[tuple(sorted(queue))] += 1
        # The second shelf is another one of the same number; so only how often there is what is equal.
        assert after == expected


# ---- Starts


def test_starts() -> None:
    """Every pair of cells, directions, and pair of shelves is as likely, by itself and beside the others."""
    spec, n = spec_of({}), 200_000
    rules = rules_for(spec)
    state = started(spec, n, seed=2)
    robots, requests = parts(rules, state)
    assert all(not np.any(robot.origin) for robot in robots)
    cells = [robot.y * rules.width + robot.x for robot in robots]
    racks = np.sort(np.searchsorted(rules.racks, np.stack(requests)), 0)
    directions = robots[0].direction * 4 + robots[1].direction
    check_starts(rules, *cells, directions, *racks)


@pytest.mark.parametrize("n", [1_000, pytest.param(20_000, marks=pytest.mark.exhaustive)])
def test_starts_of_the_package(n: int) -> None:
    """They are of the same law."""
    rules = rules_for(spec_of({}))
    oracle = Warehouse(3, 8, 1, 2, 0, 1, 2, None, LIMIT, RewardType.INDIVIDUAL)
    rows = []
    for seed in range(n):
        oracle.reset(seed=seed)
        cells = [agent.y * rules.width + agent.x for agent in oracle.agents]
        directions = oracle.agents[0].dir.value * 4 + oracle.agents[1].dir.value
        racks = sorted(rules.racks.index(rules.cell(s.x, s.y)) for s in oracle.request_queue)
        rows.append((*cells, directions, *racks))
    check_starts(rules, *np.array(rows).T)


def check_starts(
    rules: WarehouseRules, a: Array, b: Array, directions: Array, first: Array, second: Array
) -> None:
    """Hold starts against what is told of them: robots in different cells, and so on, all as likely."""
    n, count = rules.width * rules.height, len(rules.racks)
    assert (a != b).all()
    assert (first < second).all()
    features = {
        "cells": (a * (n - 1) + b - (b > a), n * (n - 1)),
        "the first robot's": (a, n),
        "the second robot's": (b, n),
        "directions": (directions, 16),
        "shelves": (second * (second - 1) // 2 + first, count * (count - 1) // 2),
        "a robot's cell and the directions": (a * 16 + directions, 16 * n),
        "shelves and a direction": (
            (second * (second - 1) // 2 + first) * 4 + directions % 4,
            2 * count * (count - 1),
        ),
    }
    for name, (numbers, outcomes) in features.items():
        if len(a) >= 5 * outcomes:
            p = stats.chisquare(np.bincount(numbers, minlength=outcomes)).pvalue
            print(f"{name}: p = {p:.3f}")
            assert p > 0.001


# ---- Options, words and pictures


@pytest.mark.parametrize("name", CASES)
def test_the_package_registers_it(name: str) -> None:
    spec = spec_of(CASES[name])
    rules, known = rules_for(spec), dict(gymnasium.spec(f"rware-{name}-v2").kwargs)
    assert (known.pop("msg_bits"), known.pop("max_inactivity_steps")) == (0, None)
    assert known.pop("reward_type").name.lower() == rules.reward
    assert known == {
        "column_height": rules.column_height,
        "shelf_rows": rules.shelf_rows,
        "shelf_columns": rules.shelf_columns,
        "n_agents": rules.robots,
        "sensor_range": rules.sight,
        "request_queue_size": rules.requests,
        "max_steps": spec.max_cycles,
    }


@pytest.mark.parametrize("name", [*CASES, *OTHERS])
def test_spec(name: str) -> None:
    """Space, racks and goals are the package's, and every word fits its field."""
    spec = spec_of((CASES | OTHERS)[name])
    rules = rules_for(spec)
    oracle = Package(rules)
    assert spec.observation_space == oracle.env.observation_space[0]
    assert spec.action_space == oracle.env.action_space[0]
    assert (rules.height, rules.width) == oracle.env.grid_size
    assert rules.racks == oracle.racks
    assert list(rules.goals) == [rules.cell(x, y) for x, y in oracle.env.goals]
    spec.check_golden(spec.functions)


def test_sets() -> None:
    """Ties go by the order of CPython's sets, as they are in the Python that this is."""
    for x, y in itertools.product(range(16), range(29)):
        around = [(x, y), (x + 1, y), (x, y + 1), *([(x - 1, y)] if x else []), *([(x, y - 1)] if y else [])]
        for count in (2, 3):
            for cells in itertools.permutations(around, count):
                nodes = {cells[0]}
                for cell in cells[1:]:
                    nodes.add(cell)
                assert in_a_set(cells) == list(nodes)


def test_ties() -> None:
    """Of two that meet, while two others move elsewhere, networkx lets that go which we do."""
    rules = rules_for(spec_of({"robots": 4}))
    ties = make_ties(rules)
    elsewhere = [((20, 20), (20, 21)), ((22, 20), (22, 21))]
    for x, y, (a, b) in itertools.product(
        range(rules.width), range(rules.height), itertools.permutations(range(4), 2)
    ):
        first, second = ((x - AHEAD[way][0], y - AHEAD[way][1]) for way in (a, b))
        if min(*first, *second) >= 0:
            graph = networkx.DiGraph([(first, (x, y)), *elsewhere, (second, (x, y))])
            component = graph.subgraph(next(networkx.weakly_connected_components(graph))).copy()
            goes, _ = networkx.dag_longest_path(component)
            assert ties[a][b][rules.cell(x, y)] == (goes == second)


def test_pictures() -> None:
    """Each thing is where the state has it, in its colour."""
    pytest.importorskip("PIL")
    spec = spec_of({})
    rules = rules_for(spec)
    # The first robot carries what is asked for, onto a goal; the second stands under a shelf that is not.
    empty, goal, asked = rules.racks[3], rules.goals[0], rules.racks[17]
    loaded_robot = Robot(goal % rules.stride, rules.height - 1, 0, empty)
    state = whole(rules, [loaded_robot, Robot(1, 5, 3, 0)], [goal, asked])
    assert spec.draw is not None
    drawn, side = spec.draw(spec.layout.built(state)), picture.CELL
    assert drawn.shape == (rules.height * side + 1, rules.width * side + 1, 3)
    for x, y in itertools.product(range(rules.width), range(rules.height)):
        cell = rules.cell(x, y)
        pixels = drawn[y * side + 1 : (y + 1) * side, x * side + 1 : (x + 1) * side].reshape(-1, 3)
        held = {tuple(pixel.tolist()) for pixel in pixels}
        assert (picture.LOADED in held) == (cell == goal)
        assert (picture.ROBOT in held) == ((x, y) == (1, 5))
        assert (picture.ASKED in held) == (cell in (goal, asked))
        assert (picture.SHELF in held) == (cell in {*rules.racks} - {empty, asked})
        assert (picture.GOAL in held) == (cell in rules.goals)
    turned = whole(rules, [loaded_robot._replace(direction=1), Robot(1, 5, 3, 0)], [goal, asked])
    assert not np.array_equal(drawn, spec.draw(spec.layout.built(turned)))


REFUSED: dict[str, dict[str, Any]] = {
    "size is 'huge'; possible are 'tiny', 'small', 'medium' and 'large'": {"size": "huge"},
    "robots is 5; it must be an integer from 1 to 4: with more, rware breaks ties": {"robots": 5},
    "robots is 0; it must be an integer from 1 to 4": {"robots": 0},
    "robots is True; it must be an integer": {"robots": True},
    "request_queue_size is 0; it must be an integer from 1 to 19": {"request_queue_size": 0},
    "request_queue_size is 4; it must be an integer from 1 to 3": {
        "column_height": 1,
        "request_queue_size": 4,
    },
    "column_height is 16; it must be an integer from 1 to 15": {"column_height": 16},
    "sensor_range is 6; it must be an integer from 1 to 5": {"sensor_range": 6},
    "reward_type is 'team'; possible are 'individual', 'global' and 'two_stage'": {"reward_type": "team"},
    "max_steps is 0; it must be an integer from 1": {"max_steps": 0},
    "unknown argument 'msg_bits'": {"msg_bits": 2},
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_is_refused(sentence: str) -> None:
    with pytest.raises(ArgumentError, match=sentence) as caught:
        spec_of(REFUSED[sentence])
    assert "\n" not in str(caught.value)
