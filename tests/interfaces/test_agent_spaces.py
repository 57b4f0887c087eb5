"""Spaces by agent, as skrl and others take them, and the mode that TorchRL's GymWrapper asks for."""

from __future__ import annotations

import pickle
import tracemalloc
from typing import Any

import gymnasium
import pytest
from gymnasium.spaces import Dict, Discrete
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl import wrappers

# A dict is made of few, and of many none; ConnectFour has masks, and Meadow roles of other spaces.
CASES = [("CliffWalking", 5), ("CliffWalking", 40), ("ConnectFour", 4), ("ConnectFour", 40), ("Meadow", 40)]


@pytest.mark.usefixtures("toys")
@pytest.mark.parametrize("wrap", [lambda env: env, wrappers.clip_reward_v0])
@pytest.mark.parametrize(("name", "n"), CASES)
def test_spaces_by_agent(name: str, n: int, wrap: Any) -> None:
    env = wrap(pearl_marl.parallel_env(name, n))
    for spaces, one in (
        (env.observation_spaces, env.observation_space),
        (env.action_spaces, env.action_space),
    ):
        assert spaces == {agent: one(agent) for agent in env.possible_agents}
        assert {agent: one(agent) for agent in env.possible_agents} == spaces
        assert list(spaces) == list(spaces.keys()) == env.possible_agents
        assert len(spaces) == n
        assert all(spaces[agent] is one(agent) for agent in env.possible_agents)
        assert all(space is one(agent) for agent, space in spaces.items())
        assert f"agent_{n - 1}" in spaces
        assert f"agent_{n}" not in spaces
        assert spaces.get("agent_x") is None
        with pytest.raises(KeyError):
            spaces["agent_x"]
        assert pickle.loads(pickle.dumps(spaces)) == spaces
        assert Dict(dict(spaces)) == Dict({agent: one(agent) for agent in env.possible_agents})
    assert env.action_spaces is env.action_spaces
    assert (type(env.action_spaces) is dict) == (n <= 16)


def test_those_of_ten_million_agents_take_no_memory() -> None:
    """No entry is made to look one up."""
    from pearl_marl.interfaces.agent_dict import AgentSpaces, Names

    tracemalloc.start()
    spaces = AgentSpaces.of(Names(10_000_000), [Discrete(2), Discrete(3)])
    assert (len(spaces), spaces["agent_9999999"].n, spaces["agent_0"].n) == (10_000_000, 3, 2)  # type: ignore[attr-defined]
    assert "Discrete(3)" in repr(spaces)
    assert tracemalloc.get_traced_memory()[1] < 100_000
    tracemalloc.stop()


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("wrap", [lambda env: env, wrappers.clip_reward_v0])
def test_the_autoreset_mode_stands_where_gymnasium_has_it(wrap: Any, mode: AutoresetMode) -> None:
    env = wrap(pearl_marl.make_vec("CartPole", 2, autoreset_mode=mode))
    theirs = gymnasium.make_vec("CartPole-v1", 2, "sync", vector_kwargs={"autoreset_mode": mode})
    for one in (env, theirs):
        assert one.autoreset_mode is one.metadata["autoreset_mode"] is mode
    with pytest.raises(AttributeError):
        env.autoreset_mode = AutoresetMode.NEXT_STEP
