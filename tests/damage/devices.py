"""What devices read: replays of divergences, files of served boards, and what sysfs tells."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

import numpy as np

import pearl_marl
from pearl_marl.devices import BatchConfig, Lockstep, Native, Xdma, by_name, discovery
from pearl_marl.devices import replay as replaying
from pearl_marl.devices.served import ServedBoard
from pearl_marl.errors import LockstepError
from pearl_marl.verification import replay

from ..devices.broken import Flips
from .damages import as_json, mutated
from .kind import Kind, Rng, expect


class Broken(Flips):
    """A device that flips a reward of slot 3 at tick 2."""

    name = "broken"

    def __init__(self) -> None:
        super().__init__("rewards", tick=2, slot=3)


class Replays(Kind):
    """Files of ``pearl verify``."""

    weight = 16

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        by_name._BY_NAME["broken"] = Broken
        self.file = folder / "divergence.json"
        lockstep = Lockstep(Broken(), "reference")
        lockstep.open(BatchConfig(spec=pearl_marl.get_spec("CliffWalking"), n_envs=5))
        lockstep.reset(0)
        try:
            for _ in range(9):
                lockstep.step(np.zeros(5, np.uint8))
        except LockstepError as error:
            error.replay.write(self.file)
        self.sample = self.file.read_bytes()
        self.value = json.loads(self.sample)

    def crafted(self, rng: Rng) -> bytes:
        value = mutated(self.value, rng)
        if isinstance(value, dict):
            value["checksum"] = replaying.checksum(value)
        return as_json(value)

    def read(self, content: bytes, sealed: bool) -> None:
        self.file.write_bytes(content)
        found = replaying.Replay.read(self.file)
        if not sealed:
            expect(json.loads(content) == self.value, "another replay")
        replay(found, Lockstep("native", "reference"))
        expect("\x1b" not in str(found.divergence), "a terminal's codes")


class Boards(Kind):
    """The files of a served board, which a device reads."""

    weight = 6

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.config = BatchConfig(spec=pearl_marl.get_spec("CliffWalking"), n_envs=8)
        self.board = ServedBoard(folder, self.config.spec, 8)
        self.thread = threading.Thread(target=self.board.serve, daemon=True)
        self.thread.start()
        self.file = folder / "xdma0_c2h_0"
        self.sample = self.file.read_bytes()[: self.board.layout.end("control")]
        native = Native().open(self.config)
        native.reset(3)
        self.step = native.step(np.zeros(8, np.uint8))

    def read(self, content: bytes, sealed: bool) -> None:
        whole = content[: len(self.sample)].ljust(len(self.sample), b"\0")
        self.write(whole)
        device = Xdma(self.folder, timeout=0.2)
        try:
            device.open(self.config)
            device.reset(3)
            step = device.step(np.zeros(8, np.uint8))
            expect(all(map(np.array_equal, step.arrays, self.step.arrays)), "another step")
        finally:
            device.close()
            self.write(self.sample)

    def write(self, content: bytes) -> None:
        with self.file.open("r+b") as file:
            file.write(content)

    def close(self) -> None:
        self.board.stop()
        self.thread.join()
        self.board.close()


class Locks(Kind):
    """The lock of a server, and what sysfs tells of boards."""

    weight = 6

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.sample = f"{os.getpid()}\n".encode()
        node = folder / "class" / "xdma" / "xdma0_h2c_0" / "device"
        node.mkdir(parents=True)
        self.files = [node / "vendor", node / "device"]
        discovery.SYS = folder

    def read(self, content: bytes, sealed: bool) -> None:
        for file in self.files:
            file.write_bytes(content)
        discovery.boards()
        discovery.boards_without_driver()
