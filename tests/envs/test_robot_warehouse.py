"""RobotWarehouse against the package ``rware``: its starts, and what comes of the same actions and draws."""

from __future__ import annotations

import itertools
from collections import Counter
from typing import Any

import numpy as np
import pytest
from pearl_marl.envs.robot_warehouse.rules import Rules
from pearl_marl.envs.robot_warehouse.spec import rules_of
from pearl_marl.envs.robot_warehouse.step import Robot, parts
from rware.warehouse import Action, Direction, RewardType, Shelf, Warehouse

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.golden import call_reference, reference

Array = np.ndarray[Any, Any]
LIMIT = 500


def spec_of(given: dict[str, Any]) -> EnvSpec:
    return pearl_marl.get_spec("RobotWarehouse").with_options(**given)


class Oracle:
    """The package's warehouse, put where ours is, with draws of ours.

    Its shelves have names, and ours have not: there a shelf is known by the rack that it stands in, or was taken from.
    """

    def __init__(self, rules: Rules) -> None:
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
        self.racks = {shelf.id: self.cell(shelf) for shelf in self.env.shelfs}

    def cell(self, thing: Any) -> int:
        return int(self.rules.cell(thing.x, thing.y))

    def put(self, state: list[int]) -> None:
        """Start where ours does."""
        env, (robots, requests) = self.env, parts(self.rules, state)
        env._cur_steps = 0
        at = {rack: shelf for rack, shelf in zip(self.racks.values(), env.shelfs, strict=True)}
        for rack, shelf in at.items():
            shelf.x, shelf.y = rack % self.rules.stride, rack // self.rules.stride
        for agent, robot in zip(env.agents, robots, strict=True):
            agent.x, agent.y, agent.dir = robot.x, robot.y, Direction(robot.direction)
            agent.carrying_shelf, agent.has_delivered = at.get(robot.origin), bool(robot.brought)
            if agent.carrying_shelf:
                agent.carrying_shelf.x, agent.carrying_shelf.y = robot.x, robot.y
        where = {self.cell(shelf): shelf for shelf in env.shelfs}
        assert len(where) == len(env.shelfs) == self.rules.racks
        env.request_queue = [where[cell] for cell in requests]
        assert len(set(env.request_queue)) == self.rules.requests
        env._recalc_grid()

    def step(self, actions: list[int], draws: list[int], robots: list[Robot]) -> tuple[Any, ...]:
        """Step the package; robots are ours after the step."""
        self.draws, self.robots, self.taken = list(draws), robots, None
        observations, rewards, done, _, _ = self.env.step(actions)
        return observations, rewards, done

    def rack(self, shelf: Shelf) -> int:
        """Return the rack that a shelf stands in or was taken from."""
        carriers = [k for k, agent in enumerate(self.env.agents) if agent.carrying_shelf is shelf]
        return self.robots[carriers[0]].origin if carriers else self.cell(shelf)

    def choice(self, candidates: list[Shelf]) -> Shelf:
        """Stand in for the package's generator: choose the next shelf to ask for, by our draw."""
        env = self.env
        at_goals = [env.grid[1, y, x] for x, y in env.goals]
        if self.taken is None:
            order = sorted(candidates, key=self.rack)
            first = bool(at_goals[0]) and env.shelfs[at_goals[0] - 1] in env.request_queue
            draw = self.draws[0 if first else 1]
        else:
            order, index = self.taken
            order[index] = env.shelfs[at_goals[0] - 1]
            draw = self.draws[1]
        assert len(set(order)) == len(order) and set(order) == set(candidates)
        index = draw * len(order) >> 32
        self.taken = order, index
        return order[index]

    def seen(self) -> tuple[Any, ...]:
        """Return all that a state tells, in no order: robots, racks without a shelf, shelves asked for."""
        env = self.env
        robots = [(a.x, a.y, a.dir.value, a.carrying_shelf is not None, a.has_delivered) for a in env.agents]
        standing = {self.cell(shelf) for shelf in env.shelfs} - {
            self.cell(agent) for agent in env.agents if agent.carrying_shelf
        }
        return robots, set(self.racks.values()) - standing, {self.cell(s) for s in env.request_queue}


def told(rules: Rules, state: list[int]) -> tuple[Any, ...]:
    """Return the same of ours."""
    robots, requests = parts(rules, state)
    paid = rules.reward == "two_stage"
    return (
        [(r.x, r.y, r.direction, r.origin != 0, bool(r.brought) and paid) for r in robots],
        {r.origin for r in robots if r.origin},
        set(requests),
    )


def rules_for(spec: EnvSpec) -> Rules:
    return rules_of(**{name: value for name, value in spec.options.items() if name != "max_steps"})


def crowded(rules: Rules, generator: np.random.Generator) -> list[int]:
    """Return a state in which robots are close together, in each other's way."""
    if generator.random() < 0.5:
        return loaded(rules, generator, queued(rules, generator))
    wide, high = [(2, 2), (3, 2), (2, 3), (3, 3)][generator.integers(4)]
    left, top = generator.integers(rules.width - wide + 1), generator.integers(rules.height - high + 1)
    if generator.random() < 0.4:  # at the goals
        left, top = rules.width // 2 - 1 - generator.integers(wide - 1), rules.height - high
    chosen = generator.permutation(wide * high)[: rules.robots]
    places = [(int(left + c % wide), int(top + c // wide)) for c in chosen]
    directions = generator.integers(4, size=rules.robots).tolist()
    if (wide, high) == (2, 2) and generator.random() < 0.5:
        # In a ring, this way or that.
        way = [(3, 1, 0, 2), (1, 2, 3, 0)][generator.integers(2)]
        directions = [way[c] for c in chosen]
    return loaded(rules, generator, [(*place, way) for place, way in zip(places, directions, strict=True)])


def queued(rules: Rules, generator: np.random.Generator) -> list[tuple[int, int, int]]:
    """Return robots of which two or three want the same cell, and others want theirs or are anywhere."""
    robots: dict[tuple[int, int], int] = {}
    wanted = [(int(generator.integers(rules.width)), int(generator.integers(rules.height)))]
    while len(robots) < rules.robots:
        chance = generator.random()
        if len(robots) < 2 or chance < 0.2:
            x, y = wanted[0]
        elif chance < 0.6:
            x, y = list(robots)[generator.integers(len(robots))]
        else:
            x, y = int(generator.integers(rules.width)), int(generator.integers(rules.height))
        way = int(generator.integers(4))
        place = x - AHEAD[way][0], y - AHEAD[way][1]
        free = place not in robots and place not in wanted
        if free and 0 <= place[0] < rules.width and 0 <= place[1] < rules.height:
            robots[place] = way
    return [(*place, robots[place]) for place in generator.permutation(list(robots)).tolist() for place in [tuple(place)]]


def loaded(
    rules: Rules, generator: np.random.Generator, robots: list[tuple[int, int, int]]
) -> list[int]:
    """Give shelves to some robots, and ask for some of them; return the state."""
    racks, k = rack_cells(rules), rules.robots
    cells = [rules.cell(x, y) for x, y, _ in robots]
    carriers = [i for i in range(k) if generator.random() < 0.4]
    # Who carries a shelf where a rack is stands in an empty one.
    empty = [cells[i] for i in carriers if cells[i] in racks]
    others = [rack for rack in racks if rack not in empty]
    empty += generator.choice(others, size=len(carriers) - len(empty), replace=False).tolist()
    origins = dict(zip(carriers, generator.permutation(empty).tolist(), strict=True))
    asked = [cells[i] for i in carriers if generator.random() < 0.7][: rules.requests]
    standing = [rack for rack in racks if rack not in empty]
    asked += generator.choice(standing, size=rules.requests - len(asked), replace=False).tolist()
    state: list[int] = []
    for i, robot in enumerate(robots):
        brought = [int(generator.integers(2))] if rules.reward == "two_stage" else []
        state += [*robot, int(origins.get(i, 0)), *brought]
    return [*state, *asked]


def rack_cells(rules: Rules) -> list[int]:
    return [rules.cell(x, y) for xs, ys in zip(rules.rack_columns, rules.rack_rows, strict=True) for y in ys for x in xs]


def compare(given: dict[str, Any], n: int, steps: int, seed: int, anew: int = LIMIT) -> Counter[str]:
    """Play games of both, all of ours at once, and compare everything after every step; start anew now and then."""
    spec, generator = spec_of(given), np.random.default_rng(seed)
    rules = rules_for(spec)
    oracles = [Oracle(rules) for _ in range(n)]
    step = reference(spec.golden.step)
    views = [reference(spec.golden.observe, *agent) for agent in spec.views]
    table, seen = np.array(spec.rewards), Counter[str]()
    k = spec.agents
    for t in range(steps):
        if t % anew == 0:
            rows = [crowded(rules, generator) for _ in range(n)]
            if anew == LIMIT:
                draws = generator.integers(1 << 32, size=(spec.reset_draws, n), dtype=np.uint32)
                rows = np.stack(call_reference(spec.golden.initial, draws), 1).tolist()
            state = list(np.array(rows).T)
            for oracle, row in zip(oracles, rows, strict=True):
                oracle.put(row)
        actions = generator.choice(5, p=[0.04, 0.7, 0.08, 0.08, 0.1], size=(n, k))
        draws = generator.integers(1 << 32, size=(spec.step_draws, n), dtype=np.uint32)
        results = step(*state, *actions.T, *draws)
        before, state = state, list(results[: len(state)])
        codes = np.stack(results[len(state) : len(state) + k], 1)
        assert not any(np.any(over) for over in results[len(state) + k :])
        ours = np.stack([np.stack(np.broadcast_arrays(*view(*state), state[0])[:-1], 1) for view in views], 1)
        rows = np.stack(state, 1).tolist()
        for i, oracle in enumerate(oracles):
            robots, _ = parts(rules, rows[i])
            theirs, paid, done = oracle.step(actions[i].tolist(), draws[:, i].tolist(), robots)
            np.testing.assert_array_equal(ours[i].astype(np.float32), np.stack(theirs))
            np.testing.assert_array_equal(table[codes[i]], paid)
            assert oracle.seen() == told(rules, rows[i])
        seen.update(counted(rules, before, state, actions, codes))
    return seen


AHEAD = np.array([(0, -1), (0, 1), (-1, 0), (1, 0)])


def counted(rules: Rules, before: list[Array], after: list[Array], actions: Array, codes: Array) -> Counter[str]:
    was, asked = parts(rules, before)
    now, asks = parts(rules, after)
    at = np.stack([np.stack([r.x, r.y], 1) for r in was], 1)
    to = np.stack([np.stack([r.x, r.y], 1) for r in now], 1)
    ways = np.stack([r.direction for r in was], 1)
    wish = np.where((actions == 1)[..., None], at + AHEAD[ways], at)
    wish = np.clip(wish, 0, [rules.width - 1, rules.height - 1])
    cell, target, place = (rules.cell(x[..., 0], x[..., 1]) for x in (at, wish, to))
    moving, moved = target != cell, place != cell
    k = rules.robots
    pairs = list(itertools.combinations(range(k), 2))
    same = {p: moving[:, p[0]] & moving[:, p[1]] & (target[:, p[0]] == target[:, p[1]]) for p in pairs}
    swap = {(a, b): (target[:, a] == cell[:, b]) & (target[:, b] == cell[:, a]) & moving[:, a] for a, b in pairs}
    onto = sum((target[:, a] == cell[:, b]) & moving[:, a] for a in range(k) for b in range(k) if a != b)
    refused = moving & ~moved
    meets = np.any([*same.values(), onto > 0], 0) if pairs else np.zeros(len(at), bool)
    origin = np.stack([r.origin for r in now], 1)
    was_origin = np.stack([r.origin for r in was], 1)
    return Counter(
        {
            "steps": len(at),
            "collisions": int((refused.any(1) & meets).sum()),
            "contested": int(np.any(list(same.values()), 0).sum()) if pairs else 0,
            "second wins": int(np.any([s & moved[:, b] for (a, b), s in same.items()], 0).sum()) if pairs else 0,
            "swaps": int(np.any(list(swap.values()), 0).sum()) if pairs else 0,
            "follows": int(sum((target[:, a] == cell[:, b]) & moved[:, a] for a in range(k) for b in range(k) if a != b).sum()) if pairs else 0,
            "rings": int((moved.all(1) & (np.sort(cell) == np.sort(place)).all(1)).sum()),
            "loads": int(((was_origin == 0) & (origin != 0)).sum()),
            "unloads": int(((was_origin != 0) & (origin == 0)).sum()),
            "delivered": int((codes > 0).sum()),
            "twice": int(((codes > 0).sum(1) > 1).sum()),
        }
    )


CASES = {
    "tiny-2ag": {},
    "tiny-4ag": {"robots": 4},
    "small-4ag": {"robots": 4, "size": "small"},
}


@pytest.mark.parametrize("name", CASES)
def test_crowds(name: str) -> None:
    seen = compare(CASES[name], 20, 50, seed=1, anew=2)
    print(name, dict(seen))
