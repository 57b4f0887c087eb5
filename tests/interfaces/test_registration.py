"""Environments in Gymnasium's and PettingZoo's registries."""

from __future__ import annotations

import json
from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import pearl_marl
from pearl_marl.errors import ArgumentError

NAME = "Pearl/CliffWalking-v0"


class TestMakeVec:
    @pytest.mark.parametrize(
        "mode", [{}, {"vectorization_mode": "vector_entry_point"}, {"vectorization_mode": None}]
    )
    def test_makes_ours(self, mode: dict[str, Any]) -> None:
        env = gymnasium.make_vec(NAME, num_envs=3, **mode)
        assert isinstance(env, pearl_marl.PearlVectorEnv)
        assert env.num_envs == 3
        twin = pearl_marl.make_vec("CliffWalking", 3)
        np.testing.assert_array_equal(env.reset(seed=1)[0], twin.reset(seed=1)[0])
        for mine, other in zip(env.step(np.array([0, 1, 2])), twin.step([0, 1, 2]), strict=True):
            np.testing.assert_array_equal(mine, other)

    def test_arguments_are_handed_on(self) -> None:
        env = gymnasium.make_vec(NAME, 2, is_slippery=True, max_cycles=7, autoreset_mode="NextStep")
        assert isinstance(env, pearl_marl.PearlVectorEnv)
        assert env.device.config.spec.options["is_slippery"] is True
        assert env.device.config.limit == 7
        assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP

    def test_the_spec_makes_it_again(self) -> None:
        """As whoever stores how an environment was made does."""
        env = gymnasium.make_vec(NAME, 2, max_cycles=7)
        assert env.spec is not None
        text = env.spec.to_json()
        assert json.loads(text)["id"] == NAME
        again = gymnasium.make_vec(gymnasium.envs.registration.EnvSpec.from_json(text))
        assert isinstance(again, pearl_marl.PearlVectorEnv)
        assert again.num_envs == 2
        assert again.device.config.limit == 7

    def test_gymnasiums_wrappers_go_around_it(self) -> None:
        env = RecordEpisodeStatistics(gymnasium.make_vec(NAME, 2, max_cycles=3))
        env.reset(seed=0)
        for _ in range(4):
            env.step(np.zeros(2, np.int64))


@pytest.mark.parametrize(
    "make",
    [
        lambda: gymnasium.make(NAME),
        lambda: gymnasium.make(NAME, is_slippery=True, max_episode_steps=3),
        lambda: gymnasium.make_vec(NAME, 2, vectorization_mode="sync"),
    ],
)
def test_make_says_what_to_call(make: Any) -> None:
    with pytest.raises(ArgumentError) as caught:
        make()
    call = f"call gymnasium.make_vec({NAME!r}, num_envs=...), without a vectorization_mode"
    assert str(caught.value).endswith(call)
    assert "\n" not in str(caught.value)


def test_every_environment_is_there(toys: None) -> None:
    for name in ("CartPole", "Drift"):
        number = pearl_marl.get_spec(name).id
        assert gymnasium.spec(f"Pearl/{number}").vector_entry_point is not None
        assert pettingzoo.make("parallel", f"pearl/{number}").unwrapped.spec.name == name
