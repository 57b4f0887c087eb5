"""The golden functions and the spec by themselves: forms, widths, ranges, and the oracle's spaces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.actions import encode, random_actions, room_for_words
from pearl_marl.devices import BatchConfig, Reference
from pearl_marl.elements import bounds
from pearl_marl.golden import call_reference
from pearl_marl.spec import EnvSpec
from pearl_marl.testing.case import Array, by_mode
from pearl_marl.verification import sticky_actions


def contains_all(space: gymnasium.Space[Any], observations: Array) -> bool:
    """Check every row, as ``space.contains`` would one by one."""
    low, high = bounds(space)
    return bool(((observations >= low) & (observations <= high)).all())


class GoldenContract:
    """Tests that need no device."""

    def test_golden_functions_mean_the_same_on_scalars_and_arrays(self, spec: EnvSpec) -> None:
        """The reference runs them on arrays, cocotb and a reader on scalars."""
        n, generator = 5, np.random.default_rng(3)

        def run(function: Callable[..., Any], arguments: list[Array], *agent: int) -> list[Array]:
            whole = [np.broadcast_to(word, n) for word in call_reference(function, arguments, *agent)]
            one_by_one = [call_reference(function, [a[i] for a in arguments], *agent) for i in range(n)]
            for k, word in enumerate(whole):
                np.testing.assert_array_equal(word, [words[k] for words in one_by_one])
            return whole

        def draws(count: int) -> list[Array]:
            return [generator.integers(2**32, size=n, dtype=np.uint32) for _ in range(count)]

        state = run(spec.positional.initial, draws(spec.reset_draws))
        for _ in range(20):
            words = room_for_words(spec, n * spec.agents)
            actions = encode(random_actions(spec, generator, len(words)), spec, words).reshape(n, -1).T
            state = run(spec.positional.step, [*state, *actions, *draws(spec.step_draws)])[: len(spec.state)]
            for agent in spec.views:
                for view in spec.functions[2:]:
                    run(view, state, *agent)

    def test_golden_functions_suit_the_spec(self, spec: EnvSpec) -> None:
        """As many words in and out as it says, all of them within their fields and the table of rewards.

        Building a spec checks the same, but for the environments of this package.
        """
        spec.check_golden(spec.golden)

    @by_mode
    def test_observations_are_in_their_space(self, spec: EnvSpec, mode: AutoresetMode) -> None:
        """And all words fit their fields, or the reference device refuses them.

        In ``NEXT_STEP`` mode it steps from ended states too, though nobody sees where to.
        """
        n, steps = 256, 80
        device = Reference().open(BatchConfig(spec=spec, n_envs=n, autoreset_mode=mode))
        assert contains_all(spec.observation_space, device.reset(seed=1))
        words = room_for_words(spec, n * spec.agents)
        for actions in sticky_actions(spec, len(words), steps, seed=2):
            step = device.step_words(encode(actions, spec, words))
            assert contains_all(spec.observation_space, step.obs[step.alive])
        device.close()

    def test_spaces_equal_the_oracles(self, spec: EnvSpec) -> None:
        """With the same names of arguments and the same time limit, one can stand for the other."""
        if spec.oracle is None:
            pytest.skip(f"{spec.name} has no oracle in Gymnasium")
        try:
            oracle = gymnasium.make(spec.oracle)
        except (ModuleNotFoundError, gymnasium.error.NamespaceNotFound) as error:  # of another package
            pytest.skip(str(error))
        assert spec.observation_space == oracle.observation_space
        assert spec.action_space == oracle.action_space
        assert spec.max_cycles == (oracle.spec.max_episode_steps if oracle.spec else None)
        oracle.close()
