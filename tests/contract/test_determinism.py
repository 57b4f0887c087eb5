"""One seed, one trajectory: whatever the run, the number of threads, the size, or the split."""

from __future__ import annotations

import numpy as np
import pytest

from pearl_marl.devices import BatchConfig, BatchStep, Native
from pearl_marl.devices.base import Device

from ..helpers import LARGEST, SIZE, Case, assert_same_trajectory, rows, trajectory

SIZES = (1, 7, 1000, 43008)


def run(device: Device, actions: np.ndarray, seed: int = 8) -> tuple[np.ndarray, list[BatchStep]]:
    obs = device.reset(seed=seed)
    return obs, trajectory(device, actions)


def test_two_runs_are_identical(case: Case) -> None:
    actions = case.actions()
    (obs_a, a), (obs_b, b) = (run(case.open(max_cycles=9), actions) for _ in range(2))
    np.testing.assert_array_equal(obs_a, obs_b)
    assert_same_trajectory(a, b)


def test_seeds_differ(case: Case) -> None:
    if not case.spec.reset_draws + case.spec.step_draws:
        pytest.skip(f"nothing in {case.env_id} is random")
    _, a = run(case.open(), case.actions(5), seed=0)
    _, b = run(case.open(), case.actions(5), seed=1)
    assert any((x.obs != y.obs).any() for x, y in zip(a, b, strict=True))


def test_reset_without_a_seed_goes_on(case: Case) -> None:
    """New episodes each time, and yet the same ones in every run that began with the same seed."""
    first, second = case.open(), case.open()
    starts = []
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


def test_an_unseeded_first_reset_is_different_every_time(case: Case) -> None:
    if not case.spec.reset_draws:
        pytest.skip(f"{case.env_id} always starts in the same state")
    assert (case.open().reset() != case.open().reset()).any()


@pytest.mark.parametrize("n", SIZES)
def test_a_larger_batch_begins_with_the_smaller_one(case: Case, n: int) -> None:
    if n > LARGEST[case.device_name]:
        pytest.skip(f"{n} slots take the {case.device_name} device too long")
    small = min(n, 1000)
    actions = case.actions(12, n)
    obs, whole = run(case.open(n, max_cycles=5), actions)
    obs_small, part = run(case.open(small, max_cycles=5), actions[:, :small].copy())
    np.testing.assert_array_equal(obs[:small], obs_small)
    assert_same_trajectory(rows(whole, 0, small), part)
    assert obs.shape[0] == n
    assert np.any([step.ended for step in whole], axis=0).all(), "with a limit of 5, everyone ended once"


@pytest.mark.slow
def test_a_million_slots(case: Case) -> None:
    if case.device_name != "native":
        pytest.skip(f"a million slots take the {case.device_name} device too long")
    actions = case.actions(12, 1_000_000)
    _, whole = run(case.open(1_000_000, max_cycles=5), actions)
    _, part = run(case.open(1000, max_cycles=5), actions[:, :1000].copy())
    assert_same_trajectory(rows(whole, 0, 1000), part)


@pytest.mark.parametrize("split", [35, 1, 64])
def test_a_split_batch_equals_the_whole(case: Case, split: int) -> None:
    actions = case.actions()
    obs, whole = run(case.open(max_cycles=9), actions)
    for start, stop in ((0, split), (split, SIZE)):
        part = case.open(stop - start, first_slot=start, max_cycles=9)
        part_obs, steps = run(part, actions[:, start:stop].copy())
        np.testing.assert_array_equal(obs[start:stop], part_obs)
        assert_same_trajectory(rows(whole, start, stop), steps)


def test_the_last_slots_that_random_numbers_know(case: Case) -> None:
    """Slot numbers are 32 bits wide, so these would wrap where one of them was kept signed."""
    high = case.open(8, first_slot=2**32 - 8)
    low = case.open(8, first_slot=0)
    actions = case.actions(6, 8)
    (_, a), (_, b) = run(high, actions), run(low, actions)
    if case.spec.reset_draws:
        assert (a[0].obs != b[0].obs).any()


@pytest.mark.parametrize("n", [5000, 4096, 6143])
def test_threads_change_nothing(toys: None, env_id: str, n: int) -> None:
    case = Case(env_id, "native")
    actions = case.actions(15, n)
    runs = []
    for threads in (1, 2, 3):
        device = Native(threads=threads).open(BatchConfig(spec=case.spec, n_envs=n, max_cycles=4))
        runs.append(run(device, actions))
        device.close()
    for obs, steps in runs[1:]:
        np.testing.assert_array_equal(obs, runs[0][0])
        assert_same_trajectory(steps, runs[0][1])


def test_send_and_recv_are_step_in_two_halves(case: Case) -> None:
    stepped, sent = case.open(max_cycles=5), case.open(max_cycles=5)
    stepped.reset(seed=0)
    sent.reset(seed=0)
    results = []
    for actions in case.actions():
        sent.send(actions)
        results.append(sent.recv())
    assert_same_trajectory(trajectory(stepped, case.actions()), results)
