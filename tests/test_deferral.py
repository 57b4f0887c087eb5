"""Ctrl-C at any moment: a batch is as before the call or as after it, and nothing hangs."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl import wrappers
from pearl_marl.base.deferral import PATIENCE, uninterrupted
from pearl_marl.batch.actions import random_actions
from pearl_marl.devices import Phase
from pearl_marl.devices.threads import Threads
from tests.devices.boards import OwnBoard

pytestmark = pytest.mark.usefixtures("ctrl_c")

Env = Any


def interrupted(call: Callable[[], Any], after: float) -> KeyboardInterrupt | None:
    """Make a call, and send Ctrl-C so many seconds after it began; wait for that if it was over before."""
    main, sent = threading.main_thread().ident, threading.Event()
    assert main is not None

    def send() -> None:
        until = began + after
        while time.perf_counter() < until:
            pass
        signal.pthread_kill(main, signal.SIGINT)
        sent.set()

    sender = threading.Thread(target=send)
    began = time.perf_counter()
    try:
        try:
            sender.start()
            call()
        finally:
            sent.wait()
            sender.join()
    except KeyboardInterrupt as interrupt:
        return interrupt
    return None


def test_a_signal_waits_for_the_end_of_the_call() -> None:
    done = []

    @uninterrupted
    def call() -> None:
        signal.raise_signal(signal.SIGINT)
        done.append("all of it")

    with pytest.raises(KeyboardInterrupt) as caught:
        call()
    assert done == ["all of it"]
    assert "call() was done to its end" in caught.value.__notes__[0]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_of_the_call_is_kept_as_the_context() -> None:
    @uninterrupted
    def call() -> None:
        signal.raise_signal(signal.SIGINT)
        raise ValueError("refused")

    with pytest.raises(KeyboardInterrupt) as caught:
        call()
    assert isinstance(caught.value.__context__, ValueError)
    assert not hasattr(caught.value, "__notes__")


def test_a_handler_that_raises_for_a_timeout_waits_too() -> None:
    def late(*_: Any) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, late)
    done = []

    @uninterrupted
    def call() -> None:
        signal.raise_signal(signal.SIGALRM)
        done.append("all of it")

    try:
        with pytest.raises(TimeoutError):
            call()
    finally:
        signal.signal(signal.SIGALRM, before)
    assert done == ["all of it"]


def test_a_second_one_is_not_kept_once_patience_is_over() -> None:
    @uninterrupted
    def call() -> None:
        signal.raise_signal(signal.SIGINT)
        time.sleep(1.2 * PATIENCE)
        signal.raise_signal(signal.SIGINT)
        pytest.fail("the second one was kept")

    with pytest.raises(KeyboardInterrupt):
        call()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.fixture
def handled() -> Iterator[list[int]]:
    """Handlers that only count, of two signals."""
    came: list[int] = []
    numbers = signal.SIGTERM, signal.SIGUSR1
    before = [signal.signal(number, lambda number, _: came.append(number)) for number in numbers]
    yield came
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def test_no_signal_is_lost_where_a_second_one_ends_the_call(handled: list[int]) -> None:
    @uninterrupted
    def call() -> None:
        signal.raise_signal(signal.SIGTERM)
        time.sleep(1.2 * PATIENCE)
        signal.raise_signal(signal.SIGINT)
        pytest.fail("the second one was kept")

    with pytest.raises(KeyboardInterrupt):
        call()
    assert handled == [signal.SIGTERM]


def test_ctrl_c_comes_before_a_timeout() -> None:
    """A program that catches its own timeout would go on."""

    def late(*_: Any) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, late)

    @uninterrupted
    def call() -> None:
        signal.raise_signal(signal.SIGALRM)
        signal.raise_signal(signal.SIGINT)

    try:
        with pytest.raises(KeyboardInterrupt) as caught:
            call()
    finally:
        signal.signal(signal.SIGALRM, before)
    assert isinstance(caught.value.__context__, TimeoutError)


def test_asyncio_hears_of_a_signal_once() -> None:
    async def main() -> int:
        came: list[int] = []
        loop = asyncio.get_running_loop()
        loop.add_signal_handler(signal.SIGUSR2, came.append, 1)
        uninterrupted(lambda: os.kill(os.getpid(), signal.SIGUSR2))()
        await asyncio.sleep(0.05)
        loop.remove_signal_handler(signal.SIGUSR2)
        return len(came)

    assert asyncio.run(main()) == 1


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_process_forked_by_another_thread_has_its_handlers_back() -> None:
    ended = []

    def fork() -> None:
        child = os.fork()
        if child == 0:
            os._exit(signal.getsignal(signal.SIGINT) is not signal.default_int_handler)
        ended.append(os.waitpid(child, 0)[1])

    @uninterrupted
    def call() -> None:
        thread = threading.Thread(target=fork)
        thread.start()
        thread.join()

    call()
    assert ended == [0]


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_fork_by_a_devices_own_thread_does_not_wait_for_itself() -> None:
    def fork() -> int:
        child = os.fork()
        if child == 0:
            os._exit(0)
        return os.waitpid(child, 0)[1]

    assert Threads(1, "pearl-test").submit(fork).result(20) == 0


def test_a_handler_that_the_call_sets_stays() -> None:
    @uninterrupted
    def call() -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    call()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_other_threads_are_as_they_were() -> None:
    called = []
    thread = threading.Thread(target=uninterrupted(lambda: called.append(1)))
    thread.start()
    thread.join()
    assert called == [1]


def native(threads: int, environment: str, n: int, **options: Any) -> Env:
    return pearl_marl.parallel_env(environment, n, device=pearl_marl.devices.Native(threads), **options)


MAKERS: dict[str, Callable[[], Env]] = {
    "one thread": lambda: native(1, "CartPole", 50_000, max_cycles=7),
    "two threads": lambda: native(2, "CartPole", 50_000, max_cycles=7),
    "masks": lambda: native(1, "LevelBasedForaging", 5_000),
    "agents leave": lambda: native(1, "CartPole", 20_000, max_cycles=9, autoreset=False),
    "wrapped": lambda: wrappers.frame_stack_v1(native(1, "CartPole", 20_000), 3),
    "rtl": lambda: pearl_marl.parallel_env("CliffWalking", 64, device="rtl"),
    "served board": lambda: pearl_marl.parallel_env("CliffWalking", 64, device=OwnBoard(4)),
    "sharded": lambda: pearl_marl.parallel_env(
        "CliffWalking", 4096, device=pearl_marl.devices.Sharded(["native", "native"])
    ),
}


def calls(env: Env, rng: np.random.Generator) -> dict[str, Callable[[Env], Any]]:
    """Return calls that move a batch, each with what it is given drawn already."""
    spec = env.unwrapped.spec
    masks = env.unwrapped.action_masks
    actions = random_actions(spec, rng, env.unwrapped.batch_size, masks)
    some = rng.integers(2, size=env.unwrapped.n_worlds).astype(bool)
    seed = int(rng.integers(1000))

    def exchange(env: Env) -> None:
        env.send(actions)
        env.recv()

    return {
        "step": lambda env: env.step_batch(actions),
        "reset": lambda env: env.reset_batch(seed),
        "reset_slots": lambda env: env.reset_slots(some),
        "exchange": exchange,
        "load": lambda env: env.load_state(env.save_state()),
    }


@pytest.mark.parametrize(
    ("maker", "tries"),
    [
        *((name, 25) for name in MAKERS),
        *(pytest.param(name, 1500, marks=pytest.mark.exhaustive) for name in MAKERS),
    ],
)
def test_an_interrupt_comes_before_a_call_or_after_it(maker: str, tries: int) -> None:
    if maker in ("rtl", "served board"):
        tries = min(tries, 400)
    rng = np.random.default_rng(0)
    env, other = MAKERS[maker](), MAKERS[maker]()
    for each in (env, other):
        each.reset_batch(0)
    before, came = env.save_state(), {False: 0, True: 0}
    for _ in range(tries):
        if not env.unwrapped.autoreset and not env.present.any():
            for each in (env, other):
                each.reset_batch(1)
            before = env.save_state()
        name, call = list(calls(other, rng).items())[rng.integers(4)]
        if name == "exchange" and (maker == "wrapped" or not env.unwrapped.autoreset):
            continue
        began = time.perf_counter()
        call(other)
        seconds = time.perf_counter() - began
        after = other.save_state()
        with_it = interrupted(lambda call=call: call(env), rng.uniform(0, 1.5) * seconds)  # type: ignore[misc]
        if env.unwrapped.device.phase is Phase.STEPPING:  # between the two halves of an exchange
            env.recv()
        state = env.save_state()
        assert state in (before, after), f"{name}: neither before nor after"
        came[state == after] += 1
        if (
            any("done to its end" in note for note in getattr(with_it, "__notes__", ()))
            and name != "exchange"
        ):
            assert state == after
        if state != after:
            call(env)
        before = after
        assert env.save_state() == before
    env.load_state(before)
    assert came[True]
    assert came[False] + came[True] >= tries // 2
    env.close()
    other.close()


def test_a_fork_between_send_and_recv_has_the_step_in_both_processes() -> None:
    # Slow enough that the step is still under way when the process forks.
    env = native(1, "Seaquest", 200_000)
    env.reset_batch(0)
    actions = np.zeros(200_000, env.spec.action.dtype)
    env.send(actions)
    child = os.fork()
    if child == 0:  # no test runner here: it ends at once, whatever happens
        signal.alarm(20)
        try:
            env.recv()
            env.save_state()
            os._exit(0)
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    env.recv()
    assert status == 0
