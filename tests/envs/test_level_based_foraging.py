"""LevelBasedForaging against the package ``lbforaging``: its starts, and what comes of the same actions."""

from __future__ import annotations

import itertools
from collections import Counter
from functools import partial
from typing import Any

import numpy as np
import pytest
from lbforaging.foraging import ForagingEnv
from scipy import stats

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.envs.free_cells import CellWords, count_of
from pearl_marl.envs.level_based_foraging.picture import CELL, FOOD, PLAYER
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference
from pearl_marl.porting.oracle import Games, Ours, Outcome, compare

from ..sampling import sampled
from .starts import started

Array = np.ndarray[Any, Any]
STANDARD = {
    "players": 2,
    "min_player_level": 1,
    "max_player_level": 2,
    "min_food_level": 1,
    "max_food_level": None,
    "field_size": (8, 8),
    "max_num_food": 3,
    "sight": 8,
    "max_episode_steps": 50,
    "force_coop": False,
    "normalize_reward": True,
    "observe_agent_levels": True,
    "penalty": 0.0,
}


def options(size: int, players: int, foods: int, **other: Any) -> dict[str, Any]:
    shape = {"field_size": (size, size), "players": players, "max_num_food": foods, "sight": size}
    return STANDARD | shape | other


CASES = {
    "8x8-2p-3f": options(8, 2, 3),
    "8x8-2p-2f-coop-2s": options(8, 2, 2, sight=2, force_coop=True),
    "10x10-3p-3f-pen": options(10, 3, 3, penalty=0.1),
    "5x5-4p-3f-1s": options(5, 4, 3, sight=1, max_player_level=4, penalty=0.35),
    "15x15-4p-4f-coop-5s": options(15, 4, 4, sight=5, force_coop=True, max_episode_steps=80),
    "6x6-5p-2f-unnormalized": options(
        6, 5, 2, normalize_reward=False, min_player_level=2, max_player_level=5
    ),
    "4x4-3p-1f-unseen-levels": options(
        4, 3, 1, observe_agent_levels=False, min_food_level=2, max_food_level=6
    ),
    "7x7-9p-4f-3s": options(7, 9, 4, sight=3, max_food_level=9, penalty=1 / 3, max_episode_steps=30),
    "9x9-1p-4f-7s": options(9, 1, 4, sight=7, max_player_level=3),
    "8x8-3p-3f-lists": options(
        8, 3, 3, min_player_level=[1, 1, 2], max_player_level=[1, 2, 3], max_food_level=[1, 4, 7]
    ),
}


def spec_of(given: dict[str, Any]) -> EnvSpec:
    return pearl_marl.get_spec("LevelBasedForaging").with_options(**given)


AHEAD = (0, 0), (-1, 0), (1, 0), (0, -1), (0, 1), (0, 0)
"""Where an action leads."""


def things(spec: EnvSpec, state: list[Array]) -> tuple[Array, Array]:
    """Return row, column and level of the players and of the foods, of shape ``(n, players or foods, 3)``."""
    count = 3 * (spec.agents + spec.options["max_num_food"])
    every = np.stack(state[:count], 1).reshape(len(state[0]), -1, 3)
    return every[:, : spec.agents], every[:, spec.agents :]


def put(oracle: ForagingEnv, state: Any) -> None:
    """Start the package's game where ours starts."""
    oracle.field = np.zeros(oracle.field_size, np.int32)
    for player, (row, column, level) in zip(oracle.players, state.players, strict=True):
        player.setup((row, column), level, oracle.field_size)
        player.reward = 0
    for row, column, level in state.foods:
        if level:
            oracle.field[row, column] = level
    oracle._food_spawned = oracle.field.sum()
    oracle.current_step, oracle._game_over = 0, False
    oracle._gen_valid_moves()


def look(oracle: ForagingEnv) -> Outcome:
    """Return observations and masks of the package's game."""
    every = [{action.value for action in oracle._valid_actions[player]} for player in oracle.players]
    masks = [[action in valid for action in range(6)] for valid in every]
    return Outcome(oracle._make_gym_obs(), masks=masks)


def act(oracle: ForagingEnv, actions: list[int], draws: list[int]) -> Outcome:
    """Step the package's game; it is over when all food is eaten, and when its time is."""
    observations, paid, done, _, _ = oracle.step(actions)
    eaten = oracle.field.sum() == 0
    ends = [eaten] * len(oracle.players)
    return look(oracle)._replace(
        observations=observations, rewards=paid, terminated=ends, truncated=done and not eaten
    )


def hungry(ours: Ours, generator: np.random.Generator) -> Array:
    """Choose actions of any kind, also such that are not possible; but often those that lead to a load."""
    players, foods = things(ours.spec, ours.words)
    food = foods[np.arange(len(foods)), (foods[:, :, 2] > 0).argmax(1)][:, None].astype(int)
    down, right = np.moveaxis(food[..., :2] - players[..., :2], 2, 0)
    chance = generator.random((3, *down.shape))
    along = (down != 0) & ((right == 0) | (chance[0] < 0.5))
    nearer = np.where(along, np.where(down < 0, 1, 2), np.where(right < 0, 3, 4))
    nearer = np.where((ours.masks()[:, :, 5] == 1) & (chance[1] < 0.9), 5, nearer)
    return np.where(chance[2] < 0.3, generator.integers(6, size=down.shape), nearer)


def played(given: dict[str, Any], n: int, steps: int, seed: int) -> Counter[str]:
    """Play games side by side, and count in how many steps there is what."""
    spec, seen = spec_of(given), Counter[str]()
    games = Games(spec, [ForagingEnv(**given) for _ in range(n)], put, act, look)
    penalty = -given["penalty"]
    for move in compare(spec, games, n, steps, actions=hungry, seed=seed):
        was, now = (things(spec, state)[0].astype(int) for state in (move.before, move.after))
        paid = move.outcome.rewards
        walked = (move.actions > 0) & (move.actions < 5)
        wanted = was[..., :2] + np.array(AHEAD)[np.where(walked, move.actions, 0)]
        contested = [
            (wanted[:, a] == wanted[:, b]).all(1) & (walked[:, a] | walked[:, b])
            for a, b in itertools.combinations(range(spec.agents), 2)
        ]
        stood = (now[..., :2] == was[..., :2]).all(2).any(1)
        seen["steps"] += n
        seen["loads"] += int((paid > 0).sum())
        seen["failures"] += int(((move.actions == 5) & (paid == penalty) & (paid <= 0)).sum())
        seen["finished"] += int(move.outcome.terminated[:, 0].sum())
        seen["collisions"] += int((np.any(contested, 0) & stood).sum()) if contested else 0
        places = now[..., 0] * given["field_size"][0] + now[..., 1]
        seen["shared cells"] += int((np.diff(np.sort(places)) == 0).sum())
    return seen


@pytest.mark.parametrize(
    "episodes", [15, pytest.param(400, marks=pytest.mark.exhaustive)], ids=["few", "many"]
)
@pytest.mark.parametrize("name", CASES)
def test_episodes(name: str, episodes: int) -> None:
    """Whole episodes, and those that begin again: observations, masks, rewards and ends."""
    given = CASES[name]
    seen = played(given, episodes, given["max_episode_steps"], seed=episodes)
    print(name, dict(seen))
    alone = given["players"] == 1
    assert min(seen["loads"], 3 * seen["finished"]) >= 5
    assert alone or min(seen["failures"], seen["collisions"]) >= 5


def package_starts(given: dict[str, Any], n: int, seed: int) -> tuple[Array, Array]:
    """Return the players and the foods of the package's starts, as :func:`things` does ours."""
    oracle = ForagingEnv(**given)
    oracle.seed(seed)
    starts = []
    for _ in range(n):
        for player in oracle.players:
            player.position = None  # as in a new game: it keeps players from where they were in the last
        oracle.reset()
        players = [(*player.position, player.level) for player in oracle.players]
        foods = [(*cell, oracle.field[*cell]) for cell in np.argwhere(oracle.field)]
        starts.append(players + foods + [(0, 0, 0)] * (given["max_num_food"] - len(foods)))
    every = np.array(starts)
    return every[:, : given["players"]], every[:, given["players"] :]


def cells(size: int, every: Array) -> Array:
    """Return the numbers of the cells that players or foods are in, -1 where there is no food."""
    return np.where(every[..., 2] > 0, every[..., 0] * size + every[..., 1], -1)


def p_same(ours: Array, theirs: Array) -> float:
    """Return how likely two samples of one distribution differ as much; rare outcomes count as one."""
    outcomes, which = np.unique(np.concatenate([ours, theirs]), axis=0, return_inverse=True)
    is_ours = np.arange(len(which)) < len(ours)
    table = np.array(
        [np.bincount(which.ravel()[part], minlength=len(outcomes)) for part in (is_ours, ~is_ours)]
    )
    rare = table.sum(0) * len(theirs) / len(which) < 10
    table = np.concatenate([table[:, ~rare], table[:, rare].sum(1, keepdims=True)], 1)
    return float(stats.chi2_contingency(table[:, table.sum(0) > 0]).pvalue)


SPAWNS = {
    "5x5-2p-2f": options(5, 2, 2),
    "8x8-2p-3f": options(8, 2, 3),
    "6x6-4p-2f-coop": options(6, 4, 2, force_coop=True, min_player_level=2, max_player_level=4),
    "7x7-3p-4f-lists": options(
        7,
        3,
        4,
        min_player_level=[1, 2, 2],
        max_player_level=[1, 2, 3],
        min_food_level=[1, 1, 2, 3],
        max_food_level=[1, 1, 3, 4],
    ),
}


@pytest.mark.parametrize("n", [1_500, pytest.param(6_000, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("name", sampled(SPAWNS, ("6x6-4p-2f-coop",)))
def test_starts_are_distributed_as_in_the_package(name: str, n: int) -> None:
    given = SPAWNS[name]
    spec = spec_of(given)
    ours, theirs = things(spec, started(spec, 20 * n, seed=n)), package_starts(given, n, seed=n)
    size: int = given["field_size"][0]
    features: dict[str, dict[str, Array]] = {}
    for who, (players, foods) in {"ours": ours, "theirs": theirs}.items():
        # What found no room may stand anywhere in our list; nobody sees it.
        there = np.argsort(foods[..., 2] == 0, axis=1, kind="stable")[..., None]
        foods = np.take_along_axis(foods, there, 1) * (np.take_along_axis(foods, there, 1)[..., 2:] > 0)
        walkers, food = cells(size, players), cells(size, foods)
        levels = players[..., 2]
        near = np.abs(players[:, :, None, :2] - foods[:, None, :, :2]).sum(-1)
        features[who] = {
            "a player's cell": walkers[:, -1],
            "how players stand to each other": np.diff(players[:, :2, :2], axis=1).reshape(-1, 2),
            "levels": np.concatenate([levels, foods[..., 2]], 1),
            "how foods stand to each other": np.diff(foods[:, :2], axis=1).reshape(-1, 3),
            "the first food's cell": food[:, 0],
            "how far food is": near.min(2),
        }
    p_values = {name: p_same(features["ours"][name], features["theirs"][name]) for name in features["ours"]}
    print(name, {name: round(p, 3) for name, p in p_values.items()})
    assert min(p_values.values()) > 0.001


def law(size: int, foods: int) -> dict[tuple[int, ...], float]:
    """Return, for two players, the probability of every start: the players' cells, then the foods' in order.

    As the package says it: a cell is drawn again until it is free, and there is no food near.
    """
    inner = [(row, column) for row in range(1, size - 1) for column in range(1, size - 1)]
    result: dict[tuple[int, ...], float] = Counter()

    def near(a: tuple[int, int], b: tuple[int, int]) -> bool:
        down, right = abs(a[0] - b[0]), abs(a[1] - b[1])
        return max(down, right) <= 1 or (down == 0 and right <= 2) or (right == 0 and down <= 2)

    def spawn(players: Any, placed: list[tuple[int, int]], p: float) -> None:
        free = [c for c in inner if c not in players and not any(near(c, other) for other in placed)]
        if len(placed) == foods or not free:
            numbers = sorted(row * size + column for row, column in placed)
            result[*(row * size + column for row, column in players), *numbers] += p
        for cell in free if len(placed) < foods else []:
            spawn(players, [*placed, cell], p / len(free))

    every = list(itertools.product(range(size), repeat=2))
    pairs = list(itertools.permutations(every, 2))
    for players in pairs:
        spawn(players, [], 1 / len(pairs))
    return result


def test_every_start_of_a_small_grid() -> None:
    """The probability of each of them, over many draws."""
    spec, n = spec_of(options(5, 2, 2)), 200_000
    expected = law(5, 2)
    assert sum(expected.values()) == pytest.approx(1)
    players, foods = things(spec, started(spec, n, seed=1))
    food = cells(5, foods)
    assert ((food[:, 0] < food[:, 1]) | (food < 0).any(1)).all()
    food = np.where(food[:, :1] < 0, food[:, ::-1], food)
    codes = np.concatenate([cells(5, players), food], 1) + 1
    known = [tuple(start) + (-1,) * (4 - len(start)) for start in expected]
    places = np.ravel_multi_index((np.array(known) + 1).T, (26,) * 4)
    seen = np.bincount(np.ravel_multi_index(codes.T, (26,) * 4), minlength=26**4)
    assert seen[places].sum() == n
    p = stats.chisquare(seen[places], n * np.array(list(expected.values()))).pvalue
    print(f"{len(expected)} starts: p = {p:.3f}")
    assert p > 0.001


def test_every_free_cell_is_as_likely() -> None:
    """Each number below the count of free cells is another one of them."""
    generator = np.random.default_rng(0)
    for size in (5, 8, 10, 17, 18, 32):
        grid, n = CellWords(size), 10
        # Grids of food that came by itself, and how many cells each has left.
        free = [np.full(n, word, np.uint64) for word in grid.all_free()]
        left = [{(r, c) for r in range(1, size - 1) for c in range(1, size - 1)} for _ in range(n)]
        for visit in (grid.without, partial(grid.far_from, reach=2)):
            low, high = (0, size) if visit == grid.without else (1, size - 1)
            rows, columns = generator.integers(low, high, (2, n))
            free = call_reference(lambda *w, act=visit: act(w[:-2], *w[-2:]), [*free, rows, columns])
            reach = 0 if visit == grid.without else 2
            for cells, row, column in zip(left, rows, columns, strict=True):
                cells -= {(r, c) for r, c in cells if abs(r - row) + abs(c - column) <= reach}
        counts = call_reference(lambda *words: [count_of(word) for word in words], free)
        assert [sum(map(int, of)) for of in zip(*counts, strict=True)] == list(map(len, left))
        ranks = np.arange(max(map(len, left)))[:, None]
        words = [np.broadcast_to(word, (len(ranks), n)) for word in (*free, *counts, ranks)]

        def chosen(*words: Any, grid: CellWords = grid, k: int = len(free)) -> Any:
            return grid.chosen(words[:k], words[k : 2 * k], words[-1])

        rows, columns = call_reference(chosen, words)
        for i, cells in enumerate(left):
            found = zip(rows[: len(cells), i], columns[: len(cells), i], strict=True)
            assert list(found) == sorted(cells)


def test_pictures() -> None:
    """Each thing is where the state has it, in its colour, and what has been eaten is nowhere."""
    pytest.importorskip("PIL")
    spec = spec_of({"players": 3, "max_food_level": 3})
    assert spec.draw is not None
    # The second and the third player are in one cell, and the last food is gone.
    players, foods = [(0, 7, 1), (5, 2, 2), (5, 2, 1)], [(2, 3, 3), (4, 4, 1), (6, 6, 0)]
    drawn = spec.draw(spec.layout.built((*itertools.chain(*players, *foods), 4)))
    assert (drawn.shape, drawn.dtype) == ((8 * CELL + 1, 8 * CELL + 1, 3), np.uint8)

    def colours(row: int, column: int) -> set[tuple[int, ...]]:
        cell = drawn[row * CELL + 1 : (row + 1) * CELL, column * CELL + 1 : (column + 1) * CELL]
        return {tuple(pixel.tolist()) for pixel in cell.reshape(-1, 3)}

    for row, column in itertools.product(range(8), repeat=2):
        held = colours(row, column)
        assert (PLAYER in held) == ((row, column) in {(0, 7), (5, 2)})
        assert (FOOD in held) == ((row, column) in {(2, 3), (4, 4)})
    stronger = [(0, 7, 3), *players[1:]]
    assert not np.array_equal(drawn, spec.draw(spec.layout.built((*itertools.chain(*stronger, *foods), 4))))


@pytest.mark.parametrize("name", CASES)
def test_spec(name: str) -> None:
    """The space is the package's, and every word fits its field."""
    spec_of(CASES[name]).check_golden(spec_of(CASES[name]).functions)
    assert spec_of(CASES[name]).observation_space == ForagingEnv(**CASES[name]).observation_space[0]


REFUSED = {
    "grid_observation is True; only False is possible": {"grid_observation": True},
    "field_size is \\(5, 8\\); it must be two equal numbers": {"field_size": (5, 8)},
    "field_size is 2; it must be an integer from 3": {"field_size": (2, 2)},
    "players is 0; it must be an integer from 1": {"players": 0},
    "players is 10; a grid of 3 x 3 has cells for 9": {
        "players": 10,
        "field_size": (3, 3),
        "max_num_food": 1,
    },
    "max_player_level is \\[1\\]; it must be one integer or a list of 2": {"max_player_level": [1]},
    "min_player_level 3 is greater than max_player_level 2, of player 0": {"min_player_level": 3},
    "min_food_level is 3; max_food_level=None, .* may be 2": {"min_food_level": 3},
    "these levels make .* lower max_player_level": {"max_player_level": 30},
    "penalty is nan; it must be a finite number": {"penalty": float("nan")},
    "force_coop is 1; it must be True or False": {"force_coop": 1},
    "sight is 0; it must be an integer from 1": {"sight": 0},
    "max_episode_steps is None": {"max_episode_steps": None},
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_is_refused(sentence: str) -> None:
    with pytest.raises(ArgumentError, match=sentence) as caught:
        pearl_marl.get_spec("LevelBasedForaging").with_options(**REFUSED[sentence])
    assert "\n" not in str(caught.value)
