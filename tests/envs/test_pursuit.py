"""Pursuit against PettingZoo's ``pursuit_v5``: its starts, and the course of whole episodes."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from pettingzoo.sisl.pursuit.pursuit import parallel_env
from pettingzoo.sisl.pursuit.utils.agent_layer import AgentLayer
from pettingzoo.sisl.pursuit.utils.agent_utils import create_agents
from pettingzoo.sisl.pursuit.utils.discrete_agent import DiscreteAgent
from pettingzoo.sisl.pursuit.utils.two_d_maps import rectangle_map
from scipy import stats

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.envs.pursuit.spec import BUILDING, CELL, EVADER, PURSUER
from pearl_marl.errors import ArgumentError
from pearl_marl.porting.oracle import Games, Ours, Outcome, compare, uniform_draws

from ..sampling import sampled

Array = np.ndarray[Any, Any]
CASES: dict[str, dict[str, Any]] = {
    "default": {},
    "crowded": {"x_size": 6, "y_size": 5, "n_evaders": 3, "obs_range": 5},
    "alone": {"n_evaders": 2, "shared_reward": False, "tag_reward": 0.5, "freeze_evaders": True},
    "together": {
        "x_size": 5,
        "y_size": 5,
        "n_evaders": 3,
        "surround": False,
        "n_catch": 2,
        "urgency_reward": 0.0,
        "catch_reward": 3.0,
        "shared_reward": False,
    },
    "large": {"x_size": 16, "y_size": 16, "n_evaders": 30, "n_pursuers": 8},
    "wide": {"x_size": 12, "y_size": 7, "obs_range": 9, "n_evaders": 5, "n_pursuers": 6},
}


def spec_of(case: str) -> EnvSpec:
    return pearl_marl.get_spec("Pursuit").with_options(**CASES[case])


class Walks:
    """What evaders do: the package asks for those that are left, in their order."""

    def __init__(self) -> None:
        self.actions: list[int] = []

    def set_rng(self, rng: Any) -> None:
        """Use no chance."""

    def act(self, state: Any) -> int:
        return self.actions.pop(0)


def game_of(spec: EnvSpec) -> Any:
    given = {**spec.options, "evader_controller": Walks()}
    game = parallel_env(**given)
    game.reset(seed=0)
    return game


def base_of(game: Any) -> Any:
    return game.unwrapped.env


def pose(game: Any, state: Any) -> None:
    """Put the package's game into a state of ours."""
    game.reset()
    base = base_of(game)

    def layer(things: list[Any]) -> AgentLayer:
        agents = []
        for thing in things:
            agent = DiscreteAgent(base.x_size, base.y_size, base.map_matrix, base.np_random)
            agent.set_position(thing.x, thing.y)
            agents.append(agent)
        return AgentLayer(base.x_size, base.y_size, agents)

    base.pursuer_layer = layer(state.pursuers)
    base.evader_layer = layer([one for one in state.evaders if one.free])
    base.evaders_gone = np.array([not one.free for one in state.evaders])
    base.model_state[1] = base.pursuer_layer.get_state_matrix()
    base.model_state[2] = base.evader_layer.get_state_matrix()


def digits(draws: list[int], count: int) -> list[int]:
    """Return evaders' moves: six of a draw, each the upper half of five times what the one before left."""
    found = []
    for draw in draws:
        for _ in range(6):
            found.append(5 * draw >> 32)
            draw = 5 * draw & 0xFFFFFFFF
    return found[:count]


def look(game: Any) -> Outcome:
    aec = game.aec_env
    return Outcome([aec.observe(name) for name in game.possible_agents])


def act(game: Any, actions: list[int], draws: list[int]) -> Outcome:
    """Step the package's game; at the time limit it truncates, whatever else has happened."""
    base = base_of(game)
    left = ~base.evaders_gone
    moves = digits(draws, base.n_evaders)
    if base.freeze_evaders:
        moves = [4] * base.n_evaders
    # Who is caught is asked no more, so the walks are given once that is known.
    whose, remove = np.flatnonzero(left), base.remove_agents

    def removed() -> Any:
        result = remove()
        base.evader_controller.actions = [moves[k] for k in whose if not base.evaders_gone[k]]
        return result

    base.remove_agents = removed
    seen, paid, _, truncated, _ = game.step(dict(zip(game.possible_agents, actions, strict=True)))
    base.remove_agents = remove
    over = base.is_terminal
    state = dict[str, float]()
    for k, (x, y) in enumerate(agent.current_position() for agent in base.pursuer_layer.allies):
        state |= {f"pursuers_{k}_x": x, f"pursuers_{k}_y": y}
    places = iter(base.evader_layer.allies)
    for k, lost in enumerate(base.evaders_gone):
        x, y = (np.nan, np.nan) if lost else next(places).current_position()
        state |= {f"evaders_{k}_x": x, f"evaders_{k}_y": y, f"evaders_{k}_free": not lost}
    names = game.possible_agents
    return Outcome(
        observations=[seen[name] for name in names],
        rewards=[paid[name] for name in names],
        terminated=[over] * len(names),
        truncated=truncated[names[0]] and not over,
        state=state,
    )


def eager(ours: Ours, generator: np.random.Generator) -> Array:
    """Choose actions that often lead to the nearest evader, so that some are caught."""
    spec, n = ours.spec, ours.n
    columns = {field.name: word.astype(int) for field, word in zip(spec.state, ours.words, strict=True)}
    chosen = generator.integers(5, size=(n, spec.agents))
    for k in range(spec.agents):
        x, y = columns[f"pursuers_{k}_x"], columns[f"pursuers_{k}_y"]
        places = [
            (columns[f"evaders_{e}_x"] - x, columns[f"evaders_{e}_y"] - y, columns[f"evaders_{e}_free"])
            for e in range(spec.options["n_evaders"])
        ]
        far = np.array([abs(right) + abs(down) + 99 * (1 - free) for right, down, free in places])
        nearest = far.argmin(0)
        right, down = (np.array([place[axis] for place in places])[nearest, range(n)] for axis in (0, 1))
        along = (right != 0) & ((down == 0) | (generator.random(n) < 0.5))
        towards = np.where(along, np.where(right < 0, 0, 1), np.where(down > 0, 2, 3))
        chosen[:, k] = np.where(generator.random(n) < 0.7, towards, chosen[:, k])
    return chosen


@pytest.mark.parametrize(
    ("n", "agent_steps"), [(4, 320), pytest.param(16, 64_000, marks=pytest.mark.exhaustive)]
)
@pytest.mark.parametrize("case", sampled(CASES, ("default", "crowded", "together")))
def test_follows_the_oracle(case: str, n: int, agent_steps: int) -> None:
    """Whole episodes of eager pursuers: observations, rewards, ends and states."""
    spec = spec_of(case)
    steps = -(-agent_steps // (n * spec.agents))
    games = Games(spec, [game_of(spec) for _ in range(n)], pose, act, look)
    seen = Counter[str]()
    for move in compare(spec, games, n, steps, actions=eager, seed=3, tolerance={"reward": 1e-6}):
        free = [k for k, field in enumerate(spec.state) if field.name.endswith("free")]
        seen["steps"] += n * spec.agents
        seen["caught"] += int(sum((move.before[k] > move.after[k]).sum() for k in free))
        seen["episodes"] += int(move.ended.sum())
        seen["rewards"] = max(seen["rewards"], len(np.unique(np.round(move.outcome.rewards, 6))))
    print(case, dict(seen))
    assert seen["caught"] > 0
    assert seen["episodes"] > 0 or n == 4
    assert seen["rewards"] > 1


def test_map_is_the_packages() -> None:
    """At each width and each height: neither changes where the building is along the other."""
    for x_size, y_size in zip(range(4, 17), range(16, 3, -1), strict=True):
        spec = pearl_marl.get_spec("Pursuit").with_options(
            x_size=x_size, y_size=y_size, n_evaders=2, n_pursuers=2
        )
        state = spec.layout.built([0] * len(spec.state))
        assert spec.draw is not None
        cells = spec.draw(state).reshape(y_size, CELL, x_size, CELL, 3)
        drawn = (cells[:, 0, :, 0] == BUILDING).all(-1).T
        np.testing.assert_array_equal(drawn, rectangle_map(x_size, y_size) == -1)


@pytest.mark.parametrize("n", [1_000, pytest.param(20_000, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("case", sampled(CASES, ("crowded",)))
def test_starts_are_distributed_as_in_the_package(case: str, n: int) -> None:
    """By the cells of the first and the last of each kind, and how far these two are from each other."""
    spec, generator = spec_of(case), np.random.default_rng(5)
    x_size, y_size = spec.options["x_size"], spec.options["y_size"]
    matrix = rectangle_map(x_size, y_size)
    started = Ours(spec, n)
    started.start(uniform_draws(generator, n, spec.reset_draws))
    columns = {field.name: word.astype(int) for field, word in zip(spec.state, started.words, strict=True)}
    for kind in ("pursuers", "evaders"):
        count = spec.options[f"n_{kind}"]
        ours = np.array([[columns[f"{kind}_{k}_{axis}"] for axis in "xy"] for k in range(count)]).transpose(
            2, 0, 1
        )
        theirs = np.array(
            [
                [
                    agent.current_position()
                    for agent in create_agents(count, matrix, 7, generator, randinit=True)
                ]
                for _ in range(n)
            ]
        )
        steps = np.abs(ours[:, :, None] - ours[:, None]).sum(-1)
        apart = steps[:, ~np.eye(count, dtype=bool)]
        assert apart.min() > 1
        assert (matrix[ours[..., 0], ours[..., 1]] == 0).all()
        for part in (0, -1):
            cells = [places[:, part, 0] * y_size + places[:, part, 1] for places in (ours, theirs)]
            table = np.array([np.bincount(cell, minlength=x_size * y_size) for cell in cells])
            p = stats.chi2_contingency(table[:, table.sum(0) > 0]).pvalue
            assert p > 0.001, (kind, part)
        between = [np.abs(places[:, 0] - places[:, -1]).sum(-1) for places in (ours, theirs)]
        table = np.array([np.bincount(distance, minlength=40) for distance in between])
        table[:, 10] += table[:, 11:].sum(1)
        assert stats.chi2_contingency(table[:, :11][:, table[:, :11].sum(0) > 0]).pvalue > 0.001, kind


def test_the_spaces_are_the_packages() -> None:
    for case in CASES:
        spec = spec_of(case)
        game = game_of(spec)
        assert spec.observation_space == game.observation_space("pursuer_0")
        assert spec.action_space == game.action_space("pursuer_0")


def test_picture() -> None:
    """Evaders that are free are blue, and pursuers below them red."""
    spec = pearl_marl.get_spec("Pursuit").with_options(n_pursuers=2, n_evaders=2)
    assert spec.draw is not None
    picture = spec.draw(spec.layout.built((0, 1, 7, 2, 7, 2, 1, 3, 0, 0)))
    cells = picture.reshape(8, CELL, 8, CELL, 3).swapaxes(1, 2)

    def has(colour: tuple[int, int, int]) -> list[list[int]]:
        return np.argwhere((cells == colour).all(-1).any((2, 3))).tolist()

    assert has(PURSUER) == [[1, 0], [2, 7]]
    assert has(EVADER) == [[2, 7]]


@pytest.mark.parametrize(
    ("sentence", "options"),
    [
        ("x_size is 3; it must be an integer from 4 to 16", {"x_size": 3}),
        ("obs_range is 6; it must be odd", {"obs_range": 6}),
        ("on a map of 4 x 4 there is always a place for", {"x_size": 4, "y_size": 4, "n_evaders": 9}),
        ("n_catch is 5, and there are 4 pursuers", {"n_catch": 5, "surround": False}),
        (
            "take fewer, or shared_reward=False",
            {"x_size": 16, "y_size": 16, "n_pursuers": 16, "n_evaders": 30},
        ),
        ("surround is 1; it must be True or False", {"surround": 1}),
    ],
)
def test_what_is_refused(sentence: str, options: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError, match=sentence):
        pearl_marl.get_spec("Pursuit").with_options(**options)
