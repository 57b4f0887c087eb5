"""T1 and T7: what the host does of a step, measured by stepping its half of the protocol without hardware."""

from __future__ import annotations

import statistics
import time
from typing import NamedTuple

import numpy as np

from pearl_marl.batch.actions import random_actions
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.results import check_memory
from pearl_marl.devices.comm_bram import CommBram
from pearl_marl.devices.identity import identity
from pearl_marl.devices.transport import Exchange, Transport
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.codec import Stream, pack, stream_bytes
from pearl_marl.memory_map import MemoryMap, Status
from pearl_marl.spec import EnvSpec, Field


class HostTimes(NamedTuple):
    """What the host does of a step, in seconds."""

    pack: float
    """T1: check the actions and pack them."""
    unpack: float
    """T7: from packed results to arrays of observations, rewards and ends."""


ENDING = 100
"""One slot in so many ends its episode in a measured step; what follows an end is a part of T7."""


MOST_SECONDS, FEWEST = 3.0, 5
"""After so many seconds that many rounds are enough: with millions of slots each takes long."""


def measure_host(spec: EnvSpec, n_envs: int, rounds: int = 200) -> HostTimes:
    """Measure T1 and T7 on this machine: step the host's code without hardware, at most ``rounds`` times.

    They are medians of the thread's CPU time, so that other programs on the machine count less.
    """
    config = BatchConfig(spec=spec, n_envs=n_envs, copy=False)
    check_memory(config)
    device = NoHardware().open(config)
    answers = device.answers
    device.reset(seed=0)
    rng, times = np.random.default_rng(0), []
    for _ in range(rounds + 2):  # the first ones load the code
        actions = random_actions(spec, rng, config.n_agents, device.action_masks)
        began = time.thread_time()
        device.step(actions)
        ended = time.thread_time()
        times.append((answers.asked - began, ended - answers.answered))
        if len(times) > 2 + FEWEST and sum(map(sum, times)) > MOST_SECONDS:
            break
    device.close()
    packs, unpacks = zip(*times[2:], strict=True)
    return HostTimes(statistics.median(packs), statistics.median(unpacks))


class _Answers(Transport):
    """Answers every step at once: observations and rewards of zero, one slot in :data:`ENDING` at its end."""

    def __init__(self, build: Build) -> None:
        self._layout = layout = build.layout
        self._identity = np.array(identity(build), "<u4").view(np.uint8)
        ter = Field("ter", layout["ters"].slot_bits)
        all_agents = ter.dtype.type((1 << build.spec.agents) - 1)
        ters = np.where(np.arange(layout.n_envs) % ENDING == 0, all_agents, ter.dtype.type(0))
        self._ters = np.zeros(stream_bytes(layout.n_envs, ter.bits), np.uint8)
        pack(ters, ter.bits, self._ters, ter.bits)
        self._ters = self._ters[: layout.size("ters")]
        self.asked = self.answered = 0.0

    def write(self, offset: int, data: Stream) -> None:
        """Take everything."""

    def read(self, offset: int, data: Stream) -> None:
        data[:] = 0
        if offset == self._layout["control"].offset:
            data[: self._identity.size] = self._identity[: data.size]

    def wait(self, step: Exchange) -> None:
        """Be done."""

    def exchange(self, step: Exchange) -> None:
        self.asked = time.thread_time()
        ters = self._layout["ters"].offset - step.read_at
        step.answer[ters : ters + self._ters.size] = self._ters
        step.status[Status.SEQUENCE] = step.sequence
        self.answered = time.thread_time()

    def close(self) -> None:
        """Hold nothing."""


class NoHardware(CommBram):
    """The host's half of the protocol with nothing behind it."""

    name = "nothing"

    def _connect(self, config: BatchConfig) -> tuple[Transport, MemoryMap]:
        build = Build.of(config.spec, config.n_envs)
        self.answers = _Answers(build)
        return self.answers, build.layout
