"""The golden functions and the spec by themselves: forms, widths, ranges, and the oracle's spaces."""

from __future__ import annotations

from typing import Any

import gymnasium
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.batch.actions import encode, room_for_words
from pearl_marl.devices import BatchConfig, Reference
from pearl_marl.spec import EnvSpec
from pearl_marl.spec.elements import bounds
from pearl_marl.verification import sticky_actions

NEXT = AutoresetMode.NEXT_STEP


def contains_all(space: gymnasium.Space[Any], observations: Array) -> bool:
    """Check every row, as ``space.contains`` would one by one."""
    low, high = bounds(space)
    return bool(((observations >= low) & (observations <= high)).all())


class GoldenContract:
    """Tests that need no device."""

    def test_golden_functions_suit_the_spec(self, spec: EnvSpec) -> None:
        """As many words in and out as it says, all of them within their fields and the table of rewards.

        Building a spec checks the same, but for the environments of this package.
        """
        spec.check_golden(spec.functions)

    def test_observations_are_in_their_space(self, spec: EnvSpec) -> None:
        """And all words fit their fields, or the reference device refuses them.

        In ``NEXT_STEP`` mode the golden functions do all that they do in the other one, and step from ended
        states too, though nobody sees where to.
        """
        n, steps = 48, 24
        device = Reference().open(BatchConfig(spec=spec, n_envs=n, autoreset_mode=NEXT))
        assert contains_all(spec.observation_space, device.reset(seed=1))
        words = room_for_words(spec, n * spec.agents)
        for actions in sticky_actions(spec, len(words), steps, seed=2):
            step = device.step_words(encode(actions, spec, words))
            assert contains_all(spec.observation_space, step.obs[step.in_episode])
        device.close()

    def test_spaces_equal_the_oracles(self, spec: EnvSpec) -> None:
        """And names of arguments, time limit, render modes and their speed: one can stand for the other."""
        if spec.oracle is None:
            pytest.skip(f"{spec.name} has no oracle in Gymnasium")
        try:
            oracle = gymnasium.make(spec.oracle)
        except (ModuleNotFoundError, gymnasium.error.NamespaceNotFound) as error:  # of another package
            pytest.skip(str(error))
        assert spec.observation_space == oracle.observation_space
        assert spec.action_space == oracle.action_space
        # MiniGrid's games count their steps themselves.
        own_limit = getattr(oracle.unwrapped, "max_steps", None)
        assert spec.max_cycles == ((oracle.spec.max_episode_steps if oracle.spec else None) or own_limit)
        assert set(spec.render_modes) <= set(oracle.metadata["render_modes"])
        if ":" not in spec.oracle:  # it is Gymnasium's own, which says how fast it draws
            assert spec.render_fps == oracle.metadata["render_fps"]
        oracle.close()
