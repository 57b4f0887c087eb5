"""The wrappers that SuperSuit has too give its numbers, but for its faults, each of which is shown."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete
from pettingzoo.utils import BaseParallelWrapper

import pearl_marl
from pearl_marl import wrappers
from pearl_marl.errors import ActionError

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # SuperSuit tells of its successor, and imports what is deprecated
    supersuit = pytest.importorskip("supersuit", reason="SuperSuit is not installed")
    from supersuit.utils.basic_transforms.resize import change_observation as theirs_resize

pytestmark = [pytest.mark.usefixtures("toys"), pytest.mark.filterwarnings("ignore")]
N = 5
Wrap = Callable[[Any, Any], Any]


def strict(name: str, shape: tuple[int, ...] | None = None, dtype: Any = np.uint8, **arguments: Any) -> Any:
    """Return an environment whose agents leave; with a shape, one that shows pictures instead."""
    env = pearl_marl.parallel_env(name, N, autoreset=False, **{"max_cycles": 9, **arguments})
    if shape is None:
        return env

    def pictures(obs: Any, space: Any) -> Any:
        place = obs.reshape(len(obs), -1).argmax(1).reshape(-1, *(1,) * len(shape))
        return ((place + 3) * (np.arange(np.prod(shape)).reshape(shape) + 7) % 251).astype(dtype)

    return wrappers.observation_lambda_v0(env, pictures, lambda space: Box(0, 250, shape, dtype))


class LetsTheLeftAct(BaseParallelWrapper):
    """SuperSuit's frame_skip steps agents on after their episode has ended, which we refuse."""

    def step(self, actions: dict[str, Any]) -> Any:
        return self.env.step({agent: actions[agent] for agent in self.env.agents})


def actions_for(env: Any, generator: np.random.Generator) -> dict[str, Any]:
    actions = {}
    for agent in env.agents:
        space = env.action_space(agent)
        if isinstance(space, Box):
            actions[agent] = generator.uniform(space.low, space.high).astype(np.float32)
        else:
            actions[agent] = int(generator.integers(space.n))
    return actions


def assert_same_play(ours: Any, theirs: Any, change: Callable[[Any], Any] = lambda action: action) -> int:
    """Play two games alike; return how many agents' episodes ended."""
    agent = ours.possible_agents[0]
    assert ours.observation_space(agent) == theirs.observation_space(agent)
    assert ours.action_space(agent) == theirs.action_space(agent)
    generator = np.random.default_rng(1)
    ends = 0
    for seed in (4, None):
        (obs, _), (expected, _) = ours.reset(seed=seed), theirs.reset(seed=seed)
        np.testing.assert_equal(dict(obs), dict(expected))
        for _ in range(40):
            assert ours.agents == theirs.agents
            if not ours.agents:
                break
            actions = {agent: change(a) for agent, a in actions_for(ours, generator).items()}
            (obs, rewards, *flags, _), (expected, their_rewards, *theirs_flags, _) = (
                env.step(actions) for env in (ours, theirs)
            )
            np.testing.assert_equal(dict(obs), dict(expected))
            for agent in obs:
                assert np.asarray(obs[agent]).dtype == np.asarray(expected[agent]).dtype
            np.testing.assert_allclose(list(rewards.values()), list(their_rewards.values()), 1e-6)
            assert list(map(dict, flags)) == [dict(flag) for flag in theirs_flags]
            ends += sum(t or u for t, u in zip(flags[0].values(), flags[1].values(), strict=True))
        assert not ours.agents
    return ends


GRID = "CliffWalking"


@pytest.mark.parametrize(
    ("env", "wrap"),
    [
        pytest.param(env, wrap, id=name)
        for name, env, wrap in [
            ("clip_reward", ("Drift",), lambda lib, e: lib.clip_reward_v0(e, -3, 2.5)),
            ("clip_reward, default", ("Ladder",), lambda lib, e: lib.clip_reward_v0(e)),
            ("dtype", ("Drift",), lambda lib, e: lib.dtype_v0(e, np.float64)),
            ("dtype, integers", ("Drift",), lambda lib, e: lib.dtype_v0(e, np.int16)),
            ("flatten", ("Slide",), lambda lib, e: lib.flatten_v0(e)),
            ("reshape", ("Slide",), lambda lib, e: lib.reshape_v0(e, (8, 3))),
            ("normalize_obs", ("Drift",), lambda lib, e: lib.normalize_obs_v0(e, -1, 3)),
            ("normalize_obs, default", ("Drift",), lambda lib, e: lib.normalize_obs_v0(e)),
            ("color, full", ("Slide", (4, 3, 3)), lambda lib, e: lib.color_reduction_v0(e)),
            ("color, R", ("Slide", (4, 3, 3)), lambda lib, e: lib.color_reduction_v0(e, "R")),
            ("color, B", ("Slide",), lambda lib, e: lib.color_reduction_v0(e, "B")),
            ("frame_stack", ("Drift",), lambda lib, e: lib.frame_stack_v1(e)),
            ("frame_stack, 1", ("Drift",), lambda lib, e: lib.frame_stack_v1(e, 1)),
            ("frame_stack, Discrete", (GRID,), lambda lib, e: lib.frame_stack_v1(e, 3)),
            ("frame_stack, 2 axes", ("Slide", (4, 3)), lambda lib, e: lib.frame_stack_v1(e, 3)),
            ("frame_stack, 3 axes", ("Slide",), lambda lib, e: lib.frame_stack_v1(e, 3)),
            ("frame_stack, first axis", ("Slide",), lambda lib, e: lib.frame_stack_v1(e, 3, 0)),
            ("frame_stack_v2", ("Drift",), lambda lib, e: lib.frame_stack_v2(e, 3)),
            ("frame_stack_v2, Discrete", (GRID,), lambda lib, e: lib.frame_stack_v2(e, 3)),
            ("frame_stack_v2, first axis", ("Slide",), lambda lib, e: lib.frame_stack_v2(e, 3, 0)),
            ("delay", ("Drift",), lambda lib, e: lib.delay_observations_v0(e, 3)),
            ("delay, 0", ("Drift",), lambda lib, e: lib.delay_observations_v0(e, 0)),
            ("delay, pictures", ("Slide",), lambda lib, e: lib.delay_observations_v0(e, 2)),
            ("max_observation", ("Drift",), lambda lib, e: lib.max_observation_v0(e, 3)),
            ("max_observation, CartPole", ("CartPole",), lambda lib, e: lib.max_observation_v0(e, 3)),
            ("max_observation, Discrete", (GRID,), lambda lib, e: lib.max_observation_v0(e, 3)),
            ("max_observation, pictures", ("Slide",), lambda lib, e: lib.max_observation_v0(e, 2)),
            (
                "frame_skip",
                ("Drift",),
                lambda lib, e: lib.frame_skip_v0(e if lib is wrappers else LetsTheLeftAct(e), 4),
            ),
            ("frame_skip, 1", (GRID,), lambda lib, e: lib.frame_skip_v0(e, 1)),
            ("sticky_actions, never", ("Drift",), lambda lib, e: lib.sticky_actions_v0(e, 0)),
            ("agent_indicator, Discrete", (GRID,), lambda lib, e: lib.agent_indicator_v0(e)),
            ("pad_observations", ("Drift",), lambda lib, e: lib.pad_observations_v0(e)),
            ("pad_action_space", ("Drift",), lambda lib, e: lib.pad_action_space_v0(e)),
            ("clip_actions", ("Slide",), lambda lib, e: lib.clip_actions_v0(e)),
            ("clip_actions, Pendulum", ("Pendulum",), lambda lib, e: lib.clip_actions_v0(e)),
            ("normalize_obs, Pendulum", ("Pendulum",), lambda lib, e: lib.normalize_obs_v0(e)),
            # Actions as large as the space shown allows have to be clipped inside.
            (
                "scale_actions",
                ("Slide",),
                lambda lib, e: lib.scale_actions_v0(lib.clip_actions_v0(e), 0.5),
            ),
            (
                "stack of four",
                ("Drift",),
                lambda lib, e: lib.frame_stack_v1(
                    lib.clip_reward_v0(lib.normalize_obs_v0(lib.max_observation_v0(e, 2))), 3
                ),
            ),
        ]
    ],
)
def test_same_numbers(env: tuple[Any, ...], wrap: Wrap) -> None:
    ours, theirs = (wrap(library, strict(*env)) for library in (wrappers, supersuit))
    assert assert_same_play(ours, theirs) == 2 * N


def test_actions_beyond_the_bounds_are_clipped() -> None:
    ours, theirs = (library.clip_actions_v0(strict("Slide")) for library in (wrappers, supersuit))
    assert assert_same_play(ours, theirs, lambda action: action * 3) == 2 * N


def test_lambdas() -> None:
    """SuperSuit's functions take an agent's, ours the batch's."""

    def wrap(library: Any) -> Any:
        env = library.observation_lambda_v0(strict("Drift"), lambda obs, space: obs * 2 - 1)
        env = library.reward_lambda_v0(env, lambda reward: reward * 10)
        return library.action_lambda_v1(env, lambda action, space: 4 - action, lambda space: Discrete(4))

    assert assert_same_play(wrap(wrappers), wrap(supersuit)) == 2 * N


@pytest.mark.parametrize(
    "wrap", [lambda lib, e: lib.nan_zeros_v0(e), lambda lib, e: lib.nan_noop_v0(e, NOOP)]
)
def test_not_a_number(wrap: Wrap) -> None:
    ours, theirs = (wrap(library, strict("Slide")) for library in (wrappers, supersuit))
    assert assert_same_play(ours, theirs, lambda action: action if action > 0 else action * np.nan) == 2 * N


NOOP = np.array([1.25], np.float32)


def test_not_a_number_of_discrete_actions() -> None:
    for wrap in (lambda e: wrappers.nan_noop_v0(e, 2), wrappers.nan_random_v0):
        env = wrap(strict("Drift"))
        env.reset(seed=0)
        env.step(dict.fromkeys(env.agents, np.nan))
        env.step(dict.fromkeys(env.agents, 3.0))  # without one, too
        with pytest.raises(ActionError, match=r"agent_1.*0\.5"):
            env.step([np.nan, 0.5, 1, 2, 3])


def test_nan_random_is_random_for_each_agent_and_step() -> None:
    played = []

    def keep(actions: Any, space: Any) -> Any:
        played.append(actions)
        return actions

    for _ in range(2):
        env = pearl_marl.parallel_env("Drift", 200)
        env = wrappers.nan_random_v0(wrappers.action_lambda_v1(env, keep, lambda space: space))
        env.reset(seed=5)
        for _ in range(3):
            env.step_batch(np.full(200, np.nan))
    np.testing.assert_array_equal(played[:3], played[3:])
    counts = [np.bincount(actions, minlength=5) for actions in played[:3]]
    assert np.min(counts) > 20
    assert not np.array_equal(played[0], played[1])


@pytest.mark.parametrize("linear", [True, False])
@pytest.mark.parametrize("shape", [(4, 7, 3), (7, 4), (5, 5, 1), (2, 6, 4)])
@pytest.mark.parametrize("size", [(9, 3), (4, 4), (1, 11), (14, 8)])
def test_resize(shape: tuple[int, ...], size: tuple[int, int], linear: bool) -> None:
    pictures = np.random.default_rng(0).integers(256, size=(N, *shape), dtype=np.uint8)
    for dtype in (np.uint8, np.float32):
        env = strict("Slide", shape, dtype)
        ours, theirs = (library.resize_v1(env, *size, linear) for library in (wrappers, supersuit))
        assert ours.observation_space("agent_0") == theirs.observation_space("agent_0")
        resized = ours.transform.observe(pictures.astype(dtype))
        space = env.observation_space("agent_0")
        expected = [theirs_resize(picture.astype(dtype), space, (*size, linear)) for picture in pictures]
        assert resized.dtype == dtype
        if dtype is np.float32:
            np.testing.assert_allclose(resized, expected, rtol=1e-5)
        else:
            # Cut off, what is whole but for rounding can be one less.
            difference = np.abs(resized.astype(int) - np.array(expected, int))
            assert difference.max() <= 1
            assert difference.mean() < 0.05


def test_agent_indicator() -> None:
    """Ours is one element; SuperSuit's one-hot vectors are as wide as there are agents."""
    for env, shape in (
        (strict("Drift"), (4,)),
        (strict("Slide"), (4, 2, 4)),
        (strict("Slide", (4, 3)), (4, 3, 2)),
    ):
        wrapped = wrappers.agent_indicator_v0(env)
        space = wrapped.observation_space("agent_0")
        assert space.shape == shape
        assert supersuit.agent_indicator_v0(env).observation_space("agent_0").shape == (
            *shape[:-1],
            shape[-1] + N - 1,
        )
        obs, _ = wrapped.reset(seed=0)
        plain, _ = env.reset(seed=0)
        for k, agent in enumerate(env.agents):
            assert obs[agent] in space
            np.testing.assert_array_equal(obs[agent][..., -1], np.float32(k / (N - 1)))
            np.testing.assert_array_equal(obs[agent][..., :-1], plain[agent].reshape(*shape[:-1], -1))


def test_type_indicators_change_nothing() -> None:
    env = strict("Drift")
    assert wrappers.agent_indicator_v0(env, type_only=True) is env


def played(env: Any, steps: int, seed: int = 0) -> list[Any]:
    env.reset(seed=seed)
    generator = np.random.default_rng(0)
    results = []
    for _ in range(steps):
        if not env.agents:
            break
        results.append(env.step(actions_for(env, generator)))
    return results


def test_fault_black_death_is_a_step_late_and_confuses_the_flags() -> None:
    """Theirs says that all ended in a step of its own, in which nobody gets an observation."""
    ours, theirs = (
        library.black_death_v3(strict("CartPole", max_cycles=3)) for library in (wrappers, supersuit)
    )
    (*_, last), their = played(ours, 9), played(theirs, 9)
    assert len(their) == 4  # an episode of three steps
    assert not any(any(result[2].values()) for result in their[:3])
    assert not np.any(list(their[3][0].values()))
    assert len(played(ours, 9)) == 3
    assert set(last[3].values()) == {True}
    assert set(last[2].values()) == {False}
    assert set(their[3][2].values()) == {True}  # nobody terminated


def test_black_death_until_then() -> None:
    """Up to their late end the observations and rewards are the same."""
    ours, theirs = (
        library.black_death_v3(strict("Drift", max_cycles=40)) for library in (wrappers, supersuit)
    )
    mine, other = played(ours, 50), played(theirs, 50)
    assert len(mine) + 1 == len(other)
    blind = 0
    for a, b in zip(mine, other[:-1], strict=True):
        np.testing.assert_equal([dict(part) for part in a[:2]], [dict(part) for part in b[:2]])
        blind += sum(not np.any(obs) for obs in a[0].values())
    assert blind > 0


def test_fault_sticky_actions_repeat_for_all_agents_at_once() -> None:
    for library, alike in ((supersuit, True), (wrappers, False)):
        taken: list[Any] = []

        def keep(action: Any, *_: Any, taken: list[Any] = taken) -> Any:
            taken.append(action)
            return action

        env = library.action_lambda_v1(strict("Slide", max_cycles=0), keep, lambda space: space)
        env = library.sticky_actions_v0(env, 0.5)
        env.reset(seed=0)
        given = [np.full((N, 1), 0.01 * t, np.float32) for t in range(30)]
        for actions in given:
            env.step(dict(zip(env.agents, actions, strict=True)))
        # SuperSuit calls the function for every agent.
        rows = np.reshape(np.array(taken, np.float32), (30, N))
        stuck = rows != np.reshape(given, (30, N))
        assert 0.3 < stuck[1:].mean() < 0.7
        assert (stuck == stuck[:, :1]).all() == alike


def test_fault_frame_stack_shows_frames_of_the_last_episode() -> None:
    """Where agents start over by themselves, a stack begins with zeros again in ours alone."""
    ours, theirs, plain = (pearl_marl.parallel_env("Drift", N, max_cycles=3) for _ in range(3))
    ours, theirs = wrappers.frame_stack_v1(ours, 3), supersuit.frame_stack_v1(theirs, 3)
    for env in (ours, theirs, plain):
        env.reset(seed=0)
    leaks = 0
    for _ in range(3):
        actions = dict.fromkeys(plain.agents, 2)
        (obs, *_), (expected, *_), (first, _, terms, truncs, _) = (
            env.step(actions) for env in (ours, theirs, plain)
        )
        for agent in plain.agents:
            if terms[agent] or truncs[agent]:
                np.testing.assert_array_equal(obs[agent][:6], 0)
                np.testing.assert_array_equal(obs[agent][6:], first[agent])
                leaks += bool(np.any(expected[agent][:6]))
    assert leaks == N


def test_fault_frame_stack_overwrites_what_it_returned() -> None:
    for library, kept in ((supersuit, False), (wrappers, True)):
        env = library.frame_stack_v1(strict("Drift"), 2)
        before, _ = env.reset(seed=0)
        copies = {agent: obs.copy() for agent, obs in before.items()}
        env.step(dict.fromkeys(env.agents, 0))
        assert all(np.array_equal(before[agent], copies[agent]) for agent in copies) == kept


def test_fault_frame_stack_loses_flat_pictures_on_the_first_axis() -> None:
    """Theirs never writes the newest frame."""
    ours, theirs, plain = (strict("Slide", (4, 3)) for _ in range(3))
    ours, theirs = wrappers.frame_stack_v1(ours, 2, 0), supersuit.frame_stack_v1(theirs, 2, 0)
    (obs, _), (expected, _), (frame, _) = (env.reset(seed=0) for env in (ours, theirs, plain))
    for agent in plain.agents:
        assert obs[agent].shape == expected[agent].shape == (2, 4, 3)
        np.testing.assert_array_equal(obs[agent][1], frame[agent])
        np.testing.assert_array_equal(obs[agent][0], 0)
        assert not expected[agent][1].any()


def test_fault_delay_of_numbers() -> None:
    """Theirs takes arrays only, but Discrete observations are NumPy scalars."""
    theirs = supersuit.delay_observations_v0(strict(GRID), 1)
    with pytest.raises(TypeError):
        theirs.reset(seed=0)
    ours, plain = wrappers.delay_observations_v0(strict(GRID), 1), strict(GRID)
    obs, _ = ours.reset(seed=0)
    assert set(obs.values()) == {0}
    before, _ = plain.reset(seed=0)
    assert dict(ours.step(dict.fromkeys(ours.agents, 0))[0]) == dict(before)


def test_frame_skip_of_supersuit_runs_on_our_environment() -> None:
    """It draws from ``np_random``, which ``reset`` seeds."""
    runs = []
    for _ in range(2):
        env = supersuit.frame_skip_v0(LetsTheLeftAct(strict("Drift", max_cycles=30)), (1, 4))
        runs.append([sum(result[1].values()) for result in played(env, 6, seed=3)])
    assert runs[0] == runs[1]
    env = strict("Drift")
    env.reset(seed=3)
    assert env.np_random.random() == np.random.default_rng(3).random()
