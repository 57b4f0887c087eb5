"""Writes what a host does at the backbone's memory port, and what it has to read there, as a text.

Each line is an access, a wait or a reset; mutants.cpp reads them. The model says what results a step has.
"""

from __future__ import annotations

import numpy as np
from model import ELAPSED, Model

from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import Control, Mode, Region, Status
from pearl_marl.spec import Field

OKAY, REFUSED, HOLE = 0, 2, 3
"""Answers of the memory port."""

ALL = 0xFFFFFFFF


class Script:
    """What a host does at the memory port, word by word, and what it has to read."""

    def __init__(self, build: Build) -> None:
        self.spec, self.layout = build
        self.lines: list[str] = []
        self.random = np.random.default_rng(1)
        self.model = Model(*build)
        self.sequence = self.mode = 0

    def part(self, name: str) -> None:
        self.lines.append(f"t {name}")

    def write(self, word: int, value: int, answer: int = OKAY) -> None:
        self.lines.append(f"w {word:x} {value:x} 0 {answer:x}")

    def read(self, word: int, value: int = 0, answer: int = OKAY, mask: int = ALL) -> None:
        self.lines.append(f"r {word:x} {value:x} {mask:x} {answer:x}")

    def fetch(self, word: int, value: int = 0, answer: int = OKAY) -> None:
        self.lines.append(f"f {word:x} {value:x} {ALL if answer == OKAY else 0:x} {answer:x}")

    def read_the_same(self, word: int) -> None:
        """Read what the sound design reads."""
        self.lines.append(f"c {word:x} 0 0 0")

    def write_the_same(self, word: int, value: int) -> None:
        """Write, and be answered as by the sound design."""
        self.lines.append(f"v {word:x} {value:x} 0 0")

    def wait(self, cycles: int) -> None:
        self.lines.append(f"n {cycles:x}")

    def interrupt(self, value: bool) -> None:
        self.lines.append(f"q {value:x}")

    def finish(self, within: int = 1024) -> None:
        """Wait for the interrupt, for so many cycles at most."""
        self.wait(6)  # until the doorbell is through the port
        self.interrupt(False)
        self.lines.append(f"i {within:x}")

    def reset(self, soft: bool) -> None:
        """Reset, for a cycle or by writing to the control region, and wait until the pipeline has drained."""
        if soft:
            self.control(Control.RESET, 1 << int(self.random.integers(32)))
        else:
            self.lines.append("x 1")
        for _ in range(40):
            self.read_the_same(self.first("status") + Status.ERROR)
        self.sequence = self.mode = 0

    # ---- Regions ----

    def first(self, name: str) -> int:
        return self.layout[name].offset // 4

    def write_bytes(self, name: str, data: bytes) -> None:
        for i, value in enumerate(np.frombuffer(data, "<u4")):
            self.write(self.first(name) + i, int(value))

    def read_bytes(self, name: str, data: bytes) -> None:
        for i, value in enumerate(np.frombuffer(data, "<u4")):
            self.read(self.first(name) + i, int(value))

    def control(self, word: Control, value: int) -> None:
        self.write(self.first("control") + word, value)

    def status(self, word: Status, value: int) -> None:
        self.read(self.first("status") + word, value)

    # ---- Steps ----

    def load(self) -> None:
        """Write the model's settings."""
        for word, value in settings(self.model).items():
            self.control(word, value)

    def ring(self, mode: Mode, mask: np.ndarray, actions: np.ndarray) -> dict[str, bytes]:
        """Write what a step takes, the doorbell last; return what it has to make."""
        bits = self.model.bytes_of("reset_mask", (Field("bit", 1),), [mask.astype(np.uint8)])
        self.write_bytes("reset_mask", bits)
        self.write_bytes("actions", self.model.bytes_of("actions", self.spec.action_fields, [actions]))
        # The bits that mean nothing are kept, and do nothing.
        self.mode = mode | int(self.random.integers(0, 1 << 28)) << 4
        self.write(self.first("doorbell"), self.mode)
        # One bit is enough to tell it from the last.
        self.sequence ^= 1 << int(self.random.integers(32))
        self.write(self.first("doorbell") + 1, self.sequence)
        return self.model.step(mode, mask, actions)

    def some(self) -> tuple[np.ndarray, np.ndarray]:
        """Return a reset mask and actions."""
        n = self.layout.n_envs
        return self.random.random(n) < 0.3, self.random.integers(0, self.spec.action_space.n, n).astype(
            np.uint8
        )

    def results(self, expected: dict[str, bytes]) -> None:
        for name, data in expected.items():
            self.read_bytes(name, data)

    def registers(self) -> None:
        """Read all that the step should have left alone, and the tick."""
        model, doorbell = self.model, self.first("doorbell")
        for word, value in settings(model).items():
            self.read(self.first("control") + word, value)
        self.read(doorbell, self.mode)
        self.read(doorbell + 1, self.sequence)

    def states(self) -> tuple[bytes, bytes]:
        model = self.model
        states = model.bytes_of("current_states", (*self.spec.state, *model.ter), [*model.states, model.ters])
        return states, model.bytes_of("elapsed", ELAPSED, [model.elapsed])


def settings(model: Model) -> dict[Control, int]:
    return {
        Control.SEED_0: model.seed[0],
        Control.SEED_1: model.seed[1],
        Control.TICK_LOW: model.tick & ALL,
        Control.TICK_HIGH: model.tick >> 32,
        Control.FIRST_SLOT: model.first_slot,
        Control.MAX_CYCLES: model.max_cycles,
    }


def kept(region: Region, word: int, slots: int) -> int:
    """Return which bits of a word the hardware keeps, of a memory of so many slots."""
    if region.rows == 1:
        return ALL
    row, column = divmod(word, region.row_words)
    bits = min(region.row_slots, slots - row * region.row_slots) * region.slot_bits - column * 32
    return (1 << min(32, max(0, bits))) - 1
