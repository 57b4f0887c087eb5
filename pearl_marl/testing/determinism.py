"""One seed, one trajectory: whatever the run, the number of threads, the size, or the split."""

from __future__ import annotations

import numpy as np
import pytest

from pearl_marl.base.arrays import Array
from pearl_marl.devices import BatchStep, Device, Native
from pearl_marl.testing.case import SIZE, Case, assert_same_trajectory, rows, trajectory


def run(device: Device, actions: Array, seed: int = 8) -> tuple[Array, list[BatchStep]]:
    """Return the first observations and the trajectory of a fresh device."""
    obs = device.reset(seed=seed)
    return obs, trajectory(device, actions)


class DeterminismContract:
    """Tests of what results depend on."""

    def test_two_runs_are_identical(self, case: Case) -> None:
        """A seed says everything."""
        actions = case.actions()
        (obs_a, a), (obs_b, b) = (run(case.open(max_cycles=9), actions) for _ in range(2))
        np.testing.assert_array_equal(obs_a, obs_b)
        assert_same_trajectory(a, b)

    def test_seeds_differ(self, case: Case) -> None:
        """Or the seed is not used."""
        if not case.spec.reset_draws + case.spec.step_draws:
            pytest.skip(f"nothing in {case.spec.name} is random")
        _, a = run(case.open(), case.actions(5), seed=0)
        _, b = run(case.open(), case.actions(5), seed=1)
        assert any((x.obs != y.obs).any() for x, y in zip(a, b, strict=True))

    def test_reset_without_a_seed_goes_on(self, case: Case) -> None:
        """New episodes each time, and yet the same ones in every run that began with the same seed."""
        first, second = case.open(), case.open()
        starts: list[list[Array]] = []
        for device in (first, second):
            device.reset(seed=3)
            starts.append([device.reset() for _ in range(4)])
            device.step(case.actions(1)[0])
            starts[-1].append(device.reset())
        for a, b in zip(*starts, strict=True):
            np.testing.assert_array_equal(a, b)
        if case.spec.reset_draws:
            seen = {start.tobytes() for start in starts[0]}
            assert len(seen) == len(starts[0])

    def test_an_unseeded_first_reset_is_different_every_time(self, case: Case) -> None:
        """As Gymnasium has it."""
        if not case.spec.reset_draws:
            pytest.skip(f"{case.spec.name} always starts in the same state")
        assert (case.open().reset() != case.open().reset()).any()

    def test_a_larger_batch_begins_with_the_smaller_one(self, case: Case) -> None:
        """Slot 5 of a million is slot 5 of ten."""
        (*smaller, largest), k = case.sizes, case.spec.agents
        if not smaller:
            pytest.skip(f"{case.device_name} is built for its size, and has one here")
        actions = case.actions(12, largest)
        obs, whole = run(case.open(largest, max_cycles=5), actions)
        assert obs.shape[0] == largest * k
        for n in smaller:
            obs_small, part = run(case.open(n, max_cycles=5), actions[:, : n * k].copy())
            np.testing.assert_array_equal(obs[: n * k], obs_small)
            assert_same_trajectory(rows(whole, 0, n, k), part)
        assert np.any([step.ended for step in whole], axis=0).all(), "with a limit of 5, everyone ended once"

    def test_a_split_batch_equals_the_whole(self, case: Case) -> None:
        """Two devices can share the slots of a run."""
        actions, k = case.actions(), case.spec.agents
        if not case.splits:
            pytest.skip(f"{case.device_name} is built for its size, and has one here")
        obs, whole = run(case.open(max_cycles=9), actions)
        for split in case.splits:
            for start, stop in ((0, split), (split, SIZE)):
                part = case.open(stop - start, first_slot=start, max_cycles=9)
                part_obs, steps = run(part, actions[:, start * k : stop * k].copy())
                np.testing.assert_array_equal(obs[start * k : stop * k], part_obs)
                assert_same_trajectory(rows(whole, start, stop, k), steps)

    def test_the_last_slots_that_random_numbers_know(self, case: Case) -> None:
        """Slot numbers are 32 bits wide, so these would wrap where one of them was kept signed."""
        high = case.open(SIZE, first_slot=2**32 - SIZE)
        low = case.open(SIZE, first_slot=0)
        actions = case.actions(6, SIZE)
        (_, a), (_, b) = run(high, actions), run(low, actions)
        if case.spec.reset_draws:
            assert (a[0].obs != b[0].obs).any()

    def test_threads_change_nothing(self, native: Case) -> None:
        """Nor how the slots fall to them: in equal shares, or with a remainder."""
        largest, k = 6143, native.spec.agents
        actions = native.actions(15, largest)
        _, alone = run(native.open(largest, device=Native(threads=1), max_cycles=4), actions)
        for n in (5000, 4096, largest):
            for threads in (2, 3):
                device = native.open(n, device=Native(threads=threads), max_cycles=4)
                _, steps = run(device, actions[:, : n * k].copy())
                assert_same_trajectory(steps, rows(alone, 0, n, k))
                device.close()

    def test_send_and_recv_are_step_in_two_halves(self, case: Case) -> None:
        """Gymnasium's ``step_async`` and ``step_wait``."""
        stepped, sent = (case.open(max_cycles=5, seed=0) for _ in range(2))
        results = []
        for actions in case.actions():
            sent.send(actions)
            results.append(sent.recv())
        assert_same_trajectory(trajectory(stepped, case.actions()), results)
