"""Environments of others with their own control flow: equal to the originals, and no larger than by hand."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from minatar.environments.breakout import Env as MinAtarBreakout

from pearl_marl.batch.config import BatchConfig
from pearl_marl.compiler.core_graph import core_graph
from pearl_marl.devices import Native
from pearl_marl.golden import call_reference
from pearl_marl.golden.tracing.nodes import in_order
from pearl_marl.spec import EnvSpec

from . import breakout, taxi


def nodes(spec: EnvSpec) -> int:
    return len(in_order([output.node for output in core_graph(spec).outputs]))


@pytest.mark.parametrize("module", [breakout, taxi], ids=["Breakout", "Taxi"])
def test_branches_make_no_larger_graphs_than_arithmetic_on_flags(module: ModuleType) -> None:
    spec, by_hand = module.spec_of(), module.spec_of(module.step_without_branches)
    assert nodes(spec) <= 1.3 * nodes(by_hand)


@pytest.mark.parametrize("step", [taxi.step, taxi.step_without_branches], ids=["branches", "flags"])
def test_every_transition_of_taxi(step: Any) -> None:
    gym = gymnasium.make("Taxi-v4").unwrapped
    cases = [(*gym.decode(state), action) for state in range(500) for action in range(6)]
    due = [
        (*gym.decode(after), reward, terminated)
        for moves in gym.P.values()
        for ((_, after, reward, terminated),) in moves.values()
    ]
    spec = taxi.spec_of(step)
    found = call_reference(spec.positional.step, np.array(cases).T)
    assert np.stack(found, 1).tolist() == [[int(x) for x in row] for row in due]


def pose(game: MinAtarBreakout, state: list[int]) -> None:
    """Put MinAtar's game into a state of ours."""
    game.ball_y, game.ball_x, game.ball_dir, game.pos, *bricks, strike, game.last_x, game.last_y = state
    game.brick_map[:] = np.array(bricks).reshape(10, 10)
    game.strike, game.terminal = bool(strike), False


def test_a_hundred_thousand_steps_of_breakout() -> None:
    n, steps = 100, 1000
    env = Native().open(BatchConfig(spec=breakout.spec_of(), n_envs=n))
    env.reset(seed=4)
    games, generator = [MinAtarBreakout() for _ in range(n)], np.random.default_rng(0)
    for game, state in zip(games, env.state().tolist(), strict=True):
        pose(game, state)
    bricks = 0
    for _ in range(steps):
        # Most follow the ball, so that they come to the bricks behind the first row.
        sides = np.sign([game.ball_x - game.pos for game in games])
        towards = np.choose(sides + 1, [breakout.LEFT, 0, breakout.RIGHT])
        actions = np.where(generator.random(n) < 0.9, towards, generator.integers(6, size=n))
        result = env.step(actions)
        outcomes = [game.act(int(action)) for game, action in zip(games, actions, strict=True)]
        assert result.rewards.tolist() == [reward for reward, _ in outcomes]
        assert result.terminations.tolist() == [ended for _, ended in outcomes]
        np.testing.assert_array_equal(result.arrivals(), [game.state() for game in games])
        bricks += int(result.rewards.sum())
        if result.terminations.any():
            states = env.state().tolist()
            for k in np.flatnonzero(result.terminations):
                pose(games[k], states[k])
    assert bricks > 5_000
