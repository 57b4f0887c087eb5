"""Every device against the reference device, step by step, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl.actions import encode, random_actions
from pearl_marl.devices import Device, Reference
from pearl_marl.golden import call_reference

from ..helpers import SIZE, Case, assert_same_step

MODES = (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP)
LIMITS = (0, None, 5)


def reference_for(case: Case, **config: object) -> Device:
    if case.device_name == "reference":
        pytest.skip("the reference device is what the others are compared with")
    return case.open(device=Reference(), **config)


@pytest.mark.parametrize("initial_states", ["random", "stored"])
@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)
def test_every_field_of_every_step(
    case: Case, mode: AutoresetMode, limit: int | None, initial_states: str
) -> None:
    options = {"autoreset_mode": mode, "max_cycles": limit, "initial_states": initial_states, "first_slot": 3}
    device = case.open(**options)
    reference = reference_for(case, **options)
    np.testing.assert_array_equal(device.reset(seed=11), reference.reset(seed=11))
    ends = 0
    for t, actions in enumerate(case.habits()):
        ours, theirs = device.step(actions), reference.step(actions)
        assert_same_step(ours, theirs, f"step {t}")
        np.testing.assert_array_equal(device.state(), reference.state(), f"state after step {t}")
        ends += int(theirs.ended.sum())
    if reference.config.limit:
        assert ends > SIZE, "the comparison has to see episodes end, and begin again"


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)
def test_resets_masks_and_limits_between_steps(case: Case, mode: AutoresetMode) -> None:
    device = case.open(autoreset_mode=mode, max_cycles=0)
    reference = reference_for(case, autoreset_mode=mode, max_cycles=0)
    np.testing.assert_array_equal(device.reset(seed=2**70 + 5), reference.reset(seed=2**70 + 5))
    generator = np.random.default_rng(5)
    for t, actions in enumerate(case.habits(60)):
        assert_same_step(device.step(actions), reference.step(actions), f"step {t}")
        if t % 7 == 3:
            mask = generator.random(SIZE) < 0.3
            np.testing.assert_array_equal(device.reset(mask=mask), reference.reset(mask=mask), f"mask {t}")
        if t % 20 == 10:
            np.testing.assert_array_equal(device.reset(), reference.reset(), f"unseeded reset {t}")
        if t % 15 == 9:
            limit = (6, 3, 0, 4)[t // 15]
            device.set_max_cycles(limit)
            reference.set_max_cycles(limit)
        np.testing.assert_array_equal(device.state(), reference.state(), f"state after step {t}")


def test_stored_starts_survive_masks_and_are_renewed_by_a_full_reset(case: Case) -> None:
    options = {"initial_states": "stored", "max_cycles": 4}
    device = case.open(**options)
    reference = reference_for(case, **options)
    first = device.reset(seed=1)
    np.testing.assert_array_equal(first, reference.reset(seed=1))
    for t, actions in enumerate(case.habits(13)):
        ours = device.step(actions)
        assert_same_step(ours, reference.step(actions), f"step {t}")
        np.testing.assert_array_equal(ours.obs[ours.ended], first[ours.ended])
    mask = np.arange(SIZE) % 3 == 0
    after = device.reset(mask=mask)
    np.testing.assert_array_equal(after[mask], first[mask])
    np.testing.assert_array_equal(after, reference.reset(mask=mask))
    np.testing.assert_array_equal(device.reset(), reference.reset())
    for t, actions in enumerate(case.habits(13)):
        assert_same_step(device.step(actions), reference.step(actions), f"step {t} after reset()")


def test_random_starts_differ_and_stored_ones_repeat(case: Case) -> None:
    """Without this, ``initial_states`` could be ignored wherever starts are the same anyway."""
    if not case.spec.reset_draws:
        pytest.skip(f"{case.env_id} always starts in the same state")
    starts = {}
    for how in ("random", "stored"):
        device = case.open(initial_states=how, max_cycles=1)
        observations = [device.reset(seed=0)]
        observations += [device.step(actions).obs for actions in case.actions(5)]
        starts[how] = observations
    first, *later = starts["stored"]
    assert all(np.array_equal(first, other) for other in later)
    first, *later = starts["random"]
    assert all((first != other).any() for other in later)
    np.testing.assert_array_equal(first, starts["stored"][0])


def test_golden_functions_mean_the_same_on_scalars_and_arrays(case: Case) -> None:
    """The reference runs them on arrays, cocotb and a reader on scalars."""
    spec, n = case.spec, 5
    generator = np.random.default_rng(3)

    def run(function: object, arguments: list[np.ndarray]) -> list[np.ndarray]:
        whole = call_reference(function, arguments)  # type: ignore[arg-type]
        one_by_one = [call_reference(function, [a[i] for a in arguments]) for i in range(n)]  # type: ignore[arg-type]
        for k, word in enumerate(whole):
            np.testing.assert_array_equal(np.broadcast_to(word, n), [words[k] for words in one_by_one])
        return [np.broadcast_to(word, n) for word in whole]

    def draws(count: int) -> list[np.ndarray]:
        return [generator.integers(2**32, size=n, dtype=np.uint32) for _ in range(count)]

    state = run(spec.golden.initial, draws(spec.reset_draws))
    for _ in range(20):
        actions = encode(random_actions(spec, generator, n), spec, np.empty(n, spec.action.dtype))
        *state, _reward, _terminated = run(spec.golden.step, [*state, actions, *draws(spec.step_draws)])
        run(spec.golden.observe, state)
