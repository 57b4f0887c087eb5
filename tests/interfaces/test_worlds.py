"""Worlds of several agents in PettingZoo's forms."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np
import pettingzoo
import pytest
from gymnasium.spaces import Box, Dict, Discrete
from pettingzoo.classic import connect_four_v3
from pettingzoo.test import api_test, parallel_api_test

import pearl_marl
from pearl_marl import envs
from pearl_marl.errors import ActionError, ArgumentError, OrderError

from ..toy_world import HARE, SNAIL, WORLDS

NAMES = ("Meadow", "Nim", "ConnectFour", "LevelBasedForaging")
DEVICES = ("reference", "native")


@pytest.fixture(autouse=True)
def world_toys() -> Iterator[None]:
    with mock.patch.dict(envs._specs):
        for spec in WORLDS:
            pearl_marl.register(spec)
        yield


def meadow(n: int | None = None, **arguments: Any) -> Any:
    return pearl_marl.parallel_env("Meadow", n, **{"device": "reference", **arguments})


def nim(n: int | None = None, **arguments: Any) -> Any:
    return pearl_marl.parallel_env("Nim", n, **{"device": "reference", **arguments})


def allowed(env: Any, seed: int = 0) -> Any:
    """Return a random action for each agent: one of those that it may take, if there are any."""
    draws = np.random.default_rng(seed).integers(1 << 32, size=(len(env.action_masks), 1), dtype=np.uint32)
    share = draws / 2.0**32 * env.action_masks.sum(1, keepdims=True)
    return (env.action_masks.cumsum(1) > share).argmax(1).astype(np.uint8)


class TestHowManyAgents:
    def test_one_world_by_default(self) -> None:
        env = meadow()
        assert (env.max_num_agents, env.n_worlds, env.agents_per_world) == (4, 1, 4)

    def test_one_agent_by_default(self) -> None:
        env = pearl_marl.parallel_env("CliffWalking")
        assert (env.max_num_agents, env.n_worlds, env.agents_per_world) == (1, 1, 1)
        assert env.role("agent_0") == "agent"

    def test_an_option_says_how_many_share_a_world(self) -> None:
        env = pearl_marl.parallel_env("LevelBasedForaging", players=3)
        assert (env.max_num_agents, env.n_worlds, env.agents_per_world) == (3, 1, 3)

    @pytest.mark.parametrize(("n", "fit"), [(1, "4 and 8"), (7, "4 and 8"), (9, "8 and 12")])
    def test_parts_of_worlds_are_refused(self, n: int, fit: str) -> None:
        with pytest.raises(ArgumentError) as error:
            meadow(n)
        assert str(error.value) == f"n_agents is {n}, and a world of Meadow has 4 agents; {fit} fit"

    @pytest.mark.parametrize("n", [0, -4, 4.0, True, "4"])
    def test_what_is_no_number_of_agents(self, n: Any) -> None:
        with pytest.raises(ArgumentError, match="the number of agents is"):
            meadow(n)


class TestSpaces:
    def test_by_role(self) -> None:
        env = meadow(8)
        assert [env.role(agent) for agent in env.possible_agents] == ["hare", "hare", "snail", "snail"] * 2
        for agent in env.possible_agents:
            role = {"hare": HARE, "snail": SNAIL}[env.role(agent)]
            n = role.action_space.n  # type: ignore[union-attr]
            mask = Box(0, 1, (n,), np.int8)
            shown = Dict({"observation": role.observation_space, "action_mask": mask})
            assert env.observation_space(agent) == shown
            assert env.action_space(agent) == Discrete(n)
            assert env.observation_space(agent) is env.observation_space(agent)
            assert env.action_space(agent) is env.action_space(agent)
            assert env.action_space(agent) is not role.action_space, "seeding it would seed all others"

    def test_observations_are_in_them(self) -> None:
        env = meadow(12)
        observations, infos = env.reset(seed=0)
        for t in range(40):
            for agent, observation in observations.items():
                assert observation in env.observation_space(agent), agent
                assert observation["action_mask"].dtype == np.int8
            for agent, info in infos.items():
                assert not info or info["final_obs"] in env.observation_space(agent)
            assert observations.array.shape == (12, 4)
            observations, *_, infos = env.step(allowed(env, t))

    def test_an_environment_without_masks_has_plain_observations(self) -> None:
        env = pearl_marl.parallel_env("CliffWalking", 3)
        assert env.observation_space("agent_2") is env.batch.observation_space
        assert env.action_masks is None

    def test_states(self) -> None:
        env = meadow(12)
        env.reset(seed=0)
        assert env.state().shape == env.state_space.shape == (3, 8)
        assert env.state() in env.state_space


class TestWhoIsDead:
    def dying(self, **arguments: Any) -> tuple[Any, int, int]:
        """Return an environment in which somebody is dead, who that is, and one of its world who is not."""
        env = meadow(12, max_cycles=0, **arguments)
        env.reset(seed=1)
        while True:
            before = env.present
            step = env.step_batch(allowed(env))
            gone = (step.ended & ~step.in_episode & before).reshape(3, 4)
            for w in range(3):
                if gone[w].any() and (env.present & env.in_episode).reshape(3, 4)[w].any():
                    here = (env.present & env.in_episode).reshape(3, 4)[w]
                    return env, 4 * w + int(gone[w].argmax()), 4 * w + int(here.argmax())

    def test_it_stays_where_agents_start_over(self) -> None:
        env, dead, _ = self.dying()
        assert env.agents == env.possible_agents
        assert not env.in_episode[dead]
        assert not env.action_masks[dead].any()
        actions = dict.fromkeys(env.agents, 0)
        observations, rewards, terminations, truncations, infos = env.step(actions)
        agent = f"agent_{dead}"
        assert not observations[agent]["observation"].any()
        assert not observations[agent]["action_mask"].any()
        assert (rewards[agent], terminations[agent], truncations[agent]) == (0, False, False)
        assert infos[agent] == {}

    def test_it_leaves_where_agents_leave(self) -> None:
        env, dead, here = self.dying(autoreset=False)
        assert f"agent_{dead}" not in env.agents
        assert f"agent_{here}" in env.agents
        observations, *_ = env.step(dict.fromkeys(env.agents, 0))
        assert f"agent_{dead}" not in observations

    @pytest.mark.parametrize("autoreset", [True, False])
    @pytest.mark.parametrize("name", ["step", "step_batch", "send"])
    def test_its_action_is_ignored_in_arrays(self, name: str, autoreset: bool) -> None:
        env, dead, here = self.dying(autoreset=autoreset)
        actions = np.zeros(12, np.int64)
        actions[dead] = -3
        getattr(env, name)(actions)
        if name == "send":
            env.recv()
        assert actions[dead] == -3, "what was given is not written into"
        before = env.state()
        actions[here] = 9
        with pytest.raises(ActionError, match=f"agent_{here}: action 9 is out of range"):
            getattr(env, name)(actions)
        np.testing.assert_array_equal(env.state(), before)

    @pytest.mark.parametrize("autoreset", [True, False])
    @pytest.mark.parametrize("odd", [1, 99, None, 0.5, [1, 2]])
    def test_its_action_is_ignored_in_dicts(self, odd: Any, autoreset: bool) -> None:
        (env, dead, here), (twin, *_) = (self.dying(autoreset=autoreset) for _ in range(2))
        actions = dict.fromkeys(env.possible_agents, 0)
        twin.step(np.zeros(12, np.int64))
        env.step({**actions, f"agent_{dead}": odd})
        assert env.save_state() == twin.save_state()
        for bad, name in ((9, f"agent_{here}"), (0, "agent_12"), (0, "agent_x")):
            with pytest.raises(ActionError, match=name):
                env.step({**actions, name: bad})
        assert env.save_state() == twin.save_state()

    def test_its_last_observation(self) -> None:
        """In strict lifetimes in place of the zeros, and beside them where worlds start over."""
        leaving, staying = meadow(12, autoreset=False), meadow(12)
        leaving.reset(seed=3)
        staying.reset(seed=3)
        seen = 0
        while leaving.agents:
            before = leaving.present
            actions = allowed(staying)
            observations, _, terminations, truncations, _ = leaving.step(actions)
            step = staying.step_batch(actions)
            for slot in np.flatnonzero(before & step.ended).tolist():
                agent = f"agent_{slot}"
                assert terminations[agent] or truncations[agent]
                width = 4 if leaving.role(agent) == "hare" else 2
                last = observations[agent]
                np.testing.assert_array_equal(last["observation"], step.final_obs[slot][:width])
                assert not last["action_mask"].any()
                seen += not step.in_episode[slot]
        assert seen

    def test_strict_lifetimes_are_those_of_a_world(self) -> None:
        """Whoever is left at a world's end leaves with it, and nobody comes back before a reset."""
        env = meadow(12, autoreset=False, max_cycles=6)
        env.reset(seed=0)
        for _ in range(6):
            assert env.agents
            env.step(dict.fromkeys(env.agents, 0))
        assert env.agents == []
        assert env.step({}) == ({}, {}, {}, {}, {})
        with pytest.raises(OrderError, match="no agent left"):
            env.step_batch(np.zeros(12, np.uint8))
        env.reset()
        assert env.agents == env.possible_agents


class TestBadActions:
    """Each is one sentence, and nothing has moved."""

    def refused(self, env: Any, actions: Any, sentence: str) -> None:
        before = env.save_state()
        for step in (env.step, env.step_batch, env.send):
            if isinstance(actions, dict) and step != env.step:
                continue
            with pytest.raises(ActionError) as error:
                step(actions)
            assert str(error.value) == sentence
            assert env.save_state() == before

    def test_masked(self) -> None:
        env = nim(6)
        env.reset(seed=0)
        while not ((masks := env.action_masks).any(1) & ~masks.all(1)).any():
            env.step_batch(allowed(env))
        slot = int((masks.any(1) & ~masks.all(1)).argmax())
        action = int(masks[slot].argmin())
        may = ", ".join(map(str, np.flatnonzero(masks[slot])))
        actions = allowed(env)
        actions[slot] = action
        sentence = f"agent_{slot}: action {action} is masked; it may take {may}"
        self.refused(env, actions, sentence)
        self.refused(env, {f"agent_{i}": int(actions[i]) for i in range(6)}, sentence)

    def test_masked_where_it_is_a_stay(self) -> None:
        env = meadow(4)
        env.reset(seed=0)
        places = env.state()[:, :4]
        while (env.action_masks[:, 1] == 1).any():
            env.step_batch([1, 1, 1, 1])
            places = env.state()[:, :4]
        env.step_batch([1, 1, 1, 1])
        np.testing.assert_array_equal(env.state()[:, :4], places)

    def test_beyond_the_role(self) -> None:
        env = meadow(8)
        env.reset(seed=0)
        sentence = "agent_6: action 3 is out of range; Discrete(3) takes integers from 0 to 2"
        self.refused(env, np.array([4, 3, 0, 0, 0, 0, 3, 0]), sentence)

    def test_some_of_a_world_missing(self) -> None:
        env = meadow(8)
        env.reset(seed=0)
        actions = {f"agent_{i}": 0 for i in range(8) if i != 5}
        self.refused(env, actions, "no action for 'agent_5'; all 8 agents in env.agents need one")

    def test_who_left_does_not_keep_others_from_playing(self) -> None:
        """Its world runs on unseen, where an action may be masked that nobody chose."""
        env = pearl_marl.parallel_env("ConnectFour", 8, autoreset=False)
        env.reset(seed=0)
        while env.agents:
            env.step({agent: int(allowed(env, 3)[env.rows[agent]]) for agent in env.agents})


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("worlds", [1, 3])
class TestPettingZoosOwnTests:
    def test_parallel(self, name: str, device: str, worlds: int) -> None:
        n = worlds * pearl_marl.get_spec(name).agents
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            env = pearl_marl.parallel_env(name, n, device=device, autoreset=False)
            parallel_api_test(env, num_cycles=60)

    def test_aec(self, name: str, device: str, worlds: int) -> None:
        n = worlds * pearl_marl.get_spec(name).agents
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # It knows masks and roles of environments by their names alone; an empty board is all zeros.
            warnings.filterwarnings("ignore", message="Observation|Agents have different")
            api_test(pearl_marl.env(name, n, device=device, max_cycles=30), num_cycles=60)


class TestTurns:
    def test_as_pettingzoos_connect_four(self) -> None:
        """Agent by agent: who is on turn, what it sees and may do, its reward, and how a game ends."""
        ours, theirs = pearl_marl.env("ConnectFour"), connect_four_v3.env()
        rng = np.random.default_rng(0)
        ends = set()
        for game in range(30):
            ours.reset(seed=game)
            theirs.reset(seed=game)
            assert ours.num_agents == 2
            for mine, other in zip(ours.agent_iter(), theirs.agent_iter(), strict=True):
                assert mine.removeprefix("agent_") == other.removeprefix("player_")
                observation, *outcome, _ = ours.last()
                expected, *their_outcome, _ = theirs.last()
                assert outcome == their_outcome
                action = None
                if not outcome[1]:
                    np.testing.assert_array_equal(observation["observation"], expected["observation"])
                    np.testing.assert_array_equal(observation["action_mask"], expected["action_mask"])
                    action = int(rng.choice(np.flatnonzero(observation["action_mask"])))
                else:
                    ends.add(outcome[0])
                ours.step(action)
                theirs.step(action)
                assert list(ours.rewards.values()) == list(theirs.rewards.values())
                assert len(ours.agents) == len(theirs.agents)
        assert ends == {-1, 1}

    def test_rewards_add_up_between_an_agents_turns(self) -> None:
        """PettingZoo's own test counts them; here every step has one."""
        env = pearl_marl.env("Nim", 6, device="reference", rewards=[0.5, 1.0, -1.0])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            api_test(env, num_cycles=30)

    def test_several_worlds_take_their_turns_one_after_the_other(self) -> None:
        env = pearl_marl.raw_env("Nim", 6, device="reference")
        env.reset(seed=0)
        due = [f"agent_{i}" for i in np.flatnonzero(env.env.action_masks.any(1))]
        assert [int(agent.removeprefix("agent_")) // 2 for agent in due] == [0, 1, 2]
        before = env.state()
        for agent in due:
            assert env.agent_selection == agent
            np.testing.assert_array_equal(env.state(), before)
            env.step(0)
        assert (env.state()[:, 0] == before[:, 0] - 1).all()
        others = [f"agent_{int(agent.removeprefix('agent_')) ^ 1}" for agent in due]
        assert env.agent_selection == others[0]

    def test_bad_actions(self) -> None:
        env = pearl_marl.raw_env("Nim", 4, device="reference")
        env.reset(seed=0)
        agent, first = env.agent_selection, env.env.save_state()

        def refused(action: Any, sentence: str) -> None:
            with pytest.raises(ActionError) as error:
                env.step(action)
            assert str(error.value) == sentence

        refused(None, f"{agent}: action None is no integer; Discrete(3) takes integers from 0 to 2")
        refused(3, f"{agent}: action 3 is out of range; Discrete(3) takes integers from 0 to 2")
        waiting = next(other for other in env.agents if other != agent)
        env.agent_selection = waiting
        refused(0, f"{waiting}: action 0 out of turn; {agent} is on turn")
        env.agent_selection = agent
        assert env.env.save_state() == first
        while env.env.action_masks[env.env.rows[env.agent_selection]].all():
            env.step(0)
        agent, state = env.agent_selection, env.env.save_state()
        may = "0, 1" if env.env.action_masks[env.env.rows[agent]][1] else "0"
        refused(2, f"{agent}: action 2 is masked; it may take {may}")
        assert env.env.save_state() == state
        while not env.terminations[env.agent_selection]:
            env.step(0)
        agent = env.agent_selection
        refused(1, f"{agent}: action 1, but its episode has ended: it takes None")
        env.step(None)
        assert agent not in env.agents
        while env.agents:
            env.step(None if env.terminations[env.agent_selection] else 0)
        with pytest.raises(OrderError, match="no agent left"):
            env.step(None)

    def test_bad_actions_where_there_are_no_turns(self) -> None:
        env = pearl_marl.raw_env("Meadow", device="reference", max_cycles=1)
        env.reset(seed=0)
        env.step(4)
        env.step(0)
        with pytest.raises(ActionError, match=r"agent_2: action 3 is out of range; Discrete\(3\)"):
            env.step(3)
        env.step(0)
        env.step(0)
        with pytest.raises(ActionError, match="agent_0: action 1, but its episode has ended"):
            env.step(1)

    def test_the_registry_knows_both_forms(self) -> None:
        assert pettingzoo.make("aec", "pearl/ConnectFour-v0").max_num_agents == 2
        assert pettingzoo.make("parallel", "pearl/ConnectFour-v0", n_agents=6).n_worlds == 3


class TestGymnasium:
    def test_worlds_of_several_agents_are_refused(self) -> None:
        with pytest.raises(ArgumentError) as error:
            pearl_marl.make_vec("Meadow", 4)
        assert str(error.value) == (
            "Meadow has worlds of 4 agents, and a VectorEnv cannot represent those: "
            "call pearl_marl.parallel_env('Meadow', n_agents=...) instead"
        )


class TestSavedStates:
    def test_masks_and_who_is_alive_are_part_of_it(self) -> None:
        env, fresh = meadow(12), meadow(12)
        env.reset(seed=1)
        while env.in_episode.all():
            env.step_batch(allowed(env))
        fresh.load_state(env.save_state())
        np.testing.assert_array_equal(fresh.in_episode, env.in_episode)
        np.testing.assert_array_equal(fresh.action_masks, env.action_masks)

    def test_resets_by_world(self) -> None:
        env = meadow(12, max_cycles=0)
        env.reset(seed=1)
        for _ in range(5):
            env.step_batch(allowed(env))
        before = env.state()
        env.reset_slots(np.array([False, True, False]))
        changed = (env.state() != before).any(1)
        assert changed.tolist() == [False, True, False]
        with pytest.raises(ArgumentError, match=r"a reset mask is bool of shape \(3,\)"):
            env.reset_slots(np.ones(12, np.bool_))
