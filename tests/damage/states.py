"""Saved states, of environments and of those in wrappers."""

from __future__ import annotations

import io
import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

import pearl_marl
from pearl_marl import wrappers
from pearl_marl.errors import PearlError

from .damages import as_json, mutated
from .kind import Kind, Rng, expect


class SavedStates(Kind):
    """Saved states of an environment, without wrappers."""

    weight = 16

    def __init__(self, folder: Path, env_id: str = "CliffWalking", **arguments: Any) -> None:
        super().__init__(folder)
        self.env = pearl_marl.parallel_env(env_id, 6, max_cycles=20, **arguments)
        self.env.reset_batch(seed=1)
        self.actions = np.zeros((6, *self.env.action_space("agent_0").shape), np.int64)
        self.env.step_batch(self.actions)
        self.sample = self.env.save_state()

    def space(self) -> Any:
        return self.env.spec.observation_space

    def crafted(self, rng: Rng) -> bytes:
        length = struct.unpack_from("<Q", self.sample, 12)[0]
        head, arrays = self.sample[20 : 20 + length], bytearray(self.sample[20 + length :])
        if rng.integers(2):
            head = as_json(mutated(json.loads(head), rng))
        else:
            for at in rng.integers(len(arrays), size=int(rng.integers(1, 9))).tolist():
                arrays[at] = int(rng.choice([0, 1, 2, 15, 127, 128, 255]))
        body = struct.pack("<Q", len(head)) + head + arrays
        return self.sample[:8] + struct.pack("<I", zlib.crc32(body)) + body

    def read(self, content: bytes, sealed: bool) -> None:
        before = self.env.save_state()
        try:
            obs = self.env.load_state(content)
        except PearlError:
            expect(self.env.save_state() == before, "a refused state has changed something")
            raise
        if sealed:
            space = self.space()
            expect(all(space.contains(row) for row in obs), "an observation out of its space")
            blob = self.env.save_state()
            self.env.step_batch(self.actions)
            self.env.load_state(blob)
            expect(self.env.save_state() == blob, "a state that is another one after loading")
        else:
            expect(self.env.save_state() == self.sample, "a damaged state was taken")
        self.env.load_state(self.sample)


class StatesOfTurns(SavedStates):
    """Of worlds of two agents, with stored starts."""

    weight = 8

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "ConnectFour", initial_states="stored")


class StatesWithoutAutoreset(SavedStates):
    """With agents that may have left."""

    weight = 8

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "CartPole", autoreset=False)


class StatesOfWrappers(SavedStates):
    """Of an environment in wrappers that remember."""

    weight = 8

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "CartPole")
        self.env = wrappers.normalize_reward_v0(wrappers.frame_stack_v2(self.env, 3))
        self.env.reset_batch(seed=1)
        self.env.step_batch(self.actions)
        self.sample = self.env.save_state()

    def space(self) -> Any:
        return self.env.observation_space("agent_0")

    def crafted(self, rng: Rng) -> bytes:
        head, _, body = self.sample.partition(b"\0")
        with np.load(io.BytesIO(body)) as file:
            arrays = dict(file)
        name = str(rng.choice(list(arrays)))
        array = arrays[name].copy()
        match int(rng.integers(4)):
            case 0:
                arrays[name] = array.astype(str(rng.choice(["f2", "i8", "u1", "c8", "?"])))
            case 1:
                arrays[name] = np.zeros((int(rng.integers(9)), 0, 3), array.dtype)
            case 2:
                del arrays[name]
            case _:
                flat = array.reshape(-1).view(np.uint8)
                flat[int(rng.integers(flat.size))] = int(rng.choice([0, 1, 2, 127, 255]))
                arrays[name] = array
        file = io.BytesIO()
        np.savez(file, **arrays)
        return head + b"\0" + file.getvalue()
