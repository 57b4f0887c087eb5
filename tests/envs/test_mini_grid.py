"""MiniGrid's environments against the package: their starts, and what comes of the same actions."""

from __future__ import annotations

import re
from collections import Counter
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.envs.mini_grid import BALL, DOOR, DROP, FORWARD, KEY, LEFT, PICKUP, TOGGLE
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import Draws, call_reference
from pearl_marl.porting.oracle import Games, Ours, Outcome, compare
from pearl_marl.testing import compare_pictures
from pearl_marl.testing.oracles import LIKELY

from ..sampling import sampled

Array = np.ndarray[Any, Any]

CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "Empty-8x8": ("Empty", {}),
    "Empty-Random-5x5": ("Empty", {"size": 5, "agent_start_pos": None}),
    "DoorKey-8x8": ("DoorKey", {}),
    "DoorKey-5x5": ("DoorKey", {"size": 5}),
    "DoorKey-16x16": ("DoorKey", {"size": 16}),
    "KeyCorridorS3R1": ("KeyCorridor", {}),
    "KeyCorridorS3R2": ("KeyCorridor", {"room_size": 3, "num_rows": 2}),
    "KeyCorridorS6R3": ("KeyCorridor", {"room_size": 6, "num_rows": 3}),
    "LavaGapS7": ("LavaGap", {}),
    "LavaGapS5": ("LavaGap", {"size": 5}),
    "FourRooms": ("FourRooms", {}),
    "Dynamic-Obstacles-8x8": ("DynamicObstacles", {}),
    "Dynamic-Obstacles-Random-5x5": (
        "DynamicObstacles",
        {"size": 5, "agent_start_pos": None, "n_obstacles": 2},
    ),
    "Dynamic-Obstacles-16x16": ("DynamicObstacles", {"size": 16, "n_obstacles": 8}),
    "MemoryS13": ("Memory", {}),
    "MemoryS7": ("Memory", {"size": 7}),
    "MemoryS17Random": ("Memory", {"size": 17, "random_length": True}),
}
"""By their names in MiniGrid."""
SMALL = (
    *(
        "Empty-Random-5x5",
        "DoorKey-5x5",
        "KeyCorridorS3R1",
        "LavaGapS5",
        "FourRooms",
        "Dynamic-Obstacles-Random-5x5",
        "MemoryS7",
    ),
)
"""One of each environment."""
HAPPENS: dict[str, set[str]] = {
    "Empty": {"goals", "late"},
    "DoorKey": {"goals", "late", "carried", "open", "closed", "locked"},
    "LavaGap": {"goals", "deaths"},
    "KeyCorridor": {"goals", "late", "carried", "open", "closed", "locked"},
    "FourRooms": {"goals", "late"},
    "DynamicObstacles": {"goals", "deaths"},
    "Memory": {"goals", "deaths"},
}
"""What much play in the small ones has to see."""


def spec_of(case: str) -> EnvSpec:
    name, options = CASES[case]
    return pearl_marl.get_spec(f"MiniGrid{name}").with_options(**options)


def original(spec: EnvSpec, **how: Any) -> Any:
    assert spec.oracle is not None
    game = gymnasium.make(spec.oracle, **how, **spec.options).unwrapped
    game.reset(seed=0)
    return game


def put(game: Any, state: Any, spec: EnvSpec) -> None:
    assert spec.pose is not None
    spec.pose(game, state)


def look(game: Any) -> Outcome:
    return Outcome(game.gen_obs()["image"].ravel())


def act(game: Any, actions: list[int], draws: list[int]) -> Outcome:
    if hasattr(game, "obstacles"):
        game.place_obj = partial(roll, game, Draws(draws))
    seen, reward, terminated, truncated, _ = game.step(actions[0])
    return Outcome(seen["image"].ravel(), reward, terminated, truncated and not terminated)


def roll(game: Any, draws: Draws, ball: Any, top: Any, size: Any, max_tries: int) -> None:
    """Put a ball into one of the free cells around it, as MiniGrid does by trying any until one is free."""
    columns, rows = (range(first, first + length) for first, length in zip(top, size, strict=True))
    free = [
        (x, y)
        for x in columns
        for y in rows
        if game.grid.get(x, y) is None and (x, y) != tuple(game.agent_pos)
    ]
    rank = draws.digit(max(len(free), 1), 8)
    if not free:
        raise RecursionError
    ball.cur_pos = free[rank]
    game.grid.set(*ball.cur_pos, ball)


def grid_of(game: Any) -> Any:
    """Return all there is in a game: its grid, its agent and what that carries."""
    carried = None if game.carrying is None else game.carrying.encode()
    return game.grid.encode().tolist(), tuple(map(int, game.agent_pos)), int(game.agent_dir), carried


def curious(ours: Ours, generator: np.random.Generator) -> Array:
    """Choose any actions; but go ahead often, and often do what there is to do with a thing ahead."""
    actions: Array = generator.integers(ours.spec.action_counts[0], size=ours.n)
    chance = generator.random(ours.n)
    actions[chance < 0.4] = FORWARD
    if ours.spec.action_counts[0] > TOGGLE:
        ahead = ours.observations().reshape(ours.n, 7, 7, 3)[:, 3, 5, 0]
        actions[(chance < 0.8) & np.isin(ahead, (KEY, BALL))] = PICKUP
        actions[(chance < 0.5) & (ahead == DOOR)] = TOGGLE
        actions[chance > 0.97] = DROP
    return actions[:, None]


def starts(spec: EnvSpec, n: int, seed: int) -> list[Array]:
    """Return the columns of ``n`` starts."""
    draws = np.random.default_rng(seed).integers(1 << 32, size=(spec.reset_draws, n))
    words = call_reference(spec.positional.initial, draws) if len(draws) else spec.positional.initial()
    return [np.resize(word, n) for word in words]


def scattered(spec: EnvSpec, n: int) -> list[Array]:
    """Return starts, in half of which a door is in any state and the key in the agent's hand.

    Where there is a ball, it lies ahead of the agent in the other half, and in half of these.
    """
    words, generator = starts(spec, n, seed=1), np.random.default_rng(2)
    for field, word in zip(spec.state, words, strict=True):
        if field.name in ("door", "key_carried"):
            word[::2] = generator.integers(field.range[1] + 1, size=len(word[::2]))
    named = {field.name: word for field, word in zip(spec.state, words, strict=True)}
    if "ball_x" in named:
        for games in (slice(1, None, 2), slice(0, None, 4)):
            named["agent_direction"][games] = 0
            named["ball_x"][games] = named["agent_x"][games] + 1
            named["ball_y"][games] = named["agent_y"][games]
    return words


def played(case: str, n: int, steps: int) -> Counter[str]:
    """Play games side by side; what no agent sees is compared too. Count what happens."""
    spec, count = spec_of(case), Counter[str]()
    games, other = [original(spec) for _ in range(n)], original(spec)
    oracle = Games(spec, games, lambda game, state: put(game, state, spec), act, look)
    moves = compare(spec, oracle, n, steps, state=scattered(spec, n), actions=curious, seed=1)
    for step, move in enumerate(moves):
        k = step % n
        put(other, spec.layout.built([word[k].item() for word in move.after]), spec)
        assert grid_of(other) == grid_of(games[k])
        image = move.outcome.observations.reshape(n, 7, 7, 3)
        count["steps"] += n
        count["goals"] += int((move.outcome.rewards > 0).sum())
        count["deaths"] += int((move.outcome.terminated & (move.outcome.rewards <= 0)).sum())
        count["late"] += int(move.outcome.truncated.sum())
        count["carried"] += int((image[:, 3, 6, 0] > 1).sum())
        for state, name in enumerate(("open", "closed", "locked")):
            count[name] += int(((image[..., 0] == DOOR) & (image[..., 2] == state)).any((1, 2)).sum())
    print(case, dict(count))
    return count


@pytest.mark.parametrize("case", sampled(CASES, SMALL))
def test_play(case: str) -> None:
    assert played(case, n=16, steps=40)["steps"] == 640


@pytest.mark.exhaustive
@pytest.mark.parametrize("case", CASES)
def test_much_play(case: str) -> None:
    """100,000 transitions of each, to the ends of episodes; what can happen does, where ways are short."""
    spec_of(case).check_golden(spec_of(case).functions)
    count = played(case, n=40, steps=2500)
    due = HAPPENS[CASES[case][0]] if case in SMALL else set()
    assert {what for what, often in count.items() if often > 10} >= due


def features(game: Any) -> dict[str, Any]:
    """Return what a start is made of: where things are, and all of them together."""
    grid, place, direction, _ = grid_of(game)
    cells = np.array(grid)
    kinds, colours, states = np.moveaxis(cells, 2, 0)
    where = {kind: np.flatnonzero(kinds == kind).tolist() for kind in np.unique(kinds)}
    return {
        "column": place[0],
        "row": place[1],
        "direction": direction,
        "agent": (place, direction),
        "colours": colours.tolist(),
        "states": states.tolist(),
        **{f"kind {kind}": cells for kind, cells in where.items()},
        **{f"the first of kind {kind}": cells[0] for kind, cells in where.items()},
        **{f"how many of kind {kind}": len(cells) for kind, cells in where.items()},
        "all": (grid, place, direction),
    }


def p_of_one_law(ours: list[str], theirs: list[str]) -> float:
    """Return how likely two samples of one law differ as much, by chi-squared; rare values count as one."""
    counts = [Counter(ours), Counter(theirs)]
    common = [value for value, often in (counts[0] + counts[1]).items() if often >= 12]
    table = np.array([[count[value] for value in common] for count in counts]).reshape(2, -1)
    rest = np.array([len(ours), len(theirs)]) - table.sum(1)
    table = np.column_stack([table, rest]) if rest.sum() >= 12 else table
    return float(stats.chi2_contingency(table).pvalue) if table.shape[1] > 1 else 1.0


@pytest.mark.parametrize("n", [400, pytest.param(8000, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("case", sampled(CASES, SMALL))
def test_starts_are_of_one_law(case: str, n: int) -> None:
    """By chi-squared, each part of them and all together."""
    spec = spec_of(case)
    game, words = original(spec), starts(spec, n, seed=5)
    samples: tuple[list[Any], list[Any]] = ([], [])
    for k in range(n):
        put(game, spec.layout.built([word[k].item() for word in words]), spec)
        samples[0].append(features(game))
    for seed in range(n):
        game.reset(seed=seed)
        samples[1].append(features(game))
    for name in samples[1][0]:
        ours, theirs = ([str(one.get(name)) for one in sample] for sample in samples)
        p = p_of_one_law(ours, theirs)
        print(f"{case}, {name}: {len({*ours})} and {len({*theirs})} values, p = {p:.3f}")
        assert p > LIKELY, name
        # Where there are few, each occurs, and no others do.
        if len({*ours, *theirs}) < n / 40:
            assert {*ours} == {*theirs}, name


@pytest.mark.parametrize("case", sampled(CASES, SMALL))
def test_pictures_are_minigrids(case: str) -> None:
    spec = spec_of(case)
    game = original(spec, render_mode="rgb_array")

    def drawn(state: Any) -> Any:
        put(game, state, spec)
        return game.render()

    compare_pictures(spec, "rgb_array", drawn, [LEFT, LEFT, FORWARD, LEFT], 3, device="reference")


@pytest.mark.parametrize("case", CASES)
def test_minigrid_registers_it(case: str) -> None:
    """With these arguments: they give the same start, time limit and actions."""
    spec, known = spec_of(case), gymnasium.make(f"MiniGrid-{case}-v0").unwrapped
    known.reset(seed=0)
    assert grid_of(original(spec)) == grid_of(known)
    assert spec.max_cycles == known.max_steps  # type: ignore[attr-defined]
    assert spec.action_space == known.action_space


REFUSED: dict[str, tuple[str, dict[str, Any]]] = {
    "size is 3; it must be an integer from 4 to 32": ("Empty", {"size": 3}),
    "agent_start_pos is 5; it must be": ("Empty", {"agent_start_pos": 5}),
    "agent_start_pos is 7; it must be an integer from 1 to 6": ("Empty", {"agent_start_pos": (1, 7)}),
    "agent_start_dir is 4; it must be an integer from 0 to 3": ("Empty", {"agent_start_dir": 4}),
    "max_steps is 0; it must be an integer from 1 to 65,534": ("Empty", {"max_steps": 0}),
    "size is 4; it must be an integer from 5 to 32": ("DoorKey", {"size": 4}),
    "num_rows is 4; it must be an integer from 1 to 3": ("KeyCorridor", {"num_rows": 4}),
    "room_size is 2; it must be an integer from 3 to 8": ("KeyCorridor", {"room_size": 2}),
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_is_refused(sentence: str) -> None:
    name, options = REFUSED[sentence]
    with pytest.raises(ArgumentError, match=re.escape(sentence)):
        pearl_marl.get_spec(f"MiniGrid{name}").with_options(**options)
