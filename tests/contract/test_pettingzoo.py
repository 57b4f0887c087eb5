"""PettingZoo's own tests, its registry, and a seed test that runs whole episodes."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pettingzoo
import pytest
from gymnasium.spaces import Tuple
from pettingzoo.test import api_test, parallel_api_test

import pearl_marl
from pearl_marl.errors import ArgumentError

from ..helpers import Case


def test_parallel_api(case: Case) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(case.parallel(5, autoreset=False), num_cycles=60)


def test_aec_api(case: Case) -> None:
    if isinstance(case.spec.observation_space, Tuple):
        pytest.skip("PettingZoo's test asks a tuple for its dtype")
    env = pearl_marl.env(case.env_id, n_agents=3, device=case.device(), max_cycles=15)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # A flat Box is no image; PettingZoo says so where the bounds are its business.
        warnings.filterwarnings("ignore", message=".*[Oo]bservation")
        api_test(env, num_cycles=60)
    env.close()


def test_raw_aec(case: Case) -> None:
    env = pearl_marl.raw_env(case.env_id, n_agents=3, device=case.device(), max_cycles=4)
    env.reset(seed=0)
    turns: dict[str, int] = {}
    for agent in env.agent_iter():
        _, _, terminated, truncated, _ = env.last()
        turns[agent] = turns.get(agent, 0) + 1
        if truncated:
            assert turns[agent] == 5, "four actions and the last look"
        env.step(None if terminated or truncated else env.action_space(agent).sample())
    assert turns.keys() == {"agent_0", "agent_1", "agent_2"}


def test_aec_refuses_autoreset(case: Case) -> None:
    with pytest.raises(ArgumentError, match="no autoreset"):
        pearl_marl.env(case.env_id, n_agents=2, autoreset=True)


def whole_episodes(env: Any, seed: int, episodes: int) -> list[Any]:
    """Play and write down everything; 1.27's own ``parallel_seed_test`` looks at one step only."""
    seen: list[Any] = [dict(part) for part in env.reset(seed=seed)]
    for agent in env.possible_agents:
        env.action_space(agent).seed(seed)
    for _ in range(episodes):
        while env.agents:
            actions = {agent: env.action_space(agent).sample() for agent in env.agents}
            seen += [actions, *(dict(part) for part in env.step(actions))]
        seen += [dict(part) for part in env.reset()]
    return seen


def test_whole_episodes_repeat_with_a_seed(case: Case) -> None:
    first = whole_episodes(case.parallel(6, autoreset=False, max_cycles=20), 42, 3)
    second = whole_episodes(case.parallel(6, autoreset=False, max_cycles=20), 42, 3)
    assert len(first) > 3 * 5
    np.testing.assert_equal(first, second)
    third = whole_episodes(case.parallel(6, autoreset=False, max_cycles=20), 43, 3)
    with pytest.raises(AssertionError):
        np.testing.assert_equal(first, third)


def test_registry(case: Case) -> None:
    name = f"pearl/{case.spec.id}"
    parallel = pettingzoo.make("parallel", name, n_agents=4, device=case.device(), max_cycles=3)
    ours = case.parallel(4, max_cycles=3)
    parallel.reset(seed=0)
    ours.reset(seed=0)
    for actions in case.actions(5, 4):
        given = dict(zip(ours.agents, actions, strict=True))
        np.testing.assert_equal(
            [dict(part) for part in parallel.step(given)], [dict(part) for part in ours.step(given)]
        )
    assert parallel.unwrapped.step_batch(actions).obs.shape[0] == 4
    parallel.close()

    aec = pettingzoo.make("aec", name, n_agents=2, device=case.device(), max_cycles=2)
    aec.reset(seed=0)
    turns = 0
    for agent in aec.agent_iter():
        _, _, terminated, truncated, _ = aec.last()
        aec.step(None if terminated or truncated else aec.action_space(agent).sample())
        turns += 1
    assert 4 <= turns <= 6, "two agents, one or two actions each, and a last look"
    aec.close()
