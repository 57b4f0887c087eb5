"""The golden functions and the spec by themselves: forms, widths, ranges, and the oracle's spaces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, Tuple
from gymnasium.vector import AutoresetMode

from pearl_marl import rng
from pearl_marl.batch.actions import encode, random_actions
from pearl_marl.devices import BatchConfig, Reference
from pearl_marl.golden import call_reference
from pearl_marl.spec import EnvSpec
from pearl_marl.testing.case import Array, by_mode
from pearl_marl.verification import sticky_actions


def contains_all(space: gymnasium.Space[Any], observations: Array) -> bool:
    """Check every row, as ``space.contains`` would one by one."""
    if isinstance(space, Tuple):
        return all(map(contains_all, space.spaces, observations.T))
    if isinstance(space, Discrete):
        return bool(((observations >= space.start) & (observations < space.start + space.n)).all())
    assert isinstance(space, Box)
    return bool(((observations >= space.low) & (observations <= space.high)).all())


class GoldenContract:
    """Tests that need no device."""

    def test_golden_functions_mean_the_same_on_scalars_and_arrays(self, spec: EnvSpec) -> None:
        """The reference runs them on arrays, cocotb and a reader on scalars."""
        n, generator = 5, np.random.default_rng(3)

        def run(function: Callable[..., Any], arguments: list[Array]) -> list[Array]:
            whole = [np.broadcast_to(word, n) for word in call_reference(function, arguments)]
            one_by_one = [call_reference(function, [a[i] for a in arguments]) for i in range(n)]
            for k, word in enumerate(whole):
                np.testing.assert_array_equal(word, [words[k] for words in one_by_one])
            return whole

        def draws(count: int) -> list[Array]:
            return [generator.integers(2**32, size=n, dtype=np.uint32) for _ in range(count)]

        state = run(spec.golden.initial, draws(spec.reset_draws))
        for _ in range(20):
            actions = encode(random_actions(spec, generator, n), spec, np.empty(n, spec.action.dtype))
            *state, _, _ = run(spec.golden.step, [*state, actions, *draws(spec.step_draws)])
            run(spec.golden.observe, state)

    def test_golden_functions_take_what_the_spec_says(self, spec: EnvSpec) -> None:
        """As many words in, as many out; and no other dtype than the field's."""
        draws = [np.uint32(d) for d in rng.draws(rng.seed_words(0), np.arange(spec.reset_draws), 0, 0)]
        state = call_reference(spec.golden.initial, draws)
        assert len(state) == len(spec.state), "initial() returns the fields of the state"
        state = tuple(field.dtype.type(word) for field, word in zip(spec.state, state, strict=True))
        more = [np.uint32(7)] * spec.step_draws
        results = call_reference(spec.golden.step, [*state, spec.action.dtype.type(0), *more])
        assert len(results) == len(spec.state) + 2, "step() returns the state, a reward, and terminated"
        observed = call_reference(spec.golden.observe, state)
        assert len(observed) == len(spec.observation), "observe() returns the fields of the observation"

    @by_mode
    def test_words_fit_their_fields(self, spec: EnvSpec, mode: AutoresetMode) -> None:
        """Hardware would lose the bits beyond; the reference device refuses them.

        In ``NEXT_STEP`` mode it steps from ended states too, though nobody sees where to.
        """
        n, steps = 256, 80
        device = Reference().open(BatchConfig(spec=spec, n_envs=n, autoreset_mode=mode))
        assert contains_all(spec.observation_space, device.reset(seed=1))
        for actions in sticky_actions(spec, n, steps, seed=2):
            assert contains_all(spec.observation_space, device.step(actions).obs)
        device.close()

    def test_rewards_are_in_the_table(self, spec: EnvSpec) -> None:
        """A category that the table does not have would be worth 0."""
        if spec.rewards is None:
            pytest.skip(f"{spec.name} computes its rewards")
        n, tick = 256, 0
        slots, seed = np.arange(n), rng.seed_words(4)

        def draws(first: int, count: int) -> list[Array]:
            return [rng.draws(seed, slots, tick, first + k) for k in range(count)]

        def columns(words: tuple[Array, ...]) -> list[Array]:
            return [np.broadcast_to(w, n).astype(f.dtype) for w, f in zip(words, spec.state, strict=True)]

        state = columns(call_reference(spec.golden.initial, draws(0, spec.reset_draws)))
        for given in sticky_actions(spec, n, 120, seed=5):
            actions = encode(given, spec, np.empty(n, spec.action.dtype))
            tick += 1
            step_draws = draws(spec.reset_draws, spec.step_draws)
            *words, reward, terminated = call_reference(spec.golden.step, [*state, actions, *step_draws])
            assert np.max(reward) < len(spec.rewards)
            assert np.isin(terminated, (0, 1)).all(), "terminated is 0 or 1"
            begun = columns(call_reference(spec.golden.initial, draws(0, spec.reset_draws)))
            ended = np.broadcast_to(terminated, n).astype(bool)
            state = [np.where(ended, a, b) for a, b in zip(begun, columns(tuple(words)), strict=True)]

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
