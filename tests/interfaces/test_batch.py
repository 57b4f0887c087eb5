"""What wrappers and bridges know of an environment, in all of its forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from pearl_marl.wrappers import black_death_v3, clip_reward_v0, frame_stack_v1

import pearl_marl
from pearl_marl.errors import ActionError, OrderError
from pearl_marl.interfaces.batch import Batch

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
    batch: Batch = env
    assert batch.batch_size == N
    assert batch.slot_autoreset_mode is mode
    assert batch.autoreset is autoreset
    assert batch.slot_action_space == pearl_marl.get_spec("Drift").action_space
    assert not batch.ready
    obs = env.reset_batch(0)
    assert batch.ready
    assert batch.live.tolist() == [True] * N
    assert all(one in batch.slot_observation_space for one in obs)
    assert batch.step_batch([0] * N).obs.shape == obs.shape
    mask = np.arange(N) == 2
    assert batch.reset_slots(mask).shape == obs.shape
    env.close()
    assert not batch.ready


class TestWhoIsThere:
    def test_nobody_before_the_first_reset(self) -> None:
        env = parallel(autoreset=False)
        assert not env.live.any()
        assert env.agents == []

    @pytest.mark.parametrize("wrap", [lambda env: env, clip_reward_v0])
    def test_another_array_whenever_somebody_leaves(self, wrap: Any) -> None:
        env = wrap(parallel(autoreset=False, max_cycles=20))
        env.reset_batch(0)
        leaving = 0
        while env.agents:
            before, content, here = env.live, env.live.copy(), env.agents
            env.step_batch([4] * N)
            np.testing.assert_array_equal(before, content)
            assert (env.live is before) == (env.agents == here)
            assert env.agents == [agent for agent in here if env.live[env.slots[agent]]]
            leaving += env.live is not before
        assert leaving

    def test_a_transform_may_say_otherwise(self) -> None:
        env = black_death_v3(parallel(autoreset=False, max_cycles=20))
        around = clip_reward_v0(env)
        around.reset_batch(0)
        while env.unwrapped.live.any():
            assert around.live.all()
            assert around.agents == env.possible_agents
            around.step_batch([4] * N)
        assert not around.live.any()
        assert around.agents == env.agents == []
        with pytest.raises(OrderError, match="no agent left"):
            around.step_batch([4] * N)


class TestActionsOfThoseWhoLeft:
    """Every way in takes anything for them, and refuses what is wrong for those who are there."""

    def gone(self) -> tuple[Any, int, int]:
        env = parallel(autoreset=False, max_cycles=0)
        env.reset_batch(0)
        while env.live.all():
            env.step_batch([4] * N)
        return env, int(np.argmin(env.live)), int(np.argmax(env.live))

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
        filled = env.filled(actions)
        assert filled.dtype == np.uint8
        assert not filled.any()
        assert actions[gone] == 200, "what was given is not written into"
