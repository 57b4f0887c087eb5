"""Wrappers know whose episode begins when: in every mode, after masked resets, where agents leave."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl import wrappers
from pearl_marl.batch.actions import random_actions
from pearl_marl.errors import ActionError, ArgumentError, OrderError

N = 12
STEPS = 60
Array = np.ndarray[Any, Any]


pytestmark = pytest.mark.usefixtures("toys")


def actions(name: str, steps: int = STEPS, seed: int = 0) -> Array:
    spec = pearl_marl.get_spec(name)
    flat = random_actions(spec, np.random.default_rng(seed), N * steps)
    return flat.reshape(steps, N, *flat.shape[1:])


def stack(frames: list[Array], first: Array) -> Array:
    return np.concatenate([first] * (3 - len(frames)) + frames[-3:], axis=-1)


HISTORIES: dict[str, tuple[Callable[[Any], Any], Callable[[list[Array]], Array]]] = {
    "frame_stack_v1": (
        lambda env: wrappers.frame_stack_v1(env, 3),
        lambda frames: stack(frames, np.zeros_like(frames[0])),
    ),
    "frame_stack_v2": (
        lambda env: wrappers.frame_stack_v2(env, 3),
        lambda frames: stack(frames, frames[0]),
    ),
    "delay": (
        lambda env: wrappers.delay_observations_v0(env, 2),
        lambda frames: frames[-3] if len(frames) > 2 else np.zeros_like(frames[0]),
    ),
    "max": (lambda env: wrappers.max_observation_v0(env, 3), lambda frames: np.maximum.reduce(frames[-3:])),
    "max of stack": (
        lambda env: wrappers.max_observation_v0(wrappers.frame_stack_v1(env, 3), 2),
        lambda frames: np.maximum.reduce(
            [stack(frames[: len(frames) - k], np.zeros_like(frames[0])) for k in (0, 1) if k < len(frames)]
        ),
    ),
}


@pytest.mark.parametrize("history", HISTORIES)
@pytest.mark.parametrize("name", ["Drift", "Slide"])
class TestHistories:
    """Held against each slot's own list of the frames of its episode."""

    def test_same_step(self, name: str, history: str) -> None:
        wrap, expected = HISTORIES[history]
        env, plain = (
            wrap(pearl_marl.make_vec(name, N, max_cycles=7)),
            pearl_marl.make_vec(name, N, max_cycles=7),
        )
        shown, frames = env.reset_batch(3), [[obs] for obs in plain.reset_batch(3)]
        chance = np.random.default_rng(1)
        for act in actions(name):
            if chance.random() < 0.2:
                mask = chance.random(N) < 0.3
                shown, obs = env.reset_batch(mask=mask), plain.reset_batch(mask=mask)
                frames = [[obs[i]] if mask[i] else frames[i] for i in range(N)]
                np.testing.assert_array_equal(shown, [expected(f) for f in frames])
            mine, step = env.step_batch(act), plain.step_batch(act)
            for f, arrived in zip(frames, step.arrivals(), strict=True):
                f.append(arrived)
            ended = step.ended
            finals = np.array([expected(f) for f in frames])
            np.testing.assert_array_equal(mine.final_obs[ended], finals[ended])
            np.testing.assert_array_equal(mine.arrivals(), finals)
            frames = [[step.obs[i]] if ended[i] else frames[i] for i in range(N)]
            np.testing.assert_array_equal(mine.obs, [expected(f) for f in frames])
            assert mine.obs.shape[1:] == env.single_observation_space.shape
            assert all(obs in env.single_observation_space for obs in mine.obs)

    @pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
    def test_other_modes(self, name: str, history: str, mode: str) -> None:
        wrap, expected = HISTORIES[history]
        env, plain = (pearl_marl.make_vec(name, N, max_cycles=7, autoreset_mode=mode) for _ in range(2))
        env = wrap(env)
        _, (obs, _) = env.reset(seed=3), plain.reset(seed=3)
        frames = [[o] for o in obs]
        begins = np.zeros(N, np.bool_)
        chance = np.random.default_rng(1)
        for act in actions(name):
            forced = chance.random(N) < 0.1
            if mode == "Disabled":
                forced |= begins
            if forced.any():
                (shown, _), (obs, _) = (e.reset(options={"reset_mask": forced}) for e in (env, plain))
                frames = [[obs[i].copy()] if forced[i] else frames[i] for i in range(N)]
                begins &= ~forced
                np.testing.assert_array_equal(shown, [expected(f) for f in frames])
            (shown, *_), (obs, _, terms, truncs, _) = (e.step(act) for e in (env, plain))
            frames = [[obs[i]] if begins[i] else [*frames[i], obs[i]] for i in range(N)]
            np.testing.assert_array_equal(shown, [expected(f) for f in frames])
            begins = terms | truncs

    def test_agents_that_leave(self, name: str, history: str) -> None:
        wrap, expected = HISTORIES[history]
        env, plain = (pearl_marl.parallel_env(name, N, max_cycles=9, autoreset=False) for _ in range(2))
        env = wrap(env)
        for seed in (3, None):
            _, (obs, _) = env.reset(seed=seed), plain.reset(seed=seed)
            frames = {agent: [o] for agent, o in obs.items()}
            for act in actions(name):
                if not plain.agents:
                    break
                # What an array holds for agents that left does not matter.
                act = act.astype(np.float64 if act.dtype.kind == "f" else np.int64)
                act[~plain.present] = 99
                (shown, *mine), (obs, *other) = env.step(act), plain.step(act)
                for agent, o in obs.items():
                    frames[agent].append(o)
                    np.testing.assert_array_equal(shown[agent], expected(frames[agent]))
                assert [dict(part) for part in mine] == [dict(part) for part in other]
                assert env.agents == plain.agents
            assert not env.agents
            assert env.step({}) == ({}, {}, {}, {}, {})
            with pytest.raises(OrderError, match="every episode has ended"):
                env.step(act)


def test_a_slot_that_begins_is_like_one_that_never_did_anything_else() -> None:
    """After its reset, a slot's wrapped trajectory is that of a fresh environment in the same state."""

    def wrapped() -> Any:
        env = pearl_marl.parallel_env("CliffWalking", N, max_cycles=6)
        return wrappers.max_observation_v0(wrappers.frame_stack_v1(env, 2), 3)

    old, fresh = wrapped(), wrapped()
    old.reset_batch(0)
    acts = actions("CliffWalking")
    for act in acts[:5]:
        old.step_batch(act)
    begun = old.step_batch(acts[5])  # the sixth step truncates everybody, at the only start there is
    assert begun.ended.all()
    np.testing.assert_array_equal(begun.obs, fresh.reset_batch(1))
    for act in acts[6:11]:
        np.testing.assert_array_equal(old.step_batch(act).obs, fresh.step_batch(act).obs)


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_sticky_actions(mode: str) -> None:
    """The first action of an episode is always new; others repeat at the given rate, each agent by itself."""
    taken: list[Array] = []

    def keep(act: Array, space: Any) -> Array:
        taken.append(act.copy())
        return act

    env = pearl_marl.make_vec("Drift", 300, max_cycles=4, autoreset_mode=mode)
    env = wrappers.sticky_actions_v0(wrappers.action_lambda_v1(env, keep, lambda space: space), 0.25)
    env.reset(seed=7)
    generator = np.random.default_rng(0)
    given = generator.integers(5, size=(80, 300))
    first = np.ones(300, np.bool_)
    stuck = chances = 0
    for t in range(80):
        if t % 9 == 8:
            mask = generator.random(300) < 0.5
            env.reset(options={"reset_mask": mask})
            first |= mask
            resetting = np.zeros(300, np.bool_)
        _, _, terms, truncs, _ = env.step(given[t])
        if t == 0 or mode == "SameStep":
            resetting = np.zeros(300, np.bool_)
        np.testing.assert_array_equal(taken[t][first & ~resetting], given[t][first & ~resetting])
        differs = given[t] != taken[t]
        np.testing.assert_array_equal(taken[t][differs], taken[t - 1][differs])
        able = ~first & ~resetting & (given[t] != taken[t - 1])
        stuck, chances = stuck + int(differs[able].sum()), chances + int(able.sum())
        ended = terms | truncs
        # In NEXT_STEP mode an episode's first action is the one after the step that resets.
        first, resetting = (ended, resetting) if mode == "SameStep" else (resetting, ended)
    assert abs(stuck / chances - 0.25) < 0.02


def test_wrappers_draw_independently() -> None:
    """Of each other, and from step to step; the same seed gives the same draws."""

    def draws(seed: int | None) -> list[Array]:
        env = pearl_marl.parallel_env("Drift", 2000)
        inner = wrappers.sticky_actions_v0(env, 0.5)
        outer = wrappers.sticky_actions_v0(inner, 0.5)
        outer.reset_batch(seed)
        result = [inner.transform.draws(), outer.transform.draws()]
        outer.step_batch(np.zeros(2000, np.uint8))
        outer.reset_batch()
        return [*result, inner.transform.draws()]

    all_draws = [*draws(1), *draws(2), *draws(None), *draws(None)]
    correlations = np.corrcoef(np.array(all_draws, np.float64))
    np.fill_diagonal(correlations, 0)
    assert np.abs(correlations).max() < 0.12
    np.testing.assert_array_equal(draws(1), all_draws[:3])


class TestFrameSkip:
    @pytest.mark.parametrize("inside", [lambda env: env, lambda env: wrappers.frame_stack_v1(env, 2)])
    @pytest.mark.parametrize("name", ["Drift", "Slide"])
    def test_against_single_steps(self, name: str, inside: Any) -> None:
        """A slot acts until its episode ends, and the next one begins with the step after."""
        env, plain = (inside(pearl_marl.make_vec(name, N, max_cycles=6)) for _ in range(2))
        env = wrappers.frame_skip_v0(env, 4)
        np.testing.assert_array_equal(env.reset_batch(1), plain.reset_batch(1))
        ends = 0
        for act in actions(name):
            mine = env.step_batch(act)
            rewards, over = np.zeros(N, np.float32), np.zeros(N, np.bool_)
            for _ in range(4):
                step = plain.step_batch(act)
                rewards[~over] += step.rewards[~over]
                now = step.ended & ~over
                for flags, theirs in (
                    (mine.terminations, step.terminations),
                    (mine.truncations, step.truncations),
                ):
                    np.testing.assert_array_equal(flags[now], theirs[now])
                np.testing.assert_array_equal(mine.final_obs[now], step.final_obs[now])
                over |= now
                if over.all():
                    break
            obs = step.obs
            if over.any():
                obs = plain.reset_batch(mask=over)
            np.testing.assert_array_equal(mine.rewards, rewards)
            np.testing.assert_array_equal(mine.ended, over)
            np.testing.assert_array_equal(mine.obs, obs)
            ends += over.sum()
        assert ends > N

    def test_random_numbers_of_frames(self) -> None:
        env = wrappers.frame_skip_v0(pearl_marl.parallel_env("CliffWalking", 3, max_cycles=0), (2, 5))
        counts = []
        for _ in range(2):
            env.reset(seed=0)
            counts.append([-int(env.step_batch(np.zeros(3, np.uint8)).rewards[0]) for _ in range(60)])
        assert counts[0] == counts[1]
        assert set(counts[0]) == {2, 3, 4, 5}

    def test_refused(self) -> None:
        with pytest.raises(ArgumentError, match="NEXT_STEP"):
            wrappers.frame_skip_v0(pearl_marl.make_vec("Drift", 3, autoreset_mode="NextStep"), 2)
        for bad in (0, 1.5, True, (3, 2), (0, 4), (1, 2, 3), [1, 2]):
            with pytest.raises(ArgumentError, match="num_frames"):
                wrappers.frame_skip_v0(pearl_marl.parallel_env("Drift", 3), bad)


class TestBlackDeath:
    def test_flags_come_once_all_have_ended(self) -> None:
        env, plain = (pearl_marl.parallel_env("Drift", N, autoreset=False, max_cycles=20) for _ in range(2))
        env = wrappers.black_death_v3(env)
        for seed in (2, None):
            env.reset(seed=seed)
            plain.reset(seed=seed)
            flags: dict[str, Any] = {}
            for act in actions("Drift"):
                here = plain.agents
                expected = plain.step({agent: act[int(agent[6:])] for agent in here})
                flags |= {agent: (expected[2][agent], expected[3][agent]) for agent in here}
                obs, rewards, terms, truncs, infos = env.step(dict(zip(env.agents, act, strict=True)))
                for k, agent in enumerate(env.possible_agents):
                    there = agent in here
                    np.testing.assert_array_equal(obs[agent], expected[0][agent] if there else np.zeros(3))
                    assert rewards[agent] == (expected[1][agent] if there else 0)
                    assert infos[agent] == {}
                    assert obs[agent] in env.observation_space(agent), k
                if not plain.agents:
                    break
                assert env.agents == env.possible_agents
                assert not any(terms.values())
                assert not any(truncs.values())
            assert {agent: (terms[agent], truncs[agent]) for agent in terms} == flags
            assert len(set(flags.values())) > 1
            assert env.agents == []
            with pytest.raises(OrderError, match="no agent left"):
                env.step_batch(act)

    def test_refused_where_nobody_dies(self) -> None:
        for env in (pearl_marl.parallel_env("Drift", 2), pearl_marl.make_vec("Drift", 2)):
            with pytest.raises(ArgumentError, match="autoreset=False"):
                wrappers.black_death_v3(env)

    def test_histories_around_it(self) -> None:
        env = pearl_marl.parallel_env("Drift", N, autoreset=False, max_cycles=20)
        env = wrappers.frame_stack_v1(wrappers.black_death_v3(env), 2)
        before = env.reset_batch(seed=0)[:, 3:]
        for act in actions("Drift"):
            obs, *_ = env.step(act)
            np.testing.assert_array_equal(obs.array[:, :3], before)
            before = obs.array[:, 3:].copy()
            if not env.agents:
                break
        assert (before == 0).all(1).any()


REFUSED = {
    "frame_stack": lambda env: wrappers.frame_stack_v1(env, 2),
    "max": lambda env: wrappers.max_observation_v0(env, 3),
    "sticky": lambda env: wrappers.sticky_actions_v0(env, 0.5),
    "frame_skip": lambda env: wrappers.frame_skip_v0(env, (1, 3)),
    "nan_random": wrappers.nan_random_v0,
    "action_lambda": lambda env: wrappers.action_lambda_v1(env, lambda a, s: 4 - a, lambda s: s),
    "normalized": lambda env: wrappers.normalize_observation_v0(wrappers.normalize_reward_v0(env)),
    "all": lambda env: wrappers.frame_stack_v1(
        wrappers.frame_skip_v0(wrappers.sticky_actions_v0(wrappers.nan_random_v0(env), 0.5), (1, 3)), 3
    ),
}


@pytest.mark.parametrize("wrap", REFUSED.values(), ids=REFUSED)
@pytest.mark.parametrize("make", [pearl_marl.parallel_env, pearl_marl.make_vec])
def test_refused_actions_change_nothing(wrap: Any, make: Any) -> None:
    env, twin = (wrap(make("Drift", N, max_cycles=6)) for _ in range(2))
    for e in (env, twin):
        with pytest.raises(OrderError, match="before reset"):
            e.step_batch(np.zeros(N, np.int64))
        e.reset_batch(4)
    good = actions("Drift", 20)
    too_large = np.zeros(N, np.int64)
    too_large[5] = 7
    for t, act in enumerate(good):
        for bad, words in (
            (
                too_large,
                "agent_5: action 7 is out of range" if wrap is not REFUSED["action_lambda"] else "agent_5",
            ),
            (np.zeros(N - 1, np.int64), r"\(11,\)"),
            (np.zeros((N, 1), np.int64), r"\(12, 1\)"),
            ([0] * (N - 1) + [[1]], "agent_11"),
            ([0.5] * N, "agent_0"),
            (["left"] * N, "agent_0"),
            (None, "shape"),
            (np.nan, "shape"),
        ):
            with pytest.raises(ActionError, match=words):
                env.step_batch(bad)
        if t == 10 and make is pearl_marl.parallel_env:
            with pytest.raises(ActionError, match="agent_11"):
                env.step({f"agent_{i}": 0 for i in range(N - 1)})
        for mine, other in zip(env.step_batch(act), twin.step_batch(act), strict=True):
            np.testing.assert_array_equal(mine, other)


def test_not_a_number_passes_wrappers_around() -> None:
    """Discrete actions are integers, but where a wrapper inside takes NaN, those around let it through."""
    env = wrappers.nan_noop_v0(pearl_marl.parallel_env("Drift", N), 1)
    env = wrappers.frame_stack_v1(wrappers.sticky_actions_v0(env, 0), 2)
    env.reset(seed=0)
    with pytest.raises(ActionError, match=r"agent_0.*0\.5"):
        env.step_batch(np.full(N, 0.5))
    env.step({agent: float("nan") for agent in env.agents})


def test_sticky_actions_let_those_through_that_are_clipped_inside() -> None:
    env = wrappers.clip_actions_v0(pearl_marl.parallel_env("Slide", N))
    env = wrappers.sticky_actions_v0(env, 0.5)
    env.reset(seed=0)
    for t in range(5):
        env.step_batch(np.full((N, 1), 4.0 + t))
    with pytest.raises(ActionError, match="agent_3"):
        env.step_batch([[1.0]] * 3 + [[np.nan]] * 9)


def test_sticky_actions_do_not_remember_what_was_refused_inside() -> None:
    """The environment takes none of the actions, though this wrapper found them possible."""
    env, twin = (
        wrappers.sticky_actions_v0(
            wrappers.action_lambda_v1(pearl_marl.parallel_env("Drift", N), lambda a, s: a * 3, lambda s: s),
            0.5,
        )
        for _ in range(2)
    )
    for e in (env, twin):
        e.reset(seed=0)
        e.step_batch([0] * N)
    for t in range(10):
        with pytest.raises(ActionError, match="action 12"):
            env.step_batch([4] * N)
        act = [t % 2] * N
        for mine, other in zip(env.step_batch(act), twin.step_batch(act), strict=True):
            np.testing.assert_array_equal(mine, other)


@pytest.mark.parametrize(
    "wrap",
    [
        lambda env: wrappers.sticky_actions_v0(env, 0.5),
        lambda env: wrappers.action_lambda_v1(env, lambda a, s: np.arange(5)[a], lambda s: s),
        lambda env: wrappers.nan_noop_v0(env, 1),
    ],
)
def test_actions_of_agents_that_left_are_ignored(wrap: Any) -> None:
    env, twin = (wrap(pearl_marl.parallel_env("Drift", N, autoreset=False)) for _ in range(2))
    env.reset(seed=0)
    twin.reset(seed=0)
    for act in actions("Drift"):
        given = act.astype(np.int64)
        given[~env.unwrapped.present] = 99
        mine, other = env.step(given), twin.step({agent: act[int(agent[6:])] for agent in twin.agents})
        np.testing.assert_equal([dict(part) for part in mine], [dict(part) for part in other])
        if not env.agents:
            return
