"""The CPU as a device: the compiled golden step, on one thread or several."""

from __future__ import annotations

import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from pearl_marl import slot_memory
from pearl_marl.devices.base import Array, BatchConfig, BatchStep, Device
from pearl_marl.errors import ArgumentError
from pearl_marl.kernel_source import BLOCK
from pearl_marl.kernels import compile_kernels

SLOW_STEP_SECONDS = 300e-6
"""From here on a second thread pays: handing it work and waiting for it costs about 50 us."""

SLOW_STEPS_TO_SWITCH = 3

MAX_SETS = 8
"""How many sets of results are kept for use again. Whoever holds more gets fresh memory."""


class Native(Device):
    """The CPU.

    Parameters
    ----------
    threads
        How many threads share a step. ``None`` starts with one and takes all the cores this
        process may use once steps prove long enough to pay for it. Results are the same.
    """

    name = "native"

    def __init__(self, threads: int | None = None) -> None:
        if threads is not None and (isinstance(threads, bool) or not isinstance(threads, int) or threads < 1):
            raise ArgumentError(f"threads is {threads!r}; it must be a positive integer or None")
        self._asked = threads

    def _open(self, config: BatchConfig) -> None:
        spec, n = config.spec, config.n_envs
        self._kernels = compile_kernels(spec)
        self._memory = slot_memory.allocate(spec, n)
        # Without stored initial states the kernels get the memory itself, and do not look.
        self._stored = slot_memory.allocate(spec, n) if config.initial_states == "stored" else self._memory
        self._next_step = config.autoreset_mode is AutoresetMode.NEXT_STEP
        self._sets = [_allocate(config)]
        self._threads = self._asked or 1
        self._slow_steps = 0
        self._pool: ThreadPoolExecutor | None = None

    def _results(self) -> BatchStep:
        """Return arrays to write a step's results into."""
        if not self.config.copy:
            return self._sets[0]
        # Fresh memory of this size costs more than the step does: the system clears every page of
        # it. So a set of arrays is used again once nobody outside refers to any of them.
        for results in self._sets:
            if all(sys.getrefcount(array) == _UNSHARED for array in results):
                break
        else:
            results = _allocate(self.config)
            if len(self._sets) < MAX_SETS:
                self._sets.append(results)
        return BatchStep(*results)

    def _ranges(self) -> list[tuple[int, int]]:
        """Split the slots at block boundaries into as many ranges as there are threads."""
        n = self.config.n_envs
        blocks = -(-n // BLOCK)
        parts = min(self._threads, blocks)
        edges = [blocks * i // parts * BLOCK for i in range(parts)] + [n]
        return list(zip(edges[:-1], edges[1:], strict=True))

    def _run(self, kernel: Any, before: tuple[Any, ...], after: tuple[Any, ...]) -> None:
        """Call ``kernel(*before, lo, hi, n, *after)`` for every range, one of them on this thread."""
        n = self.config.n_envs
        if self._threads == 1:
            kernel(*before, 0, n, n, *after)
            return
        first, *others = self._ranges()
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads - 1, thread_name_prefix="pearl-native")
        tasks = [self._pool.submit(kernel, *before, lo, hi, n, *after) for lo, hi in others]
        kernel(*before, *first, n, *after)
        for task in tasks:
            task.result()

    def _reset(self, mask: Array | None) -> Array:
        config, stored = self.config, self._stored
        n = config.n_envs
        flags = np.ones(n, np.uint8) if mask is None else mask.view(np.uint8)
        obs = self._results().obs
        use_stored = stored is not self._memory
        self._run(
            self._kernels.reset,
            (self._memory, stored, flags, obs, *self._seed, self._tick, config.first_slot),
            (use_stored and mask is not None,),
        )
        if use_stored and mask is None:
            stored[:] = self._memory
        return obs

    def _step(self, actions: Array) -> BatchStep:
        config, stored = self.config, self._stored
        results = self._results()
        began = time.perf_counter()
        self._run(
            self._kernels.step,
            (self._memory, stored, actions, self._table, *results, *self._seed, self._tick, config.first_slot),
            (config.limit, self._next_step, stored is not self._memory),
        )
        if self._asked is None and self._threads == 1 and time.perf_counter() - began > SLOW_STEP_SECONDS:
            self._slow_steps += 1
            if self._slow_steps == SLOW_STEPS_TO_SWITCH:
                self._threads = len(os.sched_getaffinity(0))
        return results._replace(final_obs=results.obs) if self._next_step else results

    def _read(self) -> tuple[Array, Array]:
        return self._memory, self._stored if self._stored is not self._memory else self._memory[:0]

    def _write(self, memory: Array, stored: Array) -> Array:
        self._memory[:] = memory
        if stored.size:
            self._stored[:] = stored
        return self._reset(np.zeros(self.config.n_envs, np.bool_))

    def _close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True)


def _allocate(config: BatchConfig) -> BatchStep:
    n, space = config.n_envs, config.spec.observation_space
    shape, dtype = (n, *(space.shape or ())), space.dtype
    flags = np.empty(n, np.bool_), np.empty(n, np.bool_)
    # In NEXT_STEP mode the observation of an ending step is the final one, so it has no use for two.
    final_rows = n if config.autoreset_mode is AutoresetMode.SAME_STEP else 0
    return BatchStep(
        np.zeros(shape, dtype), np.empty(n, np.float32), *flags, np.zeros((final_rows, *shape[1:]), dtype)
    )


# What sys.getrefcount tells of an array that only its set refers to: the set, the loop, the call.
_UNSHARED = 3
