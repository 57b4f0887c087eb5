"""Lockstep finds what is broken, names the first word that is, and leaves everything usable."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl import verification
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.devices import BatchConfig, Device, Lockstep, Native, Reference
from pearl_marl.devices.replay import Replay
from pearl_marl.errors import ArgumentError, DeviceError, LockstepError, OrderError
from pearl_marl.testing import Case, assert_same_trajectory, trajectory

from ..toy import DRIFT
from .broken import Elsewhere, Flips, FlipsStart, Forgets, OtherWidth

N = 70
CLIFF = pearl_marl.get_spec("CliffWalking")
RESULTS = {"obs": "obs", "rewards": "rewards", "terminations": "terminations", "truncations": "truncations"}
STATE = {"row": "state.row", "column": "state.column", "elapsed": "elapsed"}


def actions_for(spec: Any, steps: int, n: int = N) -> np.ndarray:
    generator = np.random.default_rng(4)
    return generator.integers(spec.action_space.n, size=(steps, n)).astype(spec.action.dtype)


def open_pair(device: Device, spec: Any = CLIFF, state_every: int | None = None, **config: Any) -> Lockstep:
    config = {"n_envs": N, "max_cycles": 9, **config}
    lockstep = Lockstep(device, "reference", state_every).open(BatchConfig(spec=spec, **config))
    lockstep.reset(seed=5)
    return lockstep


def until_error(lockstep: Device, actions: np.ndarray) -> tuple[int, LockstepError]:
    for t, row in enumerate(actions):
        try:
            lockstep.step(row)
        except LockstepError as error:
            return t, error
    raise AssertionError("nothing was found")


@pytest.mark.parametrize("copy", [True, False])
@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP], ids=lambda m: m.name)
@pytest.mark.parametrize("slot", [0, 33, N - 1])
@pytest.mark.parametrize("field", [*RESULTS, *STATE])
def test_one_bit_of_any_field(field: str, slot: int, mode: AutoresetMode, copy: bool) -> None:
    broken = Flips(field, tick=12, slot=slot)
    lockstep = open_pair(broken, autoreset_mode=mode, first_slot=1000, copy=copy)
    actions = actions_for(CLIFF, 20)
    truth = Reference().open(replace(lockstep.config, copy=True))
    truth.reset(seed=5)
    trajectory(truth, actions[:12])
    before = SlotMemory(CLIFF, N, truth.snapshot().memory).columns
    right = truth.step(actions[12])
    after = SlotMemory(CLIFF, N, truth.snapshot().memory).columns

    t, error = until_error(lockstep, actions)
    assert (t, error.step, error.slot) == (12, 12, 1000 + slot)
    assert error.field == {**RESULTS, **STATE}[field]
    words = getattr(right, field) if field in RESULTS else after[field]
    assert error.reference_value == words[slot]
    flipped = words.copy()
    flipped.view(f"u{flipped.itemsize}")[slot] ^= 1
    assert error.device_value == flipped[slot]
    assert error.action == actions[12, slot]
    assert error.state_before == {name: column[slot] for name, column in before.items()}
    assert error.divergence.slots == 1
    assert f"step 12, slot {1000 + slot}: {error.field} is {error.device_value}" in str(error)


@pytest.mark.parametrize("column", [0, 1, 2])
def test_observations_and_final_observations_of_several_fields(toys: None, column: int) -> None:
    name = ("position", "fuel", "dither")[column]
    error = until_error(open_pair(Flips("obs", tick=3, slot=7, column=column), DRIFT), actions_for(DRIFT, 9))[
        1
    ]
    assert (error.step, error.slot, error.field) == (3, 7, f"obs.{name}")
    lockstep = open_pair(Flips("final_obs", tick=4, slot=7, column=column), DRIFT, max_cycles=5)
    error = until_error(lockstep, actions_for(DRIFT, 9))[1]
    assert (error.step, error.slot, error.field) == (4, 7, f"final_obs.{name}")


def test_final_observations_count_only_where_a_slot_ended() -> None:
    lockstep = open_pair(Flips("final_obs", tick=7, slot=7), max_cycles=9)
    trajectory(lockstep, actions_for(CLIFF, 8))
    assert (
        until_error(open_pair(Flips("final_obs", tick=8, slot=7), max_cycles=9), actions_for(CLIFF, 20))[
            1
        ].step
        == 8
    )


def test_the_flag_of_next_step_resets() -> None:
    broken = Flips("ended", tick=12, slot=6)
    error = until_error(open_pair(broken, autoreset_mode=AutoresetMode.NEXT_STEP), actions_for(CLIFF, 20))[1]
    assert (error.step, error.slot, error.field) == (12, 6, "ended")


def test_equal_floats_of_other_bits() -> None:
    """Minus zero equals zero, and yet it is another word."""

    class MinusZero(Native):
        name = "minus zero"

        def _step(self, actions: np.ndarray) -> Any:
            results = super()._step(actions)
            results.rewards[5] = -0.0
            return results

    lockstep = Lockstep(MinusZero(), "reference").open(BatchConfig(spec=CLIFF, n_envs=N), [0.0, -1.0])
    lockstep.reset(seed=0)
    error = until_error(lockstep, np.zeros((1, N), np.uint8))[1]
    assert (error.slot, error.field, str(error.device_value)) == (5, "rewards", "-0.0")


@pytest.mark.parametrize("state_every", [1, 3, 16, 100])
@pytest.mark.parametrize("field", ["elapsed", "column"])
def test_a_state_that_went_wrong_between_comparisons(field: str, state_every: int) -> None:
    """However late it is noticed, what is reported is where it began."""
    lockstep = open_pair(Flips(field, tick=21, slot=8), state_every=state_every, max_cycles=30)
    t, error = until_error(lockstep, actions_for(CLIFF, 60))
    assert (error.step, error.slot, error.field) == (21, 8, STATE[field])
    assert t == 21 if state_every == 1 else t >= 21
    assert error.action == actions_for(CLIFF, 60)[21, 8]


def test_a_mistake_that_is_not_made_again_is_reported_where_it_was_noticed() -> None:
    lockstep = open_pair(Flips("elapsed", tick=21, slot=8, lasting=False), state_every=16, max_cycles=0)
    t, error = until_error(lockstep, actions_for(CLIFF, 60))
    assert (t, error.step, error.slot, error.field) == (31, 31, 8, "elapsed")


def test_the_end_of_a_run_is_compared_by_a_snapshot() -> None:
    lockstep = open_pair(Flips("elapsed", tick=3, slot=8), state_every=16)
    trajectory(lockstep, actions_for(CLIFF, 5))
    with pytest.raises(LockstepError) as caught:
        lockstep.snapshot()
    assert (caught.value.step, caught.value.field) == (3, "elapsed")


def test_a_wrong_constant() -> None:
    """Walk along the third row: the first slot to reach column 11 shows it, at its twelfth move."""
    golden = CLIFF.golden._replace(step=wrong_step)
    lockstep = open_pair(Elsewhere(golden), max_cycles=0)
    actions = np.zeros((20, N), np.uint8)
    actions[1:, 40:] = 1  # slots 40 and up go right after one step up
    t, error = until_error(lockstep, actions)
    assert (t, error.step, error.slot) == (11, 11, 40)
    assert (error.field, error.device_value, error.reference_value) == ("obs", 34, 35)
    assert error.state_before == {"row": 2, "column": 10, "elapsed": 0, "ended": 0}
    assert [tuple(d) for d in error.divergence.differences] == [("obs", 34, 35), ("state.column", 10, 11)]
    assert error.divergence.slots == 30


def wrong_step(state: Any, action: Any, draws: Any) -> tuple[Any, ...]:
    # The golden step with 10 where LAST_COLUMN was.
    row, column = state
    if action == 0:
        row = max(row - 1, 0)
    elif action == 2:
        row = min(row + 1, 3)
    elif action == 3:
        column = max(column - 1, 0)
    else:
        column = min(column + 1, 10)
    if row == 3 and 0 < column < 11:
        return state._replace(row=3, column=0), 1, 0
    return state._replace(row=row, column=column), 0, row == 3 and column == 11


def test_resets() -> None:
    config = BatchConfig(spec=CLIFF, n_envs=N)
    lockstep = Lockstep(FlipsStart(9), "reference").open(config)
    with pytest.raises(LockstepError, match=r"reset\(\) before step 0, slot 9: obs is 37, not 36") as caught:
        lockstep.reset(seed=1)
    assert caught.value.state_before is None
    assert caught.value.action is None
    with pytest.raises(OrderError):  # as before the call
        lockstep.step(np.zeros(N, np.uint8))


def test_masked_resets_change_nothing_when_they_fail() -> None:
    config = BatchConfig(spec=CLIFF, n_envs=N, max_cycles=9)

    class Later(FlipsStart):
        def _reset(self, mask: Any, seed: int | None) -> Any:
            return Native._reset(self, mask, seed) if mask is None else super()._reset(mask, seed)

    lockstep = Lockstep(Later(9), "reference").open(config)
    lockstep.reset(seed=1)
    trajectory(lockstep, actions_for(CLIFF, 6))
    before = lockstep.snapshot()
    mask = np.arange(N) >= 5
    with pytest.raises(LockstepError) as caught:
        lockstep.reset(mask=mask)
    assert (caught.value.step, caught.value.slot, caught.value.field) == (6, 9, "obs")
    assert lockstep.snapshot().to_bytes() == before.to_bytes()
    mask[9] = False
    lockstep.reset(mask=mask)


def test_a_first_reset_that_diverges_can_be_made_again(tmp_path: Path) -> None:
    lockstep = Lockstep(FlipsStart(9), "reference").open(BatchConfig(spec=CLIFF, n_envs=N))
    for _ in range(2):
        with pytest.raises(LockstepError, match="slot 9") as caught:
            lockstep.reset(seed=np.int64(5))
        caught.value.replay.write(tmp_path / "replay.json")
    assert Replay.read(tmp_path / "replay.json").divergence == caught.value.divergence


def test_restores() -> None:
    source = Native().open(BatchConfig(spec=CLIFF, n_envs=N, max_cycles=9))
    source.reset(seed=0)
    lockstep = Lockstep(Forgets(), "reference").open(source.config)
    with pytest.raises(LockstepError, match=r"restore\(\) before step 0, slot 3: elapsed is 1, not 0"):
        lockstep.restore(source.snapshot())


def test_a_wrong_dtype_is_a_difference() -> None:
    error = until_error(open_pair(OtherWidth()), actions_for(CLIFF, 2))[1]
    assert error.field == "obs array"
    assert error.device_value == f"int16 of shape ({N},)"


@pytest.mark.parametrize("state_every", [1, 16])
@pytest.mark.parametrize("field", ["rewards", "row"])
def test_after_a_divergence_the_run_goes_on(field: str, state_every: int) -> None:
    """The call that raised has changed nothing: taken again without the mistake, all is as it should be."""
    actions = actions_for(CLIFF, 40)
    lockstep = open_pair(Flips(field, tick=20, slot=3, lasting=False), state_every=state_every)
    truth = Reference().open(lockstep.config)
    truth.reset(seed=5)
    t, _ = until_error(lockstep, actions)
    trajectory(truth, actions[:t])
    assert lockstep.snapshot().to_bytes() == truth.snapshot().to_bytes()
    assert_same_trajectory(trajectory(lockstep, actions[t:]), trajectory(truth, actions[t:]))


def test_a_device_that_fails_does_not_part_them() -> None:
    class Fails(Native):
        failing = False

        def _step(self, actions: np.ndarray) -> Any:
            if self.failing:
                raise DeviceError("unplugged")
            return super()._step(actions)

    for place in (0, 1):
        devices: list[Device] = [Reference(), Native()]
        devices[place] = failing = Fails()
        lockstep = Lockstep(*devices).open(BatchConfig(spec=CLIFF, n_envs=N, max_cycles=9))
        lockstep.reset(seed=0)
        trajectory(lockstep, actions_for(CLIFF, 3))
        failing.failing = True
        with pytest.raises(DeviceError, match="unplugged"):
            lockstep.step(actions_for(CLIFF, 1)[0])
        failing.failing = False
        trajectory(lockstep, actions_for(CLIFF, 10))
        lockstep.snapshot()


def test_settings_between_steps_reach_both() -> None:
    lockstep = open_pair(Native(), state_every=16)
    trajectory(lockstep, actions_for(CLIFF, 5))
    lockstep.set_rewards([-2.0, 4.5])
    lockstep.set_max_cycles(3)
    steps = trajectory(lockstep, actions_for(CLIFF, 20))
    assert {-2.0, 4.5} == {float(r) for step in steps for r in np.unique(step.rewards)}
    assert lockstep.reference.rewards.tolist() == [-2.0, 4.5]
    assert lockstep.reference.config.limit == lockstep.config.limit == 3
    error_at = Flips("elapsed", tick=30, slot=1)
    late = open_pair(error_at, state_every=16)
    trajectory(late, actions_for(CLIFF, 28))
    late.set_rewards([-2.0, 4.5])
    with pytest.raises(LockstepError):
        trajectory(late, actions_for(CLIFF, 20))
    assert late.rewards.tolist() == late.device.rewards.tolist() == [-2.0, 4.5]


def test_in_a_parallel_env() -> None:
    lockstep = Lockstep(Flips("rewards", tick=4, slot=2), "reference")
    env = pearl_marl.parallel_env("CliffWalking", n_agents=N, device=lockstep)
    env.reset(seed=0)
    for _ in range(4):
        env.step(np.zeros(N, np.uint8))
    with pytest.raises(LockstepError, match=r"rewards is -1\.0000001192092896, not -1\.0"):
        env.step(np.zeros(N, np.uint8))
    assert env.device.words_compared > 0
    env.close()


def test_words_are_counted() -> None:
    lockstep = Lockstep("native", "reference").open(BatchConfig(spec=CLIFF, n_envs=10, max_cycles=2))
    lockstep.reset(seed=0)
    assert lockstep.words_compared == 10 * (1 + 4)  # obs; row, column, elapsed, ended
    lockstep.step(np.zeros(10, np.uint8))
    assert lockstep.words_compared == 10 * (5 + 4 + 4)  # obs, reward, two flags, state
    lockstep.step(np.zeros(10, np.uint8))
    assert lockstep.words_compared == 10 * (13 + 9)  # and everybody's final observation


def test_a_divergence_survives_pickling() -> None:
    error = until_error(open_pair(Flips("obs", tick=1, slot=2)), actions_for(CLIFF, 3))[1]
    assert str(pickle.loads(pickle.dumps(error.divergence))) == str(error)


@pytest.mark.parametrize("state_every", [0, -1, True, 1.5, "often"])
def test_bad_arguments(state_every: Any) -> None:
    with pytest.raises(ArgumentError, match="state_every"):
        Lockstep("native", state_every=state_every)


def test_bad_devices() -> None:
    with pytest.raises(ArgumentError, match="there is no device 'gpu'"):
        Lockstep("gpu")
    with pytest.raises(ArgumentError, match="there is no device 'gpu'"):
        Lockstep("native", "gpu")
    device = Native()
    with pytest.raises(ArgumentError, match="not its own reference"):
        Lockstep(device, device)
    used = Native().open(BatchConfig(spec=CLIFF, n_envs=2))
    fresh = Native()
    with pytest.raises(OrderError, match="opened before"):
        Lockstep(fresh, used).open(BatchConfig(spec=CLIFF, n_envs=2))
    with pytest.raises(OrderError, match="after close"):
        fresh.reset()


# --- replays


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("initial_states", ["random", "stored"])
@pytest.mark.parametrize("env_id", ["CliffWalking", "Drift"])
def test_a_replay_file_makes_it_again(toys: None, tmp_path, env_id, initial_states, alone) -> None:
    case = Case(env_id, "native")
    slot = 0 if alone else 31
    lockstep = open_pair(
        Flips("rewards", tick=17, slot=slot), case.spec, initial_states=initial_states, first_slot=6
    )
    error = until_error(lockstep, actions_for(case.spec, 30))[1]
    (error.replay.alone() if alone else error.replay).write(tmp_path / "replay.json")
    replay = Replay.read(tmp_path / "replay.json")
    assert replay.config.n_envs == (1 if alone else N)
    assert replay.divergence == error.divergence

    again = verification.replay(replay, Lockstep(Flips("rewards", tick=17, slot=slot), "reference"))
    assert again is not None
    assert again.divergence == error.divergence
    assert verification.replay(replay, Lockstep("native", "reference")) is None


def test_a_slot_alone_does_what_it_did_among_the_others(toys: None) -> None:
    """All of the context: state, counters, stored start, seed, tick, and the slot's own number."""
    lockstep = open_pair(Flips("obs", tick=13, slot=31), DRIFT, first_slot=6, max_cycles=14)
    error = until_error(lockstep, actions_for(DRIFT, 30))[1]
    truth = Reference().open(lockstep.config)
    truth.restore(error.replay.before)
    whole = truth.step(error.replay.actions)
    alone = error.replay.alone()
    device = Native().open(alone.config)
    device.restore(alone.before)
    part = device.step(alone.actions)
    for a, b in zip(whole, part, strict=True):
        np.testing.assert_array_equal(a[31], b[0])
    assert whole.ended[31], "its next episode's start is drawn too"


def test_replays_of_resets(tmp_path) -> None:
    config = BatchConfig(spec=CLIFF, n_envs=N)
    lockstep = Lockstep(FlipsStart(9), "reference").open(config)
    with pytest.raises(LockstepError) as caught:
        lockstep.reset()
    caught.value.replay.write(tmp_path / "replay.json")
    replay = Replay.read(tmp_path / "replay.json")
    assert replay.before is None
    again = verification.replay(replay, Lockstep(FlipsStart(9), "reference"))
    assert again is not None
    assert again.divergence == caught.value.divergence
    assert verification.replay(replay, Lockstep("native", "reference")) is None
