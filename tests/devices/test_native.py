"""What only the native device has: threads, its use of memory, and copies of it."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.batch.actions import random_actions
from pearl_marl.compiler.kernel_loops import BLOCK
from pearl_marl.devices import BatchConfig, Lockstep, Native, Phase, threads
from pearl_marl.devices.threads import ThreadCount
from pearl_marl.errors import ActionError, OrderError
from pearl_marl.policies.integer_network import table_network
from pearl_marl.testing import assert_same_trajectory, trajectory
from pearl_marl.testing.case import assert_same_step

SPEC = pearl_marl.get_spec("CliffWalking")
N = 5000


def opened(device: Native | None = None, n: Any = N, **config: Any) -> Native:
    return (device or Native()).open(BatchConfig(spec=SPEC, n_envs=n, **config))


def actions(steps: int, n: int = N) -> np.ndarray[Any, Any]:
    return np.random.default_rng(0).integers(0, 4, (steps, n), np.uint8)


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.uint16, np.int64])
def test_sizes_may_be_numpy_integers(dtype: Any) -> None:
    """Sizes in bytes computed in such a type would wrap around."""
    device, plain = opened(n=dtype(100)), opened(n=100)
    assert (device.reset(seed=1) == plain.reset(seed=1)).all()
    assert_same_trajectory(trajectory(device, actions(5, 100)), trajectory(plain, actions(5, 100)))


@pytest.mark.parametrize("threads", [1, 2])
def test_a_step_that_is_refused_changes_nothing(threads: int) -> None:
    """Words are looked at in the kernel, or before any of several threads begins."""
    device = opened(Native(threads=threads))
    device.reset(seed=0)
    device.step(actions(1)[0])
    before = device.snapshot()
    for slot in (0, N - 1):
        wrong = actions(1)[0]
        wrong[slot] = 4
        with pytest.raises(ActionError, match=f"agent_{slot}: action 4"):
            device.step(wrong)
    after = device.snapshot()
    assert (before.tick, before.memory.tobytes()) == (after.tick, after.memory.tobytes())


def test_limits_of_all_widths() -> None:
    """Elapsed steps are in words that hold the limit, and go on counting in others when that changes."""
    lockstep = Lockstep("native", "reference").open(BatchConfig(spec=SPEC, n_envs=70, max_cycles=20))
    lockstep.reset(seed=0)
    device: Any = lockstep.device
    widths = []
    for limit, steps in ((300, 260), (7, 5), (70_000, 20), (0, 3), (255, 256), (3, 5), (65_535, 2)):
        lockstep.set_max_cycles(limit)
        widths.append(device._elapsed.itemsize)
        for row in actions(steps, 70):
            lockstep.step(row)
    assert widths == [2, 2, 4, 1, 1, 1, 2]


@pytest.mark.parametrize("spoil", ["read-only", "unaligned", "strided"])
def test_unusual_actions_compile_nothing(spoil: str) -> None:
    device = opened()
    device.reset(seed=0)
    given = actions(1)[0].astype(np.int32)
    device.step(given)
    compiled = len(device._kernels.step.signatures)
    if spoil == "read-only":
        given = given.astype(np.uint8)
        given.flags.writeable = False
    elif spoil == "unaligned":
        given = np.frombuffer(b"x" + given.tobytes(), np.int32, offset=1)
    else:
        given = np.repeat(given, 2)[::2]
    device.step(given)
    assert len(device._kernels.step.signatures) == compiled


def test_threads_that_do_not_help_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "cores", lambda: 8)
    count, took = ThreadCount(None, trials=5), []
    for seconds in [1e-3] * 5 + [2e-3] * 5 + [1e-3] * 20:
        if count.tuning:
            count.learn(seconds)
        took.append(count.now)
    assert took[5] == 7
    assert took[-1] == 1


def test_threads_that_help_are_kept_and_short_steps_want_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "cores", lambda: 2)
    count = ThreadCount(None, trials=5)
    for seconds in [1e-3, 1e-3, 1e-5] * 5:  # interrupted now and then, but short
        count.learn(seconds)
    assert count.now == 1
    for seconds in [1e-3] * 5 + [6e-4] * 5:
        count.learn(seconds)
    assert (count.now, count.tuning) == (2, False)


def test_more_work_may_take_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "cores", lambda: 2)
    count = ThreadCount(None, trials=2)
    for seconds, work in [(1e-3, 2), (1e-3, 2), (4e-3, 10), (4e-3, 10)]:
        count.learn(seconds, work)
    assert (count.now, count.tuning) == (2, False)


def test_a_long_rollout_tries_more_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "cores", lambda: 2)
    policy = table_network(SPEC, np.tile([0, 1, 0, 0], (48, 1)))
    device, taken = opened(), []
    device.reset(seed=1)
    submit = threads.Threads.submit
    monkeypatch.setattr(threads.Threads, "submit", lambda *call: taken.append(1) or submit(*call))
    device.rollout(policy, 2_000)
    assert taken


def _steps_in_a_child(device: Native, queue: Any) -> None:
    queue.put(device.step(actions(1)[0]).obs.sum())


def test_a_forked_child_can_step() -> None:
    """Threads do not survive a fork, so the child has to start its own."""
    device = opened(Native(threads=2))
    device.reset(seed=0)
    device.step(actions(1)[0])
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_steps_in_a_child, args=(device, queue), daemon=True)
    child.start()
    assert queue.get(timeout=1800) == device.step(actions(1)[0]).obs.sum()
    child.join()


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda device: pickle.loads(pickle.dumps(device))])
@pytest.mark.parametrize("initial_states", ["random", "stored"])
def test_a_copy_goes_on_by_itself(duplicate: Any, initial_states: str) -> None:
    device = opened(Native(threads=2), initial_states=initial_states)
    device.reset(seed=3)
    device.set_rewards([1, 2])
    trajectory(device, actions(3))
    other = duplicate(device)
    assert_same_trajectory(trajectory(device, actions(4)), trajectory(other, actions(4)))
    assert other.rewards.tolist() == [1, 2]


def test_a_ctrl_c_in_recv_leaves_the_step_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    device, other = opened(), opened()
    for one in (device, other):
        one.reset(seed=0)
    device.send(actions(1)[0])

    def interrupted() -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        assert device.phase is Phase.STEPPING
        patch.setattr(device._sent[1], "result", interrupted)
        patch.setattr(device._sent[1], "done", lambda: False)
        with pytest.raises(KeyboardInterrupt):
            device.recv()
    assert_same_trajectory([device.recv()], trajectory(other, actions(1)))


def test_no_copy_between_send_and_recv() -> None:
    device = opened()
    device.reset(seed=0)
    device.send(actions(1)[0])
    with pytest.raises(OrderError, match="recv"):
        copy.deepcopy(device)
    device.recv()


def test_a_bad_action_of_the_aec_form_can_be_mended() -> None:
    """PettingZoo's conversion alone would keep it until the end of the round, and be stuck there."""
    env = pearl_marl.env("CliffWalking", 2)
    env.reset(seed=0)
    with pytest.raises(ActionError, match=r"agent_0: action 9"):
        env.step(9)
    assert env.agent_selection == "agent_0"
    env.step(0)
    env.step(1)
    assert env.observe("agent_0") == 24


@pytest.mark.parametrize("name", ["Blackjack", "CliffWalking", "CartPole"])
@pytest.mark.parametrize("threads", [1, 2])
def test_actions_may_lie_in_results_that_the_step_writes_over(name: str, threads: int) -> None:
    """Somewhere in any array of the last step, as a user's own program may compute them in place."""
    spec, n = pearl_marl.get_spec(name), 4 * BLOCK
    env = pearl_marl.parallel_env(name, n, device=Native(threads), copy=False)
    twin = pearl_marl.parallel_env(name, n, device="native")
    env.reset(seed=0)
    twin.reset(seed=0)
    rng, tried = np.random.default_rng(0), 0
    step = env.step_batch(random_actions(spec, rng, n, env.action_masks))
    twin.load_state(env.save_state())
    for index in range(len(step.arrays)):
        room = step.arrays[index].view(np.uint8).reshape(-1)
        for start in range(0, room.size - n + 1, max(1, room.size // 40)):
            given = random_actions(spec, rng, n, env.action_masks)
            assert given.dtype == np.uint8
            place = room[start : start + n]
            place[:] = given
            step, other = env.step_batch(place), twin.step_batch(given.copy())
            assert_same_step(step, other)
            room = step.arrays[index].view(np.uint8).reshape(-1)
            tried += 1
    assert tried > 40
    env.close()
    twin.close()
