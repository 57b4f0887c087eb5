"""PettingZoo's and Gymnasium's forms: their own tests, their registries, their conventions."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.spaces import Tuple
from gymnasium.vector import AutoresetMode
from pettingzoo.test import api_test, parallel_api_test

from pearl_marl.base.arrays import Array
from pearl_marl.devices import BatchConfig, Reference
from pearl_marl.errors import ArgumentError, OrderError
from pearl_marl.interfaces.aec import env as aec_env
from pearl_marl.interfaces.aec import raw_env
from pearl_marl.interfaces.vector import PearlVectorEnv
from pearl_marl.testing.case import SIZE, Case, names_of, sampled


def packed(obs: Any) -> Array:
    """Return observations as a device has them, those of a ``Tuple`` space side by side."""
    return np.stack(obs, 1) if isinstance(obs, tuple) else obs


def whole_episodes(env: Any, seed: int, episodes: int) -> list[Any]:
    """Play and write down everything; PettingZoo 1.27's ``parallel_seed_test`` looks at one step only."""
    seen: list[Any] = [dict(part) for part in env.reset(seed=seed)]
    observations = seen[0]
    for agent in env.possible_agents:
        env.action_space(agent).seed(seed)
    for _ in range(episodes):
        while env.agents:
            actions = {agent: sampled(env, agent, observations[agent]) for agent in env.agents}
            results = [dict(part) for part in env.step(actions)]
            observations = results[0]
            seen += [actions, *results]
        seen += [dict(part) for part in env.reset()]
        observations = seen[-2]
    return seen


class InterfacesContract:
    """Tests of the libraries that this one stands for."""

    def test_parallel_api(self, case: Case) -> None:
        """PettingZoo's own test."""
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            parallel_api_test(case.parallel(SIZE, autoreset=False), num_cycles=60)

    def test_aec_api(self, case: Case) -> None:
        """PettingZoo's own test of agents that act in turns."""
        if isinstance(case.spec.observation_space, Tuple):
            pytest.skip("PettingZoo's test asks a tuple for its dtype")
        n = SIZE * case.agents
        env = aec_env(case.env_id, n_agents=n, device=case.device(SIZE), max_cycles=15)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # A flat Box is no image; PettingZoo says so where the bounds are its business.
            warnings.filterwarnings("ignore", message=".*[Oo]bservation")
            warnings.filterwarnings("ignore", message="Action mask numpy array is all zeros")
            warnings.filterwarnings("ignore", message="Action space for each agent probably should be")
            api_test(env, num_cycles=4 * SIZE)
        env.close()

    def test_raw_aec(self, case: Case) -> None:
        """Every agent acts until its end, and looks once more."""
        n = SIZE * case.agents
        env = raw_env(case.env_id, n_agents=n, device=case.device(SIZE), max_cycles=4)
        env.reset(seed=0)
        turns: dict[str, int] = {}
        for agent in env.agent_iter():
            observation, _, terminated, truncated, _ = env.last()
            turns[agent] = turns.get(agent, 0) + 1
            if truncated and not case.spec.turns:
                assert turns[agent] == 5, "four actions and the last look"
            env.step(None if terminated or truncated else sampled(env, agent, observation))
        assert sorted(turns) == sorted(names_of(n))
        if not case.spec.turns:
            assert list(turns) == names_of(n)

    def test_aec_refuses_autoreset(self, case: Case) -> None:
        """An agent that is always there has no last look."""
        with pytest.raises(ArgumentError, match="no autoreset"):
            aec_env(case.env_id, autoreset=True)

    def test_whole_episodes_repeat_with_a_seed(self, case: Case) -> None:
        """Every dict of several episodes."""
        envs = (case.parallel(SIZE, autoreset=False, max_cycles=8) for _ in range(3))
        first, second, third = (
            whole_episodes(env, seed, 2) for env, seed in zip(envs, (42, 42, 43), strict=True)
        )
        assert len(first) > 2 * 5
        np.testing.assert_equal(first, second)
        with pytest.raises(AssertionError):
            np.testing.assert_equal(first, third)

    def test_pettingzoos_registry(self, case: Case) -> None:
        """``pettingzoo.make`` gives the same environment, in both of its forms."""
        name, n = f"pearl/{case.spec.id}", SIZE * case.agents
        parallel = pettingzoo.make("parallel", name, n_agents=n, device=case.device(SIZE), max_cycles=3)
        ours = case.parallel(SIZE, max_cycles=3, seed=0)
        parallel.reset(seed=0)
        for actions in case.actions(5, SIZE):
            given = dict(zip(ours.agents, actions, strict=True))
            np.testing.assert_equal(
                [dict(part) for part in parallel.step(given)], [dict(part) for part in ours.step(given)]
            )
        assert parallel.unwrapped.step_batch(actions).obs.shape[0] == n
        parallel.close()

        aec = pettingzoo.make("aec", name, n_agents=n, device=case.device(SIZE), max_cycles=2)
        aec.reset(seed=0)
        turns = 0
        for agent in aec.agent_iter():
            observation, _, terminated, truncated, _ = aec.last()
            aec.step(None if terminated or truncated else sampled(aec, agent, observation))
            turns += 1
        assert 2 * n <= turns <= 3 * n, "one or two actions each, and a last look"
        aec.close()

    def test_gymnasiums_registry(self, case: Case) -> None:
        """``gymnasium.make_vec`` gives the same environment."""
        ours = case.vector(SIZE, max_cycles=3)
        env = gymnasium.make_vec(
            f"Pearl/{case.spec.id}",
            num_envs=SIZE,
            vectorization_mode="vector_entry_point",
            device=case.device(SIZE),
            max_cycles=3,
        )
        assert isinstance(env.unwrapped, PearlVectorEnv)
        assert env.num_envs == SIZE
        assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
        np.testing.assert_array_equal(env.reset(seed=1)[0], ours.reset(seed=1)[0])
        for actions in case.actions(8, SIZE):
            for a, b in zip(env.step(actions)[:4], ours.step(actions)[:4], strict=True):
                np.testing.assert_array_equal(a, b)
        env.close()
        assert env.unwrapped.closed

    def test_vector_spaces_are_batches(self, case: Case) -> None:
        """Of the one agent's spaces."""
        env = case.vector(SIZE)
        assert env.single_observation_space == case.spec.observation_space
        assert env.single_action_space == case.spec.action_space
        obs, infos = env.reset(seed=0)
        assert infos == {}
        assert env.observation_space.contains(obs)
        obs, rewards, terminations, truncations, _ = env.step(env.action_space.sample())
        assert env.observation_space.contains(obs)
        assert rewards.dtype == np.float32
        assert terminations.dtype == truncations.dtype == bool

    @pytest.mark.parametrize("copy", [True, False], ids=["copy", "no copy"])
    def test_disabled_autoreset(self, case: Case, copy: bool) -> None:
        """Where an episode ended, its last observation stays until the mask names that sub-environment."""
        env = case.vector(autoreset_mode="Disabled", max_cycles=7, copy=copy)
        reference = Reference().open(BatchConfig(spec=case.spec, n_envs=SIZE, max_cycles=7))
        np.testing.assert_array_equal(packed(env.reset(seed=0)[0]), reference.reset(seed=0))
        resets = 0
        for actions in case.actions(25):
            obs, rewards, terminations, truncations, infos = env.step(actions)
            theirs = reference.step(actions)
            np.testing.assert_array_equal(packed(obs), theirs.arrivals())
            np.testing.assert_array_equal(rewards, theirs.rewards)
            assert "final_obs" not in infos
            ended = terminations | truncations
            np.testing.assert_array_equal(ended, theirs.ended)
            if not ended.any():
                continue
            resets += 1
            with pytest.raises(OrderError, match=f"sub-environment {np.argmax(ended)} has ended"):
                env.step(actions)
            if ended.sum() > 1:  # one first, then the rest: the others' last observations are still there
                first = np.arange(SIZE) == np.argmax(ended)
                last = packed(obs).copy()
                obs = packed(env.reset(options={"reset_mask": first})[0])
                np.testing.assert_array_equal(obs[first], theirs.obs[first])
                np.testing.assert_array_equal(obs[~first], last[~first])
                ended &= ~first
            obs, infos = env.reset(options={"reset_mask": ended})
            np.testing.assert_array_equal(packed(obs), theirs.obs)
            assert infos == {}
        assert resets > 2

    def test_a_closed_vector_environment_refuses_steps(self, case: Case) -> None:
        """And may be closed again."""
        env = case.vector(SIZE, seed=0)
        env.close()
        env.close()
        with pytest.raises(OrderError, match=r"after close\(\)"):
            env.step(case.actions(1, SIZE)[0])
