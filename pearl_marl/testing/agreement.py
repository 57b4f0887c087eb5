"""A device against the reference device, step by step, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl.devices import Device, Lockstep, Reference
from pearl_marl.testing.case import SIZE, STEPS, Case, assert_same_step, by_mode
from pearl_marl.verification import runs, verify


def reference_for(case: Case, **config: Any) -> Device:
    """Return the reference device, open; skip the test if it would be compared with itself."""
    if case.device_name == "reference":
        pytest.skip("the reference device is what the others are compared with")
    return case.open(device=Reference(), **config)


class AgreementContract:
    """Tests of what a device computes."""

    @by_mode
    def test_lockstep_with_the_reference(self, case: Case, mode: AutoresetMode) -> None:
        """As ``pearl verify`` does; its error names step, slot and field of the first word that differs."""
        if case.device_name in ("reference", "lockstep"):
            pytest.skip(f"the {case.device_name} device holds nothing against itself")
        plan = runs(case.spec, SIZE * case.spec.agents, 2 * STEPS, mode)
        for run in plan:
            for _ in verify(run, Lockstep(case.device(), "reference"), seed=3):
                pass
            assert run.exact
            assert run.words > SIZE * STEPS
        assert sum(run.episodes for run in plan) > SIZE, "the comparison has to see episodes end"

    @pytest.mark.parametrize(("limit", "initial_states"), [(None, "random"), (5, "stored")])
    @by_mode
    def test_every_field_of_every_step(
        self, case: Case, mode: AutoresetMode, limit: int | None, initial_states: str
    ) -> None:
        """Compared here, without the help of the lockstep device, which goes through all combinations."""
        options: dict[str, Any] = {
            "autoreset_mode": mode,
            "max_cycles": limit,
            "initial_states": initial_states,
            "first_slot": 3,
        }
        reference = reference_for(case, **options)
        device = case.open(**options)
        np.testing.assert_array_equal(device.reset(seed=11), reference.reset(seed=11))
        ends = 0
        for t, actions in enumerate(case.habits()):
            ours, theirs = device.step(actions), reference.step(actions)
            assert_same_step(ours, theirs, f"step {t}")
            np.testing.assert_array_equal(device.state(), reference.state(), f"state after step {t}")
            ends += int(theirs.ended.sum())
        if 0 < reference.config.limit <= STEPS // 2:
            assert ends > SIZE, "the comparison has to see episodes end, and begin again"

    @by_mode
    def test_resets_masks_and_limits_between_steps(self, case: Case, mode: AutoresetMode) -> None:
        """What may happen between two steps, at odd times."""
        reference = reference_for(case, autoreset_mode=mode, max_cycles=0)
        device = case.open(autoreset_mode=mode, max_cycles=0)
        seed = 2**70 + 5
        np.testing.assert_array_equal(device.reset(seed=seed), reference.reset(seed=seed))
        generator = np.random.default_rng(5)
        for t, actions in enumerate(case.habits(60)):
            assert_same_step(device.step(actions), reference.step(actions), f"step {t}")
            if t % 7 == 3:
                mask = generator.random(SIZE) < 0.3
                np.testing.assert_array_equal(
                    device.reset(mask=mask), reference.reset(mask=mask), f"mask {t}"
                )
            if t % 20 == 10:
                np.testing.assert_array_equal(device.reset(), reference.reset(), f"unseeded reset {t}")
            if t % 15 == 9:
                limit = (6, 3, 0, 4)[t // 15]
                device.set_max_cycles(limit)
                reference.set_max_cycles(limit)
            np.testing.assert_array_equal(device.state(), reference.state(), f"state after step {t}")

    def test_stored_starts_survive_masks_and_are_renewed_by_a_full_reset(self, case: Case) -> None:
        """Until then, every episode of a slot begins where its first did."""
        options: dict[str, Any] = {"initial_states": "stored", "max_cycles": 4}
        reference = reference_for(case, **options)
        device = case.open(**options)
        first = device.reset(seed=1)
        np.testing.assert_array_equal(first, reference.reset(seed=1))
        for t, actions in enumerate(case.habits(13)):
            ours = device.step(actions)
            assert_same_step(ours, reference.step(actions), f"step {t}")
            again = ours.ended & ours.in_episode  # not who has ended before its world
            np.testing.assert_array_equal(ours.obs[again], first[again])
        mask = np.arange(SIZE) % 3 == 0
        after = device.reset(mask=mask)
        chosen = mask.repeat(case.spec.agents)
        np.testing.assert_array_equal(after[chosen], first[chosen])
        np.testing.assert_array_equal(after, reference.reset(mask=mask))
        np.testing.assert_array_equal(device.reset(), reference.reset())
        for t, actions in enumerate(case.habits(13)):
            assert_same_step(device.step(actions), reference.step(actions), f"step {t} after reset()")

    def test_random_starts_differ_and_stored_ones_repeat(self, case: Case) -> None:
        """Without this, ``initial_states`` could be ignored wherever starts are the same anyway."""
        if not case.spec.reset_draws:
            pytest.skip(f"{case.spec.name} always starts in the same state")
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
