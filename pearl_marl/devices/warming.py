"""Compiling kernels before they are needed, an environment in each process."""

from __future__ import annotations

import contextlib
import io
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np
from numba.core import event

from pearl_marl.batch.actions import random_actions
from pearl_marl.batch.config import BatchConfig
from pearl_marl.compiler.packing import FORMS, observed_as
from pearl_marl.devices.native import Native
from pearl_marl.devices.threads import cores
from pearl_marl.envs import get_spec
from pearl_marl.policies.integer_network import unchanging_network


class Warmed(NamedTuple):
    """What was done for one environment."""

    environment: str
    """Its id."""
    compiled: int
    """How many functions were not in the cache yet."""
    seconds: float
    """How long it took."""


def compiled_by(work: Callable[[], None]) -> int:
    """Do some work; return how many functions were compiled for it, of which each would say so by itself."""
    with event.install_recorder("numba:compile") as compiled, contextlib.redirect_stderr(io.StringIO()):
        work()
    return sum(moment.is_start for _, moment in compiled.buffer)


def warm(env_id: str, options: dict[str, Any]) -> Warmed:
    """Reset, step and roll out an environment in every form of its observations, which fills the cache.

    What all rollouts have in common is compiled with the first.
    """
    began = time.perf_counter()
    spec = get_spec(env_id).with_options(**options)

    def step_once() -> None:
        for form in FORMS if spec.unpack is not None else FORMS[:1]:
            device = Native(threads=1).open(BatchConfig(spec=observed_as(spec, form), n_envs=1))
            device.reset(seed=0)
            masks: Any = device.action_masks
            device.step(random_actions(spec, np.random.default_rng(0), spec.agents, masks))
            if form == FORMS[0]:
                device.rollout(unchanging_network(device.config.spec), 1)
            device.close()

    compiled = compiled_by(step_once)
    return Warmed(spec.id, compiled, time.perf_counter() - began)


def warm_all(env_ids: Iterable[str], options: dict[str, Any]) -> Iterator[Warmed]:
    """Do so for several environments, as many at once as there are cores; yield each when it is done."""
    ids = list(env_ids)
    workers = min(len(ids), cores())
    if workers < 2:
        yield from (warm(env_id, options) for env_id in ids)
        return
    pool = ProcessPoolExecutor(workers, get_context("spawn"))
    try:
        # Ctrl-C is the parent's to answer: processes have blocked what was blocked when they started.
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            begun = [pool.submit(warm, env_id, options) for env_id in ids]
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
        for done in as_completed(begun):
            yield done.result()
    finally:
        pool.shutdown(cancel_futures=True)
