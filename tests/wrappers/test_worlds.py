"""Wrappers around worlds of several agents: rows of ends, of the dead, and of those who begin again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import numpy as np
import pytest
import supersuit
from gymnasium.spaces import Box, Dict, Discrete

import pearl_marl
from pearl_marl import envs, wrappers
from pearl_marl.batch.actions import random_allowed
from pearl_marl.batch.step import BatchStep
from pearl_marl.errors import ActionError, ArgumentError
from pearl_marl.wrappers.stable_baselines3 import sb3_vec_env

from ..toy_world import WORLDS, crowd

N, K = 12, 4


@pytest.fixture(autouse=True)
def world_toys() -> Iterator[None]:
    with mock.patch.dict(envs._specs):
        for spec in (*WORLDS, crowd(4)):
            pearl_marl.register(spec)
        yield


def meadow(**arguments: Any) -> Any:
    return pearl_marl.parallel_env("Meadow", N, **{"device": "reference", **arguments})


def crowded(**arguments: Any) -> Any:
    """Agents of one role with a ``Box`` of two numbers and masks; they end one by one."""
    return pearl_marl.parallel_env("Crowd", N, **{"device": "reference", **arguments})


def padded(**arguments: Any) -> Any:
    return wrappers.pad_action_space_v0(wrappers.pad_observations_v0(meadow(**arguments)))


def chosen(env: Any, t: int) -> Any:
    draws = np.random.default_rng(t).integers(1 << 32, size=N, dtype=np.uint32)
    return random_allowed(env.action_masks, draws)


def test_a_mask_of_worlds_may_be_a_list() -> None:
    env, twin = (wrappers.shared_reward_v0(crowded()) for _ in range(2))
    for e in (env, twin):
        e.reset_batch(5)
    mask = [True, False, True]
    np.testing.assert_array_equal(env.reset_slots(mask), twin.reset_slots(np.array(mask)))


def played(env: Any, steps: int = 40, plain: Any = None) -> Iterator[tuple[BatchStep, BatchStep, Any]]:
    """Yield a wrapped environment's steps, an unwrapped one's, and who acted in them."""
    plain = crowded() if plain is None else plain
    plain.reset_batch(5)
    env.reset_batch(5)
    for t in range(steps):
        acting, actions = plain.in_episode.copy(), chosen(plain, t)
        yield env.step_batch(actions), plain.step_batch(actions), acting


CHANGES: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "dtype": (lambda env: wrappers.dtype_v0(env, np.float64), lambda obs: obs.astype(np.float64)),
    "lambda": (
        lambda env: wrappers.observation_lambda_v0(env, lambda obs, _: obs + 1),
        lambda obs: obs + 1,
    ),
    "normalized": (
        lambda env: wrappers.normalize_obs_v0(env, 1, 2),
        lambda obs: 1 + obs / np.float32(15),
    ),
    "stack of one": (lambda env: wrappers.frame_stack_v1(env, 1), lambda obs: obs),
}


@pytest.mark.parametrize(("wrap", "change"), CHANGES.values(), ids=CHANGES)
def test_each_agent_by_itself(wrap: Any, change: Any) -> None:
    """And the dead see zeros, whatever the wrapper makes of zeros."""
    env = wrap(crowded())
    dead, ended = 0, 0
    for ours, theirs, _ in played(env):
        expected = change(theirs.obs)
        expected[~theirs.in_episode] = 0
        np.testing.assert_allclose(ours.obs, expected)
        np.testing.assert_array_equal(ours.in_episode, theirs.in_episode)
        np.testing.assert_array_equal(ours.action_masks, theirs.action_masks)
        now = theirs.ended
        np.testing.assert_allclose(ours.final_obs[now], change(theirs.final_obs)[now])
        for name in ("rewards", "terminations", "truncations"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        dead += (~theirs.in_episode).sum()
        ended += (now & theirs.in_episode).sum()
    assert dead
    assert ended


def test_a_stack_begins_again_with_its_world() -> None:
    """Not where an agent ends: it has no frames until then."""
    env = wrappers.frame_stack_v2(crowded(), 3)
    frames = None
    for ours, theirs, _acting in played(env):
        begins = np.repeat(theirs.ended.reshape(-1, K).any(1) & theirs.in_episode.reshape(-1, K).all(1), K)
        arrived = np.where(theirs.ended[:, None], theirs.final_obs, theirs.obs)
        if frames is None:
            frames = [None, None, None]
        if all(frame is not None for frame in frames):
            stack = np.concatenate([*frames[1:], arrived], 1)
            now = theirs.ended
            np.testing.assert_array_equal(ours.final_obs[now], stack[now])
        expected = np.concatenate([theirs.obs] * 3, 1)
        np.testing.assert_array_equal(ours.obs[begins], expected[begins])
        frames = [
            *(None if f is None else np.where(begins[:, None], theirs.obs, f) for f in frames[1:]),
            np.where(begins[:, None], theirs.obs, arrived),
        ]


class TestRoles:
    def test_masks_and_roles_stay_where_spaces_do(self) -> None:
        env = wrappers.clip_reward_v0(meadow())
        observations, _ = env.reset(seed=0)
        assert env.role("agent_3") == "snail"
        assert (env.n_worlds, env.agents_per_world) == (3, 4)
        for agent in env.agents:
            assert observations[agent] in env.observation_space(agent)
            assert env.observation_space(agent) == meadow().observation_space(agent)

    @pytest.mark.parametrize(
        "wrap",
        [
            lambda env: wrappers.dtype_v0(env, np.float32),
            lambda env: wrappers.frame_stack_v1(env, 2),
            wrappers.normalize_observation_v0,
            wrappers.agent_indicator_v0,
            wrappers.world_observations_v0,
        ],
    )
    def test_what_would_mix_them_is_refused(self, wrap: Any) -> None:
        with pytest.raises(ArgumentError) as error:
            wrap(meadow())
        assert str(error.value) == (
            "this wrapper would mix roles, and in Meadow snail have another observation_space than the "
            "widest: put pad_observations_v0 inside it"
        )
        wrap(wrappers.pad_observations_v0(meadow())).reset()

    def test_actions_of_roles(self) -> None:
        def change(env: Any) -> Any:
            return wrappers.action_lambda_v1(env, lambda actions, _: actions, lambda _: Discrete(9))

        with pytest.raises(ArgumentError, match="put pad_action_space_v0 inside it"):
            change(meadow())
        with pytest.raises(ArgumentError) as error:
            change(padded())
        assert str(error.value) == (
            "this wrapper changes the action space, and Meadow has masks of Discrete(5), which do not "
            "follow: change actions before you give them"
        )

    def test_padded(self) -> None:
        env = padded()
        observations, _ = env.reset(seed=0)
        hare = meadow().observation_space("agent_0")
        for agent in env.agents:
            assert env.observation_space(agent) == hare
            assert env.action_space(agent) == Discrete(5)
            assert observations[agent] in hare
        assert [env.role(agent) for agent in env.agents[:4]] == ["hare", "hare", "snail", "snail"]

    def test_a_padded_action_is_the_first(self) -> None:
        env, plain = wrappers.pad_action_space_v0(meadow()), meadow()
        env.reset_batch(0)
        plain.reset_batch(0)
        env.step_batch([1, 4, 4, 3] * 3)
        plain.step_batch([1, 4, 0, 0] * 3)
        np.testing.assert_array_equal(env.state(), plain.state())
        with pytest.raises(ActionError, match="agent_2: action 5 is out of range"):
            env.step_batch([0, 0, 5, 0] * 3)

    def test_nothing_to_pad(self) -> None:
        env = crowded()
        assert wrappers.pad_observations_v0(env) is env
        assert wrappers.pad_action_space_v0(env) is env


class TestAgentIndicator:
    def test_as_supersuit_has_it(self) -> None:
        """In one world, of which SuperSuit sees the batch's observations."""
        with pytest.warns(UserWarning, match="was registered before"):
            pearl_marl.register(crowd(4, masked=False))

        def one() -> Any:
            return pearl_marl.parallel_env("Crowd", device="reference", autoreset=False)

        ours, theirs = wrappers.agent_indicator_v0(one()), supersuit.agent_indicator_v0(one())
        mine, _ = ours.reset(seed=0)
        other, _ = theirs.reset(seed=0)
        for agent in ours.agents:
            np.testing.assert_array_equal(mine[agent][:2], other[agent][:2])
            np.testing.assert_array_equal(mine[agent][2:], other[agent][2:] > 0)

    def test_by_world(self) -> None:
        env = wrappers.agent_indicator_v0(crowded())
        obs = env.reset_batch(0)
        np.testing.assert_array_equal(obs[:, 2:], np.tile(np.eye(4), (3, 1)))

    def test_by_role(self) -> None:
        env = wrappers.agent_indicator_v0(wrappers.pad_observations_v0(meadow()), type_only=True)
        obs = env.reset_batch(0)
        np.testing.assert_array_equal(obs[:4, 4:], [[1, 0], [1, 0], [0, 1], [0, 1]])
        plain = crowded()
        assert wrappers.agent_indicator_v0(plain, type_only=True) is plain

    def test_of_numbers(self) -> None:
        env = wrappers.agent_indicator_v0(pearl_marl.parallel_env("Nim", 6, device="reference"))
        plain = pearl_marl.parallel_env("Nim", 6, device="reference")
        expected = plain.reset_batch(0) * 2 + np.array([0, 1] * 3)
        np.testing.assert_array_equal(env.reset_batch(0), expected)
        assert env.observation_space("agent_1")["observation"] == Discrete(32)


def test_shared_rewards() -> None:
    env = wrappers.shared_reward_v0(crowded())
    dead = 0
    for ours, theirs, acting in played(env):
        expected = theirs.rewards.reshape(-1, K).sum(1).repeat(K)
        np.testing.assert_array_equal(ours.rewards, np.where(acting, expected, 0))
        dead += (~acting).sum()
    assert dead


def test_observations_of_the_world() -> None:
    """Where somebody ends: its last one beside those of the others at that moment."""
    env = wrappers.world_observations_v0(crowded())
    assert env.observation_space("agent_0")["observation"] == Box(0, 15, (4, 2), np.float32)
    alone = together = 0
    for ours, theirs, acting in played(env):
        expected = theirs.obs.reshape(-1, K, 2).repeat(K, 0)
        expected[~theirs.in_episode] = 0
        np.testing.assert_array_equal(ours.obs, expected)
        last = np.where(theirs.ended[:, None], theirs.final_obs, theirs.obs)
        last[~acting] = 0
        finals = last.reshape(-1, K, 2).repeat(K, 0)
        now = theirs.ended
        np.testing.assert_array_equal(ours.final_obs[now], finals[now])
        alone += (now & ~theirs.in_episode).sum()
        together += (now & theirs.in_episode & ~acting.reshape(-1, K).all(1).repeat(K)).sum()
    assert alone
    assert together


def test_frame_skip_is_single_steps() -> None:
    """Whose world began again on the way begins there; who died on the way stays dead."""
    skipping, plain = wrappers.frame_skip_v0(crowded(max_cycles=7), 3), crowded(max_cycles=7)
    skipping.reset_batch(2)
    plain.reset_batch(2)
    died = began = 0
    for t in range(30):
        actions = chosen(plain, t)
        rewards = np.zeros(N, np.float32)
        ended, over = np.zeros(N, np.bool_), np.zeros(N, np.bool_)
        for _ in range(3):
            started = over.any()
            step = plain.step_batch(actions)
            rewards += np.where(over, 0, step.rewards)
            ended |= step.ended & ~over
            over |= np.repeat(step.ended.reshape(-1, K).any(1) & step.in_episode.reshape(-1, K).all(1), K)
            if over.all():
                break
        if started:
            plain.reset_slots(over[::K])
        skipped = skipping.step_batch(actions)
        np.testing.assert_array_equal(skipping.state(), plain.state())
        np.testing.assert_array_equal(skipped.rewards, rewards)
        np.testing.assert_array_equal(skipped.ended, ended)
        np.testing.assert_array_equal(skipped.in_episode, plain.in_episode)
        np.testing.assert_array_equal(skipped.action_masks, plain.action_masks)
        died += (ended & ~plain.in_episode).sum()
        began += over.sum()
    assert died
    assert began


def test_frame_skip_where_masked_actions_are_refused() -> None:
    with pytest.raises(ArgumentError, match="an action may be masked by the time it is to be repeated"):
        wrappers.frame_skip_v0(pearl_marl.parallel_env("Nim"), 2)


def test_sticky_actions_stick_to_none_that_is_masked() -> None:
    env = wrappers.sticky_actions_v0(pearl_marl.parallel_env("Nim", N, device="reference"), 0.9)
    env.reset_batch(0)
    for t in range(40):
        env.step_batch(chosen(env, t))


def test_random_actions_in_place_of_nan_are_allowed() -> None:
    env = wrappers.nan_random_v0(pearl_marl.parallel_env("Nim", N, device="reference"))
    env.reset_batch(0)
    for _ in range(40):
        env.step_batch(np.full(N, np.nan))


def test_black_death_masks_who_has_left() -> None:
    env = wrappers.black_death_v3(crowded(autoreset=False))
    observations, _ = env.reset(seed=0)
    left = 0
    while env.agents:
        observations, *_ = env.step(dict.fromkeys(env.agents, 0))
        for agent in env.agents:
            slot = env.rows[agent]
            if not env.unwrapped.present[slot]:
                left += 1
                assert not observations[agent]["action_mask"].any()
    assert left


def test_normalisation_counts_nobody_who_is_dead() -> None:
    env = wrappers.normalize_observation_v0(crowded())
    seen = [crowded().reset_batch(5)]
    for _, theirs, _ in played(env):
        seen.append(theirs.obs[theirs.in_episode])
    rows = np.concatenate(seen)
    statistics = env.transform.statistics()
    np.testing.assert_allclose(statistics["mean"], rows.mean(0), rtol=1e-4)
    assert statistics["count"] == pytest.approx(len(rows), abs=1)


def test_saved_states_of_wrapped_worlds() -> None:
    env, fresh = (wrappers.frame_stack_v1(crowded(), 2) for _ in range(2))
    env.reset_batch(0)
    while env.in_episode.all():
        last = env.step_batch(chosen(env, 0))
    np.testing.assert_array_equal(fresh.load_state(env.save_state()), last.obs)


class TestStableBaselines3:
    def test_the_dead_are_done_once_more_when_their_world_begins(self) -> None:
        env, plain = sb3_vec_env(crowded()), crowded()
        env.seed(5)
        np.testing.assert_array_equal(env.reset(), plain.reset_batch(5))
        revived, lengths = 0, np.zeros(N, int)
        for t in range(60):
            acting, actions = plain.in_episode.copy(), chosen(plain, t)
            step = plain.step_batch(actions)
            _, _, dones, infos = env.step(actions)
            np.testing.assert_array_equal(dones, step.ended | (~acting & step.in_episode))
            lengths += acting
            for slot in np.flatnonzero(step.ended).tolist():
                assert infos[slot]["episode"]["l"] == lengths[slot]
                lengths[slot] = 0
            revived += (~acting & step.in_episode).sum()
            assert all(not infos[slot] for slot in np.flatnonzero(~step.ended))
        assert revived

    def test_masks_as_maskable_ppo_asks_for_them(self) -> None:
        env = sb3_vec_env(crowded())
        env.reset()
        np.testing.assert_array_equal(np.stack(env.env_method("action_masks")), env.env.action_masks)

    def test_roles_are_refused(self) -> None:
        with pytest.raises(ArgumentError) as error:
            sb3_vec_env(meadow())
        assert str(error.value) == (
            "SB3 has one policy for all agents, and snail have other spaces than the widest: "
            "put pad_observations_v0 and pad_action_space_v0 around the environment"
        )
        env = sb3_vec_env(padded())
        assert env.num_envs == N
        assert env.reset().shape == (N, 4)

    def test_staggered(self) -> None:
        env = sb3_vec_env(padded(), staggered=True)
        env.reset()
        for t in range(20):
            env.step(chosen(env.env, t))


def test_a_dict_space_where_there_are_masks() -> None:
    env = wrappers.frame_stack_v1(crowded(), 2)
    space = env.observation_space("agent_0")
    assert isinstance(space, Dict)
    assert space["observation"].shape == (4,)
