"""Several wrappers together: one implementation under both interfaces, lazy, saved and copied as one."""

from __future__ import annotations

import copy
import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete
from pettingzoo.test import api_test, parallel_api_test
from pettingzoo.utils.conversions import parallel_to_aec

import pearl_marl
from pearl_marl import wrappers
from pearl_marl.batch.actions import random_actions
from pearl_marl.errors import ArgumentError, OrderError, SavedStateError
from pearl_marl.interfaces.agent_dict import FEW, _UnfilledAgentDict
from pearl_marl.testing.case import assert_same_step, assert_same_trajectory, trajectory

pytestmark = pytest.mark.usefixtures("toys")

N = 12

STACKS: dict[str, Any] = {
    "histories": lambda env: wrappers.frame_stack_v1(
        wrappers.delay_observations_v0(wrappers.max_observation_v0(wrappers.clip_reward_v0(env), 2), 1), 3
    ),
    "chance": lambda env: wrappers.frame_stack_v2(
        wrappers.frame_skip_v0(wrappers.sticky_actions_v0(wrappers.nan_random_v0(env), 0.4), (1, 3)), 2
    ),
    "statistics": lambda env: wrappers.normalize_reward_v0(
        wrappers.agent_indicator_v0(wrappers.normalize_observation_v0(wrappers.frame_stack_v1(env, 2)))
    ),
    "shapes": lambda env: wrappers.flatten_v0(
        wrappers.dtype_v0(wrappers.normalize_obs_v0(wrappers.max_observation_v0(env, 3), -1, 1), np.float64)
    ),
}


def actions(name: str, steps: int, seed: int = 0, n: int = N) -> Any:
    flat = random_actions(pearl_marl.get_spec(name), np.random.default_rng(seed), n * steps)
    return flat.reshape(steps, n, *flat.shape[1:])


@pytest.mark.parametrize("wrap", STACKS.values(), ids=STACKS)
class TestStacks:
    def test_both_interfaces(self, wrap: Any) -> None:
        parallel = wrap(pearl_marl.parallel_env("Drift", N, max_cycles=7))
        vector = wrap(pearl_marl.make_vec("Drift", N, max_cycles=7))
        twin = wrap(pearl_marl.parallel_env("Drift", N, max_cycles=7))
        for seed in (2, None):
            obs, _ = parallel.reset(seed=seed)
            np.testing.assert_array_equal(obs.array, vector.reset(seed=seed)[0])
            twin.reset_batch(seed)
            for act in actions("Drift", 30):
                obs, rewards, terms, truncs, infos = parallel.step(act)
                arrays = vector.step(act)
                step = twin.step_batch(act)
                for result, array, other in zip(
                    (obs, rewards, terms, truncs), arrays[:4], tuple(step)[:4], strict=True
                ):
                    np.testing.assert_array_equal(result.array, array)
                    np.testing.assert_array_equal(other, array)
                for i, agent in enumerate(parallel.agents):
                    assert obs[agent] in parallel.observation_space(agent)
                    if "final_obs" in infos[agent]:
                        np.testing.assert_array_equal(infos[agent]["final_obs"], arrays[4]["final_obs"][i])
                    else:
                        assert not step.ended[i]
        assert vector.observation_space.shape == (N, *parallel.observation_space("agent_0").shape)

    def test_steps_are_lazy(self, wrap: Any) -> None:
        """No dict of many agents is filled by a wrapper before somebody reads it."""
        n = FEW + 1
        env = wrap(pearl_marl.parallel_env("Drift", n, max_cycles=3))
        env.reset(seed=0)
        for act in actions("Drift", 5, n=n):
            assert [type(result) for result in env.step(act)] == [_UnfilledAgentDict] * 5

    def test_saved_states(self, wrap: Any) -> None:
        env = wrap(pearl_marl.parallel_env("Drift", N, max_cycles=7))
        env.reset(seed=2)
        trajectory(env, actions("Drift", 10))
        blob = env.save_state()
        last = trajectory(env, actions("Drift", 25, seed=1))
        for other in (env, wrap(pearl_marl.parallel_env("Drift", N, max_cycles=7))):
            assert other.load_state(blob).shape == last[0].obs.shape
            assert_same_trajectory(trajectory(other, actions("Drift", 25, seed=1)), last)
            other.load_state(blob)
            assert other.save_state() == blob
            env.reset(seed=1)

    def test_loading_shows_what_was_last_shown(self, wrap: Any) -> None:
        env = wrap(pearl_marl.parallel_env("Drift", N, max_cycles=7))
        env.reset(seed=2)
        shown = trajectory(env, actions("Drift", 12))[-1].obs
        np.testing.assert_array_equal(env.load_state(env.save_state()), shown)

    @pytest.mark.parametrize("make", [pearl_marl.parallel_env, pearl_marl.make_vec])
    def test_copies_go_on_by_themselves(self, wrap: Any, make: Any) -> None:
        cloudpickle = pytest.importorskip("cloudpickle")
        env = wrap(make("Drift", N, max_cycles=7))
        env.reset(seed=2)
        trajectory(env, actions("Drift", 10))
        copies = copy.deepcopy(env), cloudpickle.loads(cloudpickle.dumps(env))
        last = trajectory(env, actions("Drift", 25, seed=1))
        for other in copies:
            assert_same_trajectory(trajectory(other, actions("Drift", 25, seed=1)), last)

    @pytest.mark.parametrize("make", [pearl_marl.parallel_env, pearl_marl.make_vec])
    def test_results_are_the_users(self, wrap: Any, make: Any) -> None:
        """They stay as they were, and what is written into them reaches nobody."""
        env, twin = (wrap(make("Drift", N, max_cycles=7)) for _ in range(2))
        held: list[Any] = [env.reset_batch(2)]
        twin.reset_batch(2)[...] = 1
        for t, act in enumerate(actions("Drift", 30)):
            if t % 10 == 5:
                held.append(env.reset_batch())
                twin.reset_batch()[...] = 1
            held.extend(env.step_batch(act))
            step = twin.step_batch(act)
            assert_same_step(step, type(step)(*held[-5:]))
            for array in step:
                array[...] = 1
        copies = copy.deepcopy(held)
        trajectory(env, actions("Drift", 10))
        for array, before in zip(held, copies, strict=True):
            np.testing.assert_array_equal(array, before)

    def test_around_results_that_are_written_over(self, wrap: Any) -> None:
        env, twin = (wrap(pearl_marl.parallel_env("Drift", N, max_cycles=7, copy=c)) for c in (False, True))
        np.testing.assert_array_equal(env.reset_batch(2), twin.reset_batch(2))
        for act in actions("Drift", 30):
            assert_same_step(env.step_batch(act), twin.step_batch(act))

    def test_unseeded(self, wrap: Any) -> None:
        """Without a seed every environment, and every further reset, goes its own way."""
        env, other = (wrap(pearl_marl.parallel_env("Drift", N)) for _ in range(2))
        runs = []
        for e in (env, env, other):
            e.reset()
            runs.append(np.concatenate([step.obs.ravel() for step in trajectory(e, actions("Drift", 10))]))
        assert not any(np.array_equal(runs[a], runs[b]) for a, b in ((0, 1), (0, 2), (1, 2)))

    def test_pettingzoo_accepts_it(self, wrap: Any) -> None:
        env = wrap(pearl_marl.parallel_env("Drift", 3, autoreset=False))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            parallel_api_test(env, num_cycles=60)
            api_test(parallel_to_aec(env), num_cycles=60)


class TestSavedStates:
    def test_agents_that_left(self) -> None:
        def make() -> Any:
            env = pearl_marl.parallel_env("Drift", N, max_cycles=20, autoreset=False)
            return wrappers.frame_stack_v1(wrappers.black_death_v3(env), 2)

        env = make()
        env.reset(seed=1)
        for act in actions("Drift", 8):
            last = env.step_batch(act)
        assert 0 < env.unwrapped.present.sum() < N
        blob, again = env.save_state(), make()
        np.testing.assert_array_equal(again.load_state(blob), last.obs)
        assert again.agents == env.agents == env.possible_agents
        for act in actions("Drift", 30, seed=1):
            assert_same_step(again.step_batch(act), env.step_batch(act))
            assert again.agents == env.agents
            if not env.agents:
                break
        assert not env.agents

    def test_what_is_refused(self) -> None:
        env = wrappers.frame_stack_v1(pearl_marl.parallel_env("Drift", N), 2)
        with pytest.raises(OrderError, match="reset"):
            env.save_state()
        env.reset(seed=0)
        trajectory(env, actions("Drift", 5))
        blob = env.save_state()
        expected = trajectory(copy.deepcopy(env), actions("Drift", 9))
        others = (
            env.unwrapped.save_state(),
            _saved(wrappers.frame_stack_v1(pearl_marl.parallel_env("Drift", N), 3)),
            _saved(wrappers.frame_stack_v1(pearl_marl.parallel_env("Drift", N + 1), 2)),
            _saved(wrappers.frame_stack_v1(pearl_marl.parallel_env("Drift", N, max_cycles=4), 2)),
            _saved(wrappers.max_observation_v0(pearl_marl.parallel_env("Drift", N), 2)),
            blob[:-40],
            blob[:200] + b"??" + blob[202:],
            b"",
            "text",
        )
        for other in others:
            with pytest.raises(SavedStateError):
                env.load_state(other)
        assert_same_trajectory(trajectory(env, actions("Drift", 9)), expected)

    def test_an_environment_that_was_under_way_before(self) -> None:
        inner = pearl_marl.parallel_env("Drift", N)
        inner.reset(seed=0)
        env = wrappers.sticky_actions_v0(inner, 0.5)
        for call in (
            env.save_state,
            lambda: env.step_batch([0] * N),
            lambda: env.step(dict.fromkeys(env.agents, 0)),
        ):
            with pytest.raises(OrderError, match="reset"):
                call()


def _saved(env: Any) -> bytes:
    env.reset(seed=0)
    blob: bytes = env.save_state()
    return blob


class TestFaces:
    """What is inside shows through."""

    def test_attributes(self) -> None:
        env = wrappers.frame_stack_v1(wrappers.clip_reward_v0(pearl_marl.parallel_env("CartPole", 3)), 2)
        env.reset(seed=0)
        inner = env.unwrapped
        assert isinstance(inner, pearl_marl.PearlParallelEnv)
        assert env.metadata == inner.metadata
        assert env.spec is inner.spec
        assert env.device is inner.device
        assert env.render_mode is None
        assert env.state_space is inner.state_space
        np.testing.assert_array_equal(env.state(), inner.state())
        assert env.num_agents == env.max_num_agents == 3
        env.max_cycles = 2
        assert inner.max_cycles == env.max_cycles == 2
        assert not hasattr(env, "nothing")
        for past in (lambda: env.send([0] * 3), env.recv):
            with pytest.raises(OrderError, match="a wrapped environment has no"):
                past()
        env.close()
        for call in (
            lambda: env.step(dict.fromkeys(env.agents, 0)),
            lambda: env.step_batch([0] * 3),
            env.reset,
        ):
            with pytest.raises(OrderError, match="close"):
                call()

    def test_set_rewards(self) -> None:
        env = wrappers.clip_reward_v0(pearl_marl.parallel_env("Ladder", 3), -1, 1)
        env.reset(seed=0)
        env.set_rewards([0.5] * 16)
        assert env.step_batch([0, 1, 0]).rewards.tolist() == [0.5] * 3
        env.set_rewards([7] * 16)
        assert env.step_batch([0, 1, 0]).rewards.tolist() == [1] * 3

    def test_vector_attributes(self) -> None:
        inner = pearl_marl.make_vec("CartPole", 3, autoreset_mode="NextStep")
        env = wrappers.frame_stack_v1(inner, 2)
        assert env.unwrapped is inner
        assert env.metadata["autoreset_mode"] is inner.metadata["autoreset_mode"]
        assert env.num_envs == 3
        assert env.single_observation_space.shape == (8,)
        assert env.device is inner.device
        with pytest.raises(OrderError, match=r"a wrapped environment has no send\(\), recv\(\) and"):
            env.send([0] * 3)
        del env
        inner.reset(seed=0)  # a wrapper that is gone has not closed what was inside
        env = wrappers.frame_stack_v1(inner, 2)
        env.close()
        with pytest.raises(OrderError, match="close"):
            inner.reset()


@pytest.mark.parametrize("make", [pearl_marl.parallel_env, pearl_marl.make_vec])
class TestTupleObservations:
    def test_refused_where_they_make_no_sense(self, make: Any) -> None:
        for name, wrap in {
            "dtype_v0": lambda env: wrappers.dtype_v0(env, np.float32),
            "flatten_v0": wrappers.flatten_v0,
            "reshape_v0": lambda env: wrappers.reshape_v0(env, (2, 1)),
            "normalize_obs_v0": wrappers.normalize_obs_v0,
            "color_reduction_v0": wrappers.color_reduction_v0,
            "resize_v1": lambda env: wrappers.resize_v1(env, 2, 2),
            "frame_stack": wrappers.frame_stack_v1,
            "delay_observations_v0": lambda env: wrappers.delay_observations_v0(env, 1),
            "max_observation_v0": lambda env: wrappers.max_observation_v0(env, 2),
            "agent_indicator_v0": wrappers.agent_indicator_v0,
            "normalize_observation_v0": wrappers.normalize_observation_v0,
            "observation_lambda_v0": lambda env: wrappers.observation_lambda_v0(env, lambda obs, space: obs),
        }.items():
            with pytest.raises(ArgumentError, match=rf"{name}.*Tuple"):
                wrap(make("Ladder", N))

    def test_handed_through_elsewhere(self, make: Any) -> None:
        env = wrappers.clip_reward_v0(wrappers.sticky_actions_v0(make("Ladder", N, max_cycles=9), 0), -2, 2)
        env = wrappers.normalize_reward_v0(wrappers.frame_skip_v0(env, 2))
        plain = make("Ladder", N, max_cycles=9)
        np.testing.assert_array_equal(env.reset_batch(0), plain.reset_batch(0))
        for act in actions("Ladder", 4):  # nobody ends in so few
            plain.step_batch(act)
            np.testing.assert_array_equal(env.step_batch(act).obs, plain.step_batch(act).obs)

    def test_made_into_something_else(self, make: Any) -> None:
        env = wrappers.observation_lambda_v0(
            make("Ladder", N), lambda obs, space: obs[:, 0] * 2 + obs[:, 1], lambda space: Discrete(20)
        )
        env = wrappers.frame_stack_v1(env, 2)
        assert env.reset_batch(0).shape == (N,)


class TestArguments:
    @pytest.mark.parametrize(
        ("wrap", "words"),
        [
            (lambda env: wrappers.frame_stack_v1(env, 0), "stack_size is 0"),
            (lambda env: wrappers.frame_stack_v2(env, 2, 1), "stack_dim is 1"),
            (lambda env: wrappers.frame_stack_v1(env, 10**12), "stack_size is 1,000,000,000,000; .*memory"),
            (lambda env: wrappers.frame_stack_v1(env, 2, np.zeros(2)), "stack_dim is array"),
            (lambda env: wrappers.delay_observations_v0(env, 10**12), "delay is 1,000,000,000,000; .*memory"),
            (lambda env: wrappers.max_observation_v0(env, 10**12), "memory is 1,000,000,000,000; .*memory"),
            (lambda env: wrappers.delay_observations_v0(env, -1), "delay is -1"),
            (lambda env: wrappers.max_observation_v0(env, True), "memory is True"),
            (lambda env: wrappers.resize_v1(env, 0, 3), "x_size is 0"),
            (lambda env: wrappers.resize_v1(env, 3, 3), "2 or 3 axes"),
            (lambda env: wrappers.color_reduction_v0(env, "X"), "mode is 'X'"),
            (wrappers.color_reduction_v0, "3 channels"),
            (lambda env: wrappers.reshape_v0(env, (5,)), "not as many elements"),
            (lambda env: wrappers.reshape_v0(env, "x"), "shape is 'x'"),
            (lambda env: wrappers.reshape_v0(env, (2.0, 2)), r"shape is \(2.0, 2\)"),
            (lambda env: wrappers.reshape_v0(env, (-3, -1)), "not as many elements"),
            (lambda env: wrappers.dtype_v0(env, "x"), "dtype is 'x'"),
            (lambda env: wrappers.dtype_v0(env, object), "dtype is <class 'object'>"),
            (lambda env: wrappers.dtype_v0(env, complex), "dtype is <class 'complex'>"),
            (lambda env: wrappers.dtype_v0(env, np.uint8), "dtype_v0 would make .*: low above high"),
            (lambda env: wrappers.clip_reward_v0(env, "a", 1), "lower_bound is 'a'"),
            (lambda env: wrappers.clip_reward_v0(env, 0, np.nan), "upper_bound is nan"),
            (lambda env: wrappers.clip_reward_v0(env, 2, 1), "wrong way round"),
            (lambda env: wrappers.normalize_obs_v0(env, "0", 1), "env_min is '0'"),
            (lambda env: wrappers.normalize_obs_v0(env, 1, 1), "env_min is 1"),
            (lambda env: wrappers.normalize_obs_v0(wrappers.dtype_v0(env, np.int32)), "int32"),
            (wrappers.clip_actions_v0, "clip_actions_v0.*Discrete"),
            (lambda env: wrappers.scale_actions_v0(env, 2), "scale_actions_v0.*Discrete"),
            (lambda env: wrappers.sticky_actions_v0(env, 1), "repeat_action_probability is 1"),
            (lambda env: wrappers.nan_noop_v0(env, 5), "no_op_action is 5"),
            (lambda env: wrappers.sticky_actions_v0(env, "x"), "repeat_action_probability is 'x'"),
            (lambda env: wrappers.normalize_observation_v0(env, "x"), "epsilon is 'x'"),
            (lambda env: wrappers.normalize_reward_v0(env, gamma=2), "gamma is 2"),
            (lambda env: wrappers.normalize_observation_v0(env, epsilon=0), "epsilon is 0"),
            (lambda env: wrappers.observation_lambda_v0(env, lambda obs, space: obs[:1]), "whole batches"),
            (lambda env: wrappers.observation_lambda_v0(env, lambda obs, space: None), "made no rows of"),
            (
                lambda env: wrappers.observation_lambda_v0(env, lambda obs, s: obs, lambda s: 3),
                "change_obs_space_fn made 3; it must be a space",
            ),
            (
                lambda env: wrappers.observation_lambda_v0(
                    env, lambda obs, s: obs, lambda s: Box(0, 1, (9,))
                ),
                r"made rows of shape \(3,\), and change_obs_space_fn Box.*9",
            ),
            (lambda env: wrappers.action_lambda_v1(env, lambda a, s: a, lambda s: "no"), "change_space_fn"),
        ],
    )
    def test_refused(self, wrap: Any, words: str) -> None:
        with pytest.raises(ArgumentError, match=words):
            wrap(pearl_marl.parallel_env("Drift", N)).reset()

    @pytest.mark.parametrize("scale", ["2", np.ones(2), 0, np.inf], ids=repr)
    def test_scales(self, scale: Any) -> None:
        with pytest.raises(ArgumentError, match=r"scale is .*; it must be a number above 0"):
            wrappers.scale_actions_v0(pearl_marl.parallel_env("Pendulum", 2), scale)

    def test_rewards_of_the_wrong_shape(self) -> None:
        env = wrappers.reward_lambda_v0(pearl_marl.parallel_env("Drift", N), lambda rewards: rewards[0])
        env.reset(seed=0)
        with pytest.raises(ArgumentError, match="whole batch"):
            env.step_batch([0] * N)

    def test_other_environments(self) -> None:
        with pytest.raises(ArgumentError, match="SuperSuit"):
            wrappers.frame_stack_v1(object())

    def test_numbers_too_large_to_stack(self) -> None:
        with pytest.raises(ArgumentError, match="63 bits"):
            wrappers.frame_stack_v1(pearl_marl.parallel_env("CliffWalking", 2), 20)

    def test_names(self) -> None:
        for name in wrappers.__all__:
            if name != "sb3_vec_env":
                assert callable(getattr(wrappers, name))
        with pytest.raises(AttributeError, match=r"did you mean frame_stack_v\d"):
            _ = wrappers.frame_stack_v0
        for old, new in (("clip_reward_v0", "ClipRewardParallelV1"), ("frame_stack_v2", "FrameStackV3")):
            first, second = (
                getattr(wrappers, name)(pearl_marl.parallel_env("Drift", N)) for name in (old, new)
            )
            first.reset(seed=0)
            second.reset(seed=0)
            assert_same_trajectory(*(trajectory(env, actions("Drift", 5)) for env in (first, second)))


@pytest.mark.parametrize(
    "make",
    [
        lambda env: wrappers.reward_lambda_v0(env, 3),
        lambda env: wrappers.observation_lambda_v0(env, 3),
        lambda env: wrappers.observation_lambda_v0(env, lambda obs, _: obs, 3),
        lambda env: wrappers.action_lambda_v1(env, 3, lambda space: space),
        lambda env: wrappers.action_lambda_v1(env, lambda actions, _: actions, 3),
    ],
)
def test_what_is_no_function(make: Any) -> None:
    with pytest.raises(ArgumentError, match="_fn is 3; it must be a function"):
        make(pearl_marl.parallel_env("CliffWalking", 2))


def test_spaces_that_zeros_are_not_in() -> None:
    """What histories show before an episode's first frame is in the space, too."""
    env = wrappers.observation_lambda_v0(
        pearl_marl.parallel_env("Slide", N), lambda obs, space: obs.astype(np.float32) + 2
    )
    for wrap in (wrappers.frame_stack_v1, lambda e: wrappers.delay_observations_v0(e, 2)):
        wrapped = wrap(env)
        space = wrapped.observation_space("agent_0")
        assert isinstance(space, Box)
        assert all(obs in space for obs in wrapped.reset_batch(0))
    assert wrappers.frame_stack_v2(env).observation_space("agent_0").low.min() == 2
