"""The AEC form under PettingZoo's own wrappers and tests, which nobody has changed for it."""

from __future__ import annotations

import types
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pettingzoo.test
import pytest
from pettingzoo.classic import connect_four_v3
from pettingzoo.test.max_cycles_test import max_cycles_test
from pettingzoo.utils import wrappers as theirs
from pettingzoo.utils.conversions import aec_to_parallel

import pearl_marl
from pearl_marl.errors import ActionError, DeviceError, OrderError

from ..sampling import KINDS, sampled

pytestmark = pytest.mark.filterwarnings("ignore")
NAMES = sampled(pearl_marl.list_envs(), KINDS)


def chosen(env: Any, t: int, illegal: bool = False) -> Any:
    """The selected agent's action; ``None`` where its episode has ended."""
    observation, _, termination, truncation, _ = env.last()
    if termination or truncation:
        return None
    space = env.action_space(env.agent_selection)
    space.seed(t)
    masked = isinstance(observation, dict) and not illegal
    return space.sample(observation["action_mask"] if masked else None)


def played(env: Any, seed: int, turns: int = 60, illegal: bool = False) -> list[Any]:
    """What every agent saw and got until all have left, or for so many turns."""
    env.reset(seed=seed)
    seen = []
    for t, agent in enumerate(env.agent_iter(turns)):
        observation, *others, _ = env.last()
        here = [other.rpartition("_")[2] for other in env.agents]
        rewards = {other.rpartition("_")[2]: reward for other, reward in env.rewards.items()}
        if isinstance(observation, dict):  # after the end, what may be done is nobody's business
            observation = [observation["observation"], 0 if any(others[1:]) else observation["action_mask"]]
        parts = observation if isinstance(observation, (list, tuple)) else [observation]
        shown = [np.asarray(part).tolist() for part in parts]
        seen.append((agent.rpartition("_")[2], shown, others, here, rewards))
        env.step(chosen(env, 100 * seed + t, illegal))
    return seen


WRAPPERS: dict[str, Callable[[Any], Any]] = {
    "base": theirs.BaseWrapper,
    "order enforcing": theirs.OrderEnforcingWrapper,
    "assert out of bounds": theirs.AssertOutOfBoundsWrapper,
    "all of them": lambda env: theirs.OrderEnforcingWrapper(theirs.AssertOutOfBoundsWrapper(env)),
}


@pytest.mark.parametrize("wrap", WRAPPERS.values(), ids=WRAPPERS)
@pytest.mark.parametrize("name", NAMES)
def test_wrappers_that_only_look(name: str, wrap: Any) -> None:
    env = wrap(pearl_marl.raw_env(name))
    assert played(env, 3, 20) == played(pearl_marl.raw_env(name), 3, 20)
    assert type(env.unwrapped) is type(pearl_marl.raw_env(name))
    assert env.unwrapped.env.spec.name == name


@pytest.mark.parametrize("name", NAMES)
def test_what_a_seed_makes(name: str) -> None:
    """The wrappers' random numbers too, which SuperSuit draws from ``unwrapped.np_random``."""
    env = pearl_marl.env(name)
    env.reset(seed=7)
    drawn = env.unwrapped.np_random.integers(1 << 30)
    env.reset(seed=7)
    assert env.unwrapped.np_random.integers(1 << 30) == drawn == np.random.default_rng(7).integers(1 << 30)
    env.unwrapped.np_random = np.random.default_rng(1)
    assert env.np_random.integers(1 << 30) == np.random.default_rng(1).integers(1 << 30)


@pytest.mark.parametrize("illegal", [False, True])
def test_illegal_moves_end_games_as_pettingzoos_own(illegal: bool) -> None:
    """Turn by turn, over several games: who is asked, what he sees and gets, and who leaves when."""
    ours = theirs.TerminateIllegalWrapper(pearl_marl.raw_env("ConnectFour"), -1)
    other = theirs.TerminateIllegalWrapper(connect_four_v3.raw_env(), -1)
    ends = set()
    for seed in range(20):
        game = played(ours, seed, illegal=illegal)
        assert game == played(other, seed, illegal=illegal)
        assert ours.agents == []
        ends.update(tuple(turn[2][1:]) for turn in game)
    assert ((True, True) in ends) == illegal  # the wrapper's own
    assert (True, False) in ends


@pytest.mark.parametrize(("name", "n"), [("ConnectFour", 6), ("LevelBasedForaging", 4)])
def test_an_illegal_move_ends_all_worlds(name: str, n: int) -> None:
    """The wrapper knows of one game."""
    env = theirs.OrderEnforcingWrapper(theirs.TerminateIllegalWrapper(pearl_marl.raw_env(name, n), -5))
    for _ in range(2):
        env.reset(seed=0)
        while not any(env.terminations.values()):
            observation, *_ = env.last()
            masked = np.flatnonzero(observation["action_mask"] == 0)
            offender = env.agent_selection
            env.step(int(masked[0]) if masked.size else 3)
        assert env.rewards == {agent: -5 * (agent == offender) for agent in env.possible_agents}
        left = []
        for agent in env.agent_iter(n):
            left.append((agent, env.last()[1:4]))
            env.step(None)
        assert sorted(left) == sorted((a, (-5 * (a == offender), True, True)) for a in env.possible_agents)
        assert env.agents == []


def test_who_is_ended_by_somebody_else_leaves_before_anybody_acts() -> None:
    """And the game goes on without him."""
    env = pearl_marl.raw_env("ConnectFour", 4)
    env.reset(seed=0)
    env.step(3)
    assert env.agent_selection == "agent_2"
    env.truncations["agent_0"] = True
    env._deads_step_first()
    assert env.agent_selection == "agent_0"
    with pytest.raises(ActionError, match="its episode has ended"):
        env.step(3)
    env.step(None)
    assert env.agents == ["agent_1", "agent_2", "agent_3"]
    turns = [env.agent_selection]
    for column in (3, 2, 2, 1, 1, 0, 0):
        env.step(column)
        turns.append(env.agent_selection)
    assert turns[:4] == ["agent_2", "agent_1", "agent_3", "agent_2"]
    assert "agent_0" not in turns


@pytest.mark.parametrize("names", [("agent_0",), ("agent_1",), ("agent_0", "agent_1")])
def test_a_game_without_those_that_were_ended(names: tuple[str, ...]) -> None:
    """The agents that are left are on turn in all of it, until their own end."""
    env = pearl_marl.raw_env("ConnectFour")
    env.reset(seed=0)
    for name in names:
        env.terminations[name] = True
    for _ in names:
        env._deads_step_first()
        env.step(None)
    assert set(env.agents) == {"agent_0", "agent_1"} - set(names)
    for t in range(30):
        if not env.agents:
            break
        env.step(chosen(env, t))
    assert not env.agents


def test_clipping() -> None:
    env = theirs.ClipOutOfBoundsWrapper(pearl_marl.raw_env("Pendulum", 2))
    other = pearl_marl.raw_env("Pendulum", 2)
    for one, action in ((env, 7), (other, 2)):
        one.reset(seed=1)
        for _ in range(4):
            one.step(np.array([action], np.float32))
    assert env.last()[1] == other.last()[1]
    np.testing.assert_array_equal(env.observe("agent_1"), other.observe("agent_1"))


def test_captured_text() -> None:
    """There is none, but the wrapper adds to ``render_modes``, which are this environment's own."""
    env = theirs.CaptureStdoutWrapper(pearl_marl.raw_env("CliffWalking", render_mode="human"))
    env.reset(seed=0)
    assert env.render() == ""
    assert env.render_mode == "ansi"
    assert "ansi" in env.metadata["render_modes"]
    assert pearl_marl.raw_env("Taxi").metadata["render_modes"] == ["human", "rgb_array", "ansi"]
    env.close()


def test_several_episodes() -> None:
    env = theirs.MultiEpisodeEnv(pearl_marl.raw_env("CartPole", 2, max_cycles=3), num_episodes=3)
    env.reset(seed=4)
    turns = 0
    for _ in env.agent_iter():
        turns += 1
        env.step(None if env.last()[3] else 0)
    assert turns == 3 * 2 * 4


@pytest.mark.parametrize("name", NAMES)
class TestPettingZoosOwn:
    def test_seeds(self, name: str) -> None:
        pettingzoo.test.seed_test(partial(pearl_marl.env, name, max_cycles=10), num_cycles=10)

    def test_parallel_seeds(self, name: str) -> None:
        make = partial(pearl_marl.parallel_env, name, max_cycles=10)
        if make().batch.world.masked == "refused":
            pytest.skip("the test draws any action, and this environment refuses masked ones")
        pettingzoo.test.parallel_seed_test(make, num_cycles=10)
        pettingzoo.test.parallel_seed_test(partial(make, autoreset=False), num_cycles=10)

    def test_states(self, name: str) -> None:
        pettingzoo.test.state_test(
            pearl_marl.env(name), pearl_marl.parallel_env(name, autoreset=False), num_cycles=5
        )

    def test_there_and_back(self, name: str) -> None:
        """The parallel form by way of the AEC form is the parallel form."""
        if pearl_marl.get_spec(name).turns:
            pytest.skip("PettingZoo has no way back from turns")
        back = aec_to_parallel(pearl_marl.env(name, max_cycles=5))
        ours = pearl_marl.parallel_env(name, max_cycles=5, autoreset=False)
        for one in (back, ours):
            one.reset(seed=2)
        while ours.agents:
            actions = {agent: ours.action_space(agent).sample() for agent in ours.agents}
            assert back.agents == ours.agents
            for mine, other in zip(back.step(actions), ours.step(actions), strict=True):
                assert mine.keys() == other.keys()
                for agent in other:
                    np.testing.assert_equal(mine[agent], other[agent])
        assert back.agents == []


@pytest.mark.parametrize("name", ["CliffWalking", "CartPole", "MountainCar", "Pendulum", "Overcooked"])
def test_pettingzoos_count_of_cycles(name: str) -> None:
    """Nothing else ends an episode of these in four steps."""
    forms = {"parallel_env": partial(pearl_marl.parallel_env, name, autoreset=False)}
    max_cycles_test(types.SimpleNamespace(**forms, env=partial(pearl_marl.env, name), __name__="a module"))


def test_before_the_first_reset() -> None:
    env = pearl_marl.raw_env("Taxi")
    with pytest.raises(OrderError, match=r"step\(\) before reset\(\)"):
        env.step(0)
    assert env.agents == []


def test_an_action_can_be_given_again_after_a_device_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    env, twin = (pearl_marl.raw_env("ConnectFour", 4) for _ in range(2))
    for one in (env, twin):
        one.reset(seed=0)
        one.step(3)

    def failing(*_: Any) -> None:
        raise DeviceError("no answer")

    with monkeypatch.context() as patch:
        patch.setattr(env.env, "step", failing)
        with pytest.raises(DeviceError):
            env.step(2)
    assert env.agent_selection == "agent_2"
    for one in (env, twin):
        one.step(2)
    assert env.last()[1:] == twin.last()[1:]
    assert env.agent_selection == twin.agent_selection == "agent_1"
    np.testing.assert_array_equal(env.state(), twin.state())
