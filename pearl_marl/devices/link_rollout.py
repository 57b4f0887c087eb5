"""Rollouts in hardware: a policy, a number of steps and a doorbell go there, and sums come back."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.batch.rollout import Rollout
from pearl_marl.checks import checked_integer
from pearl_marl.devices.transport import Transport, word
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware.policy_words import Quanta, Words, policy_words, quanta
from pearl_marl.memory_map import (
    SECTION_BITS,
    Control,
    Doorbell,
    MemoryMap,
    Mode,
    Section,
    Statistics,
    Status,
    StatusError,
)
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.spec import EnvSpec


class LinkRollout(NamedTuple):
    """A rollout that fits the hardware behind a link."""

    layout: MemoryMap
    sections: dict[Section, Words]
    rewards: Quanta
    agents: int
    steps: int

    @classmethod
    def of(
        cls,
        policy: DevicePolicy,
        layout: MemoryMap,
        spec: EnvSpec,
        rewards: npt.NDArray[np.float32],
        steps: int,
        longest: int,
    ) -> LinkRollout:
        """Return the rollout of a policy; raise ArgumentError where the hardware has no engine that takes it.

        ``rewards`` are those of the categories, and ``longest`` the time limit, 0 if there is none.
        """
        steps = checked_integer("steps", steps, 1, (1 << 32) - 1)
        if layout.engine is None:
            raise ArgumentError("the hardware has no policy engine; take a build with one, or another device")
        sections = policy_words(policy, layout.engine)
        whole = quanta(spec, rewards, min(steps, longest or steps))
        return cls(layout, sections, whole, layout.n_envs * spec.agents, steps)

    def load(self, transport: Transport) -> None:
        """Write the policy. It stays until another one is written, also over a reset."""
        for section, words in self.sections.items():
            self._write(transport, section, words)

    def run(self, transport: Transport, mode: Mode, sequence: int, patience: float) -> tuple[Rollout, int]:
        """Do the rollout; return what became of its episodes, as sums over all agents, and the clock cycles.

        Raises
        ------
        DeviceError
            The hardware was reset, or refused a write, or has done no step for ``patience`` seconds.
        """
        self._write(transport, Section.QUANTA, self.rewards.numbers)
        transport.write(4 * Control.STEPS, np.array([self.steps], "<u4").view(np.uint8))
        doorbell = np.array([mode | Mode.ROLLOUT, sequence], "<u4")
        transport.write(self.layout["doorbell"].offset, doorbell.view(np.uint8))
        status = np.zeros(4 * len(Status), np.uint8)
        at, done, until = self.layout["statistics"].offset, -1, time.monotonic() + patience
        rings = self.layout["doorbell"].offset + 4 * Doorbell.SEQUENCE
        arrived = False
        while True:
            transport.pause()
            transport.read(self.layout["status"].offset, status)
            found = status.view("<u4")
            error = StatusError(int(found[Status.ERROR]))
            if error & StatusError.RESET:
                # A status from before the doorbell may still tell of an earlier reset; a reset since then has
                # cleared the doorbell.
                rung = word(transport, rings)
                if rung != sequence and (arrived or time.monotonic() > until):
                    raise DeviceError("the hardware was reset in a rollout; reset, or load a saved state")
                arrived = rung == sequence
            else:
                arrived = True
            if error & (StatusError.BUSY_WRITE | StatusError.BUSY_DOORBELL):
                raise DeviceError(
                    f"the hardware reports {error.name} in a rollout; reset, or load a saved state"
                )
            if found[Status.SEQUENCE] == sequence:
                break
            if time.monotonic() > until:
                before, done = done, word(transport, at + 4 * Statistics.STEPS)
                until = time.monotonic() + patience
                if done == before:
                    raise DeviceError(
                        f"the hardware has done {done:,} of {self.steps:,} steps of a rollout, and none for "
                        f"{patience:g} s: check that its clock runs, or give a longer timeout"
                    )
        sums = np.zeros(4 * Statistics.ENGINE, np.uint8)
        transport.read(at, sums)
        words = sums.view("<i8")

        def total(name: Statistics) -> int:
            return int(words[name // 2])

        rollout = Rollout(
            steps=self.steps,
            truncated=np.array([total(Statistics.TRUNCATED)]),
            returns=np.array([total(Statistics.RETURNS) * self.rewards.quantum]),
            squares=np.array([np.nan]),
            lengths=np.array([total(Statistics.LENGTHS)]),
            ended=np.array([total(Statistics.EPISODES)]),
        )
        return rollout, total(Statistics.CYCLES)

    def _write(self, transport: Transport, section: Section, words: Words) -> None:
        """Write the numbers that a section begins with, each to a word of its own."""
        if words.size:
            region, width = self.layout["policy"], self.layout.data_wl // 32
            spread = np.zeros((len(words), width), "<u4")
            spread[:, 0] = words
            start = section * (region.words >> SECTION_BITS) * 4 * width
            transport.write(region.offset + start, spread.view(np.uint8).ravel())
