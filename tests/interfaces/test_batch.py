"""What wrappers and bridges know of an environment, in all of its forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl.errors import ActionError, ArgumentError, OrderError
from pearl_marl.interfaces.batch import Batch
from pearl_marl.wrappers import black_death_v3, clip_reward_v0, frame_skip_v0, frame_stack_v1
from pearl_marl.wrappers.transform import Transform

pytestmark = pytest.mark.usefixtures("toys")

N = 6


def parallel(**arguments: Any) -> Any:
    return pearl_marl.parallel_env("Drift", N, **arguments)


def vector(mode: str) -> Any:
    return pearl_marl.make_vec("Drift", N, autoreset_mode=mode)


FORMS: dict[str, tuple[Any, AutoresetMode, bool]] = {
    "parallel": (parallel, AutoresetMode.SAME_STEP, True),
    "agents leave": (lambda: parallel(autoreset=False), AutoresetMode.SAME_STEP, False),
    "same step": (lambda: vector("SameStep"), AutoresetMode.SAME_STEP, True),
    "next step": (lambda: vector("NextStep"), AutoresetMode.NEXT_STEP, True),
    "disabled": (lambda: vector("Disabled"), AutoresetMode.SAME_STEP, False),
}


@pytest.mark.parametrize("wrap", [lambda env: env, lambda env: frame_stack_v1(clip_reward_v0(env), 2)])
@pytest.mark.parametrize(("make", "mode", "autoreset"), FORMS.values(), ids=FORMS)
def test_members(make: Any, mode: AutoresetMode, autoreset: bool, wrap: Any) -> None:
    env = wrap(make())
    batch: Batch = env.batch
    assert batch.batch_size == N
    assert batch.slot_autoreset_mode is mode
    assert batch.autoreset is autoreset
    assert batch.action_space == pearl_marl.get_spec("Drift").action_space
    assert not batch.ready
    obs = env.reset_batch(0)
    assert batch.ready
    assert batch.present.tolist() == [True] * N
    assert all(one in batch.observation_space for one in obs)
    assert batch.step_batch([0] * N).obs.shape == obs.shape
    mask = np.arange(N) == 2
    assert batch.reset_slots(mask).shape == obs.shape
    env.close()
    assert not batch.ready


@pytest.mark.parametrize("make", [parallel, lambda: vector("SameStep")])
def test_what_moved_to_the_batch_is_still_found(make: Any) -> None:
    env = make()
    with pytest.warns(DeprecationWarning, match="world of an environment is now batch.world"):
        assert env.world is env.batch.world
    with pytest.raises(AttributeError, match=f"'{type(env).__name__}' object has no attribute 'worlds'"):
        _ = env.worlds


class TestWhoIsThere:
    def test_nobody_before_the_first_reset(self) -> None:
        env = parallel(autoreset=False)
        assert not env.present.any()
        assert env.agents == []

    @pytest.mark.parametrize("wrap", [lambda env: env, clip_reward_v0])
    def test_another_array_whenever_somebody_leaves(self, wrap: Any) -> None:
        env = wrap(parallel(autoreset=False, max_cycles=20))
        env.reset_batch(0)
        leaving = 0
        while env.agents:
            before, content, here = env.present, env.present.copy(), env.agents
            env.step_batch([4] * N)
            np.testing.assert_array_equal(before, content)
            assert (env.present is before) == (env.agents == here)
            assert env.agents == [agent for agent in here if env.present[env.rows[agent]]]
            leaving += env.present is not before
        assert leaving

    def test_a_transform_may_say_otherwise(self) -> None:
        env = black_death_v3(parallel(autoreset=False, max_cycles=20))
        around = clip_reward_v0(env)
        around.reset_batch(0)
        while env.unwrapped.present.any():
            assert around.present.all()
            assert around.agents == env.possible_agents
            around.step_batch([4] * N)
        assert not around.present.any()
        assert around.agents == env.agents == []
        with pytest.raises(OrderError, match="no agent left"):
            around.step_batch([4] * N)


def test_names_of_before_warn() -> None:
    env = parallel()
    env.reset_batch(0)
    step = env.step_batch([0] * N)
    for of, old, new in (
        *((env, "live", "present"), (env, "alive", "in_episode"), (env, "slots", "rows")),
        *((env.batch, "live", "present"), (step, "alive", "in_episode"), (env.device, "alive", "in_episode")),
    ):
        with pytest.warns(DeprecationWarning, match=f"{old} is now {new}"):
            value = getattr(of, old)
        np.testing.assert_array_equal(value, getattr(of, new))
    with pytest.warns(DeprecationWarning, match="Early.live is now present"):

        class Early(Transform):
            live = np.zeros(N, np.bool_)

    assert Early.present is Early.live


@pytest.mark.parametrize("actions", [[None] * N, np.full(N, None), [[1, 2], *[0] * (N - 1)]])
def test_what_is_ignored_may_be_anything(actions: Any) -> None:
    rules = parallel().batch.action_rules
    every = np.ones(N, np.bool_)
    assert list(rules.with_idle(actions, every)) == [0] * N
    assert rules.with_idle(None, every) is None
    assert rules.with_idle(actions[1:], every) is not None, "as it is, to be refused"


class TestActionsOfThoseWhoLeft:
    """Every way in takes anything for them, and refuses what is wrong for those who are there."""

    def gone(self) -> tuple[Any, int, int]:
        env = parallel(autoreset=False, max_cycles=0)
        env.reset_batch(0)
        while env.present.all():
            env.step_batch([4] * N)
        return env, int(np.argmin(env.present)), int(np.argmax(env.present))

    @pytest.mark.parametrize("step", [lambda e, a: e.step(a), lambda e, a: e.step_batch(a)])
    def test_step(self, step: Any) -> None:
        env, gone, here = self.gone()
        actions = np.zeros(N, np.int64)
        actions[gone] = -3
        step(env, actions)
        actions[here] = 9
        with pytest.raises(ActionError, match=f"agent_{here}: action 9"):
            step(env, actions)

    def test_send(self) -> None:
        env, gone, here = self.gone()
        actions = np.zeros(N, np.int64)
        actions[gone] = -3
        env.send(actions)
        env.recv()
        actions[here] = 9
        with pytest.raises(ActionError, match=f"agent_{here}: action 9"):
            env.send(actions)

    def test_words_stay_words(self) -> None:
        """A device's own dtype costs least, and is handed on as it is."""
        env, gone, _ = self.gone()
        actions = np.zeros(N, np.uint8)
        actions[gone] = 200
        filled = env.batch.filled(actions)
        assert filled.dtype == np.uint8
        assert not filled.any()
        assert actions[gone] == 200, "what was given is not written into"


class TestResettingSome:
    """A world that is reset is there again, though some had left it."""

    @staticmethod
    def played(k: int, wrap: Any) -> tuple[Any, Any]:
        """An environment of strict lifetimes in whose first and last world everybody has left, and a twin."""
        name = "CoinGame" if k == 2 else "MountainCar"
        limit = {"num_inner_steps": 1, "num_outer_steps": 3} if k == 2 else {"max_cycles": 3}
        envs = [wrap(pearl_marl.parallel_env(name, 3 * k, autoreset=auto, **limit)) for auto in (False, True)]
        for env in envs:
            env.reset(seed=1)
            env.step(np.zeros(3 * k, np.int64))
            env.reset_slots(np.array([False, True, False]))
            for _ in range(2):
                env.step(np.zeros(3 * k, np.int64))
        assert envs[0].agents == [f"agent_{i}" for i in range(k, 2 * k)]
        return tuple(envs)  # type: ignore[return-value]

    @pytest.mark.parametrize("wrap", [lambda env: env, lambda env: frame_stack_v1(clip_reward_v0(env), 2)])
    @pytest.mark.parametrize("k", [1, 2])
    def test_agents_that_left_are_back(self, k: int, wrap: Any) -> None:
        env, twin = self.played(k, wrap)
        before = env.present
        first = np.array([True, False, False])
        obs = env.reset_slots(first)
        assert before.tolist() == [False] * k + [True] * k + [False] * k
        assert env.agents == [f"agent_{i}" for i in range(2 * k)]
        np.testing.assert_array_equal(obs[: 2 * k], twin.reset_slots(first)[: 2 * k])
        ended = []
        for _ in range(3):
            actions = dict.fromkeys(env.agents, 0)
            observations, rewards, terminations, truncations, _ = env.step(actions)
            step = twin.step_batch(np.zeros(3 * k, np.int64))
            here = [env.rows[agent] for agent in actions]
            assert list(observations) == list(actions)
            np.testing.assert_array_equal(observations.array, step.arrivals()[here])
            np.testing.assert_array_equal(rewards.array, step.rewards[here])
            np.testing.assert_array_equal(truncations.array, step.truncations[here])
            ended += [agent for agent in actions if truncations[agent] or terminations[agent]]
        assert sorted(ended) == [f"agent_{i}" for i in range(2 * k)]
        assert env.agents == []

    def test_after_everybody_has_left(self) -> None:
        env = parallel(autoreset=False, max_cycles=2)
        env.reset(seed=1)
        for _ in range(2):
            env.step([2] * N)
        assert env.agents == []
        env.reset_slots(np.arange(N) == 4)
        assert env.agents == ["agent_4"]
        assert list(env.step({"agent_4": 2})[0]) == ["agent_4"]
        saved = env.save_state()
        other = parallel(autoreset=False, max_cycles=2)
        other.load_state(saved)
        assert other.agents == ["agent_4"]

    def test_a_refused_mask_brings_nobody_back(self) -> None:
        env = parallel(autoreset=False, max_cycles=1)
        env.reset(seed=1)
        env.step([2] * N)
        for mask in (None, [True], np.ones(N)):
            with pytest.raises(ArgumentError):
                env.reset_slots(mask)
        assert env.agents == []

    def test_black_death_forgets_the_ends_of_those_alone(self) -> None:
        env = black_death_v3(parallel(autoreset=False, max_cycles=3))
        env.reset(seed=1)
        env.step([2] * N)
        env.reset_slots(np.arange(N) == 0)
        for _ in range(2):
            env.step([2] * N)  # which ends all but the first
        env.reset_slots(np.arange(N) == 1)
        _, _, _, truncations, _ = env.step([2] * N)
        assert not any(truncations.values())
        for _ in range(2):
            _, _, _, truncations, _ = env.step([2] * N)
        assert all(truncations.values())

    def test_skipping_frames_brings_nobody_back(self) -> None:
        env = frame_skip_v0(parallel(autoreset=False, max_cycles=3), 2)
        env.reset(seed=1)
        env.reset_slots(np.arange(N) < 0)
        inside = env.env
        inside.step([2] * N)
        inside.reset_slots(np.arange(N) == 0)
        env.step([2] * N)
        assert inside.agents == env.agents == ["agent_0"]

    @pytest.mark.parametrize("wrap", [lambda env: env, clip_reward_v0])
    @pytest.mark.parametrize("call", ["reset_slots", "reset_batch", "reset"])
    def test_who_was_reset_waits_no_more(self, call: str, wrap: Any) -> None:
        """In DISABLED mode, whichever call it was."""
        env, twin = (
            wrap(pearl_marl.make_vec("Drift", N, autoreset_mode="Disabled", max_cycles=2)) for _ in "ab"
        )
        for one in (env, twin):
            one.reset(seed=1)
            one.step([2] * N)
            one.step([2] * N)
        some = np.arange(N) == 1
        for mask in (some, ~some):
            with pytest.raises(OrderError, match="has ended and was not reset"):
                env.step([2] * N)
            shown, _ = twin.reset(options={"reset_mask": mask})
            if call == "reset":
                np.testing.assert_array_equal(env.reset(options={"reset_mask": mask})[0], shown)
            elif call == "reset_batch":
                np.testing.assert_array_equal(env.reset_batch(mask=mask)[mask], shown[mask])
            else:
                np.testing.assert_array_equal(env.reset_slots(mask)[mask], shown[mask])
        np.testing.assert_array_equal(env.step([2] * N)[0], twin.step([2] * N)[0])
