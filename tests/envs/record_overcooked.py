"""Records games of the package ``overcooked-ai``, for ``test_overcooked.py`` to replay.

    python -m venv oracle && oracle/bin/pip install overcooked-ai==1.1.0
    oracle/bin/python tests/envs/record_overcooked.py tests/envs/overcooked.npz [TIMES_AS_MANY_GAMES]

The package needs ``gym``, which nobody maintains, so it has an environment of its own. What is recorded is
what the package's dynamics say: a state as a row of bytes, what each cook is paid, shaped rewards, and a
checksum of both observations. The checksums of a game are chained. A byte of each is kept and all of the
last one: a single observation that differs changes all that follow.
"""

from __future__ import annotations

import itertools
import json
import sys
import zlib
from collections import defaultdict, deque
from typing import Any

import numpy as np
from overcooked_ai_py.mdp.actions import Action, Direction
from overcooked_ai_py.mdp.overcooked_mdp import (
    ObjectState,
    OvercookedGridworld,
    OvercookedState,
    PlayerState,
    SoupState,
)

CASES = {
    "cramped_room": {"games": 16},
    "asymmetric_advantages": {"games": 12},
    "coordination_ring": {"games": 12},
    "forced_coordination": {"games": 12},
    "counter_circuit_o_1order": {"games": 12},
    "counter_circuit": {"games": 12},
    "asymmetric_advantages_tomato": {"games": 12, "steps": 160},
    "cramped_room_o_3orders": {"games": 12, "steps": 160},
    "cramped_room_tomato": {"games": 12, "steps": 160},
    "forced_coordination_tomato": {"games": 12, "steps": 160},
    "bottleneck": {"games": 6, "steps": 120},
    "centre_pots": {"games": 6, "steps": 120},
    "five_by_five": {"games": 6, "steps": 120},
    "large_room": {"games": 6, "steps": 120},
    "schelling": {"games": 6, "steps": 120},
    "simple_o": {"games": 6, "steps": 120},
    "soup_coordination": {"games": 12, "steps": 160},
    "cramped_room, quick": {"layout": "cramped_room", "horizon": 60, "cook_time": 1, "games": 16},
    "asymmetric_advantages, short": {"layout": "asymmetric_advantages", "horizon": 39, "games": 16},
    "coordination_ring, slow": {"layout": "coordination_ring", "horizon": 200, "cook_time": 37, "games": 4},
}
"""Layouts and options, how many games of each, and how many steps of a game, if not all."""
MEETINGS = {"cramped_room": 700, "coordination_ring": 700, "counter_circuit": 700}
"""Layouts of which single steps are recorded too, and of how many states that are put together by chance."""
ITEMS = {"onion": 1, "tomato": 2, "dish": 3}
"""Numbers of what is no soup; 0 is nothing, and a soup is 4 and one for an onion and four for a tomato."""
RECIPES = [(onions, tomatoes) for onions in range(4) for tomatoes in range(4) if 0 < onions + tomatoes <= 3]


def soup(ingredients: list[str]) -> int:
    return ingredients.count("onion") + 4 * ingredients.count("tomato")


def item(thing: Any) -> int:
    if thing is None:
        return 0
    return 4 + soup(thing.ingredients) if thing.name == "soup" else ITEMS[thing.name]


def row_of(mdp: Any, state: Any) -> list[int]:
    """Return a state as bytes: place, direction and item of the cooks, then the counters, then the pots.

    A pot has a soup, and 1 more than how long it has been cooking; 0 before it does.
    """
    row = []
    for player in state.players:
        row += [*player.position, Direction.DIRECTION_TO_INDEX[player.orientation], item(player.held_object)]
    counters, pots = mdp.get_counter_locations(), mdp.get_pot_locations()
    row += [item(state.objects.get(cell)) for cell in counters]
    for cell in pots:
        thing = state.objects.get(cell)
        row += [0, 0] if thing is None else [soup(thing.ingredients), thing._cooking_tick + 1]
    assert set(state.objects) <= {*counters, *pots}
    return row


class Cook:
    """Goes somewhere and acts there, most often where it makes sense."""

    def __init__(self, mdp: Any, which: int, generator: np.random.Generator) -> None:
        self.mdp, self.which, self.generator = mdp, which, generator
        self.goal: Any = None
        self.before: Any = None

    def action(self, state: Any) -> Any:
        generator, player = self.generator, state.players[self.which]
        stuck, self.before = self.before == player.pos_and_or, player.pos_and_or
        if generator.random() < (0.4 if stuck else 0.08):
            return Action.ALL_ACTIONS[generator.integers(6)]
        ways = self._ways(player.position)
        if self.goal is None or generator.random() < 0.03:
            self.goal = self._chosen(state, player.held_object, ways)
        place, way = self.goal, ways[self.goal]
        if not way:
            here = tuple(np.subtract(place, player.position).tolist())
            if player.orientation != here:
                return here
            self.goal = None
            return Action.INTERACT
        return way[0]

    def _ways(self, start: Any) -> dict[Any, list[Any]]:
        """Return the way to everything in reach but the floor, by the place."""
        floor = self.mdp.get_valid_player_positions()
        ways, seen, left = {}, {start}, deque([(start, [])])
        while left:
            cell, way = left.popleft()
            for direction in Direction.ALL_DIRECTIONS:
                near = Action.move_in_direction(cell, direction)
                if near not in floor:
                    ways.setdefault(near, way)
                elif near not in seen:
                    seen.add(near)
                    left.append((near, [*way, direction]))
        return ways

    def _chosen(self, state: Any, held: Any, ways: dict[Any, list[Any]]) -> Any:
        places, holds = list(ways), "nothing" if held is None else held.name
        soups = [thing for cell, thing in state.objects.items() if cell in self.mdp.get_pot_locations()]
        # Somebody with empty hands has to begin.
        begin = any(soup.is_idle and soup.is_full for soup in soups)
        cooking = any(not soup.is_idle for soup in soups)
        kinds = {self.mdp.get_terrain_type_at_pos(place) for place in places}
        hands_on = held is not None and ("S" if holds == "soup" else "P") not in kinds
        weights = []
        for place in places:
            kind, thing = self.mdp.get_terrain_type_at_pos(place), state.objects.get(place)
            if kind == "X":
                worth = 1.0 if held is None or begin or hands_on else 0.15
                worth = 0.02 if (held is None) != (thing is not None) else worth
                worth /= 1 + len(ways[place])
            elif kind == "P":
                worth = self._pot_worth(holds, thing)
            elif kind == "S":
                worth = 8.0 if holds == "soup" else 0.02
            elif held is None:
                worth = {"O": 1.0, "T": 0.7, "D": 1.5 if cooking else 0.1}[kind]
            else:
                worth = 0.02
            weights.append(worth)
        return places[self.generator.choice(len(places), p=np.array(weights) / sum(weights))]

    @staticmethod
    def _pot_worth(holds: str, thing: Any) -> float:
        if holds == "nothing":
            return 8.0 if thing and thing.is_idle and len(thing.ingredients) == 3 else 0.06
        if holds == "dish":
            return 12.0 if thing and not thing.is_idle else 0.5
        full = thing is not None and thing.is_full
        return 0.1 if holds == "soup" else 0.2 if full else 4.0


def play(mdp: Any, horizon: int, steps: int, generator: np.random.Generator) -> dict[str, Any]:
    cooks = [Cook(mdp, k, generator) for k in range(2)]
    state, check = mdp.get_standard_start_state(), 0
    actions, states, paid, shaped, checks = [], [row_of(mdp, state)], [], [], []

    def observed(check: int) -> int:
        for observation in mdp.lossless_state_encoding(state, horizon):
            assert (observation == observation.astype(np.uint8)).all()
            check = zlib.crc32(observation.astype(np.uint8).tobytes(), check)
        return check

    check = observed(check)
    checks.append(check)
    for _ in range(steps):
        joint = [cook.action(state) for cook in cooks]
        state, infos = mdp.get_state_transition(state, joint)
        check = observed(check)
        actions.append([Action.ACTION_TO_INDEX[action] for action in joint])
        states.append(row_of(mdp, state))
        paid.append(infos["sparse_reward_by_agent"])
        shaped.append(infos["shaped_reward_by_agent"])
        checks.append(check)
    assert state.timestep == steps
    return {
        "actions": np.array(actions, np.uint8),
        "states": np.array(states, np.uint8),
        "paid": np.array(paid, np.uint8),
        "shaped": np.array(shaped, np.uint8),
        "checks": np.array(checks, np.uint32),
    }


def anything(mdp: Any, generator: np.random.Generator) -> Any:
    """Return a state by chance, with cooks that face something and a lot that lies around."""
    has_tomatoes = bool(mdp.get_tomato_dispenser_locations())
    recipes = [recipe for recipe in RECIPES if has_tomatoes or not recipe[1]]

    def thing(cell: Any, none: float) -> Any:
        if generator.random() < none:
            return None
        kind = generator.integers(4)
        if kind == 0:
            onions, tomatoes = recipes[generator.integers(len(recipes))]
            return SoupState.get_soup(cell, onions, tomatoes, finished=True)
        grown = "tomato" if has_tomatoes and generator.random() < 0.5 else "onion"
        return ObjectState("dish" if kind < 3 else grown, cell)

    floor = mdp.get_valid_player_positions()
    # By what is faced, each kind as likely.
    standing = defaultdict(list)
    for cell, to in itertools.product(floor, Direction.ALL_DIRECTIONS):
        standing[mdp.get_terrain_type_at_pos(Action.move_in_direction(cell, to))].append((cell, to))
    del standing[" "]
    cooks: list[Any] = []
    while len(cooks) < 2:
        choices = standing[generator.choice(sorted(standing))]
        cell, to = choices[generator.integers(len(choices))]
        if all(cook.position != cell for cook in cooks):
            cooks.append(PlayerState(cell, to, thing(cell, 0.4)))
    reach = {Action.move_in_direction(cell, to) for cell in floor for to in Direction.ALL_DIRECTIONS}
    empty, objects = generator.choice([1.0, 0.9, 0.5]), {}
    for cell in mdp.get_counter_locations():
        lies = thing(cell, empty) if cell in reach else None
        if lies:
            objects[cell] = lies
    for cell in mdp.get_pot_locations():
        if generator.random() < 0.2:
            continue
        soup = SoupState.get_soup(cell, *recipes[generator.integers(len(recipes))])
        if generator.random() < 0.6:
            soup.begin_cooking()
            soup._cooking_tick = max(0, soup.cook_time - int(generator.integers(4)))
        objects[cell] = soup
    orders = {"bonus_orders": mdp.start_bonus_orders, "all_orders": mdp.start_all_orders}
    return OvercookedState(cooks, objects, **orders, timestep=int(generator.integers(400)))


def meetings(name: str, count: int) -> dict[str, Any]:
    """Return states put together by chance, and what comes of a step in which most act."""
    generator = np.random.default_rng(zlib.crc32(name.encode()))
    mdp = OvercookedGridworld.from_layout_name(name)
    columns: dict[str, list[Any]] = defaultdict(list)
    for _ in range(count):
        state = anything(mdp, generator)
        chosen = generator.choice(6, 2, p=[0.04, 0.04, 0.04, 0.04, 0.04, 0.8])
        after, infos = mdp.get_state_transition(state, [Action.INDEX_TO_ACTION[k] for k in chosen])
        columns["actions"].append(chosen)
        columns["states"].append([row_of(mdp, state), row_of(mdp, after)])
        columns["times"].append(state.timestep)
        columns["paid"].append(infos["sparse_reward_by_agent"])
        columns["shaped"].append(infos["shaped_reward_by_agent"])
        views = mdp.lossless_state_encoding(after, 400)
        columns["checks"].append(zlib.crc32(np.array(views, np.uint8).tobytes()) & 255)
    states = np.array(columns.pop("states"), np.uint8)
    types = {"times": np.uint16}
    arrays = {key: np.array(column, types.get(key, np.uint8)) for key, column in columns.items()}
    return arrays | {"before": states[:, 0], "change": states[:, 0] ^ states[:, 1]}


def record(
    name: str, layout: str, horizon: int, cook_time: int | None, games: int, steps: int | None
) -> dict[str, Any]:
    seed = np.random.SeedSequence(zlib.crc32(name.encode()))
    mdp = OvercookedGridworld.from_layout_name(layout, **({"cook_time": cook_time} if cook_time else {}))
    generators = map(np.random.default_rng, seed.spawn(games))
    played = [play(mdp, horizon, steps or horizon, generator) for generator in generators]
    columns = {key: np.stack([game[key] for game in played], 1) for key in played[0]}
    columns["soups"] = int((columns["paid"] > 0).sum())
    return columns


def main() -> None:
    path, times = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 1
    arrays, count = {}, 0
    for name, case in CASES.items():
        options = {"layout": name, "horizon": 400, "cook_time": None, "steps": None, **case}
        games, steps = options.pop("games") * times, options.pop("steps")
        columns = record(name, **options, games=games, steps=steps)
        print(f"{name}: {columns.pop('soups')} soups paid for")
        count += columns["actions"].shape[0] * columns["actions"].shape[1]
        # States change little from step to step, so what changes is what is kept.
        states = columns["states"]
        columns["states"] = np.concatenate([states[:1], states[1:] ^ states[:-1]])
        checks = columns.pop("checks")
        columns["checks"], columns["last_checks"] = (checks & 255).astype(np.uint8), checks[-1]
        columns["options"] = np.array(json.dumps(options))
        arrays.update({f"{name}/{key}": value for key, value in columns.items()})
    for name, states in MEETINGS.items():
        columns = meetings(name, states * times)
        arrays.update({f"{name}: {key}": value for key, value in columns.items()})
    np.savez_compressed(path, **arrays)
    print(f"{count:,} steps")


if __name__ == "__main__":
    main()
