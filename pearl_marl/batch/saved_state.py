"""A batch's whole state as bytes, so that any device can go on where another stopped.

::

    magic and version (8 bytes) | CRC-32 (4) | length of header (8) | header, JSON | the three arrays
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.errors import SavedStateError
from pearl_marl.spec import EnvSpec

Bytes = npt.NDArray[np.uint8]

_MAGIC = b"PEARLST"
_VERSION = b"1"
_ARRAYS = ("memory", "stored", "live")


@dataclass(frozen=True, kw_only=True)
class SavedState:
    """Everything that the continuation of a batch depends on."""

    identity: dict[str, Any]
    """What an environment must agree with to continue from here, by name."""
    seed: tuple[int, int]
    tick: int
    rewards: tuple[float, ...]
    memory: Bytes
    """The slots: see :mod:`pearl_marl.batch.slot_memory`."""
    stored: Bytes
    """Their stored initial states, if there are any."""
    live: Bytes
    """For strict PettingZoo lifetimes, one ``uint8`` an agent: whether it is still there."""

    def check(self, identity: dict[str, Any]) -> None:
        """Raise SavedStateError where this is no state of an environment of the given identity."""
        # Options may hold what JSON has no type for, such as tuples: compare what becomes of them.
        saved, mine = json.loads(json.dumps([self.identity, identity]))
        for name, value in mine.items():
            if saved.get(name) != value:
                raise SavedStateError(
                    f"the saved state has {name} = {saved.get(name)!r}; this environment has {value!r}"
                )

    def cut(self, spec: EnvSpec, slots: slice) -> SavedState:
        """Return the state of some of the slots, for a device that has no others."""
        first, n = self.identity["first_slot"], self.identity["n_agents"] // spec.agents
        size = slots.stop - slots.start
        here = {"n_agents": size * spec.agents, "first_slot": first + slots.start}

        def part(memory: Bytes) -> Bytes:
            if not memory.size:  # there may be no stored initial states
                return memory
            whole, share = SlotMemory(spec, n, memory), SlotMemory(spec, size)
            for name, column in share.columns.items():
                column[:] = whole.columns[name][slots]
            return share.bytes

        return replace(
            self,
            identity={**self.identity, **here},
            memory=part(self.memory),
            stored=part(self.stored),
            live=self.live[slots.start * spec.agents : slots.stop * spec.agents],
        )

    @classmethod
    def join(cls, spec: EnvSpec, parts: Sequence[SavedState]) -> SavedState:
        """Return the state of the slots of all parts, in their order; the inverse of :meth:`cut`."""
        sizes = [part.identity["n_agents"] // spec.agents for part in parts]

        def whole(name: str) -> Bytes:
            shares = [getattr(part, name) for part in parts]
            if not shares[0].size:
                return shares[0]  # type: ignore[no-any-return]
            columns = [SlotMemory(spec, n, share).columns for n, share in zip(sizes, shares, strict=True)]
            memory = SlotMemory(spec, sum(sizes))
            for name, column in memory.columns.items():
                np.concatenate([share[name] for share in columns], out=column)
            return memory.bytes

        return replace(
            parts[0],
            identity={**parts[0].identity, "n_agents": sum(sizes) * spec.agents},
            memory=whole("memory"),
            stored=whole("stored"),
            live=np.concatenate([part.live for part in parts]),
        )

    def copy(self) -> SavedState:
        """Return the same in memory of its own."""
        return replace(self, memory=self.memory.copy(), stored=self.stored.copy())

    def to_bytes(self) -> bytes:
        """Return the saved state as bytes."""
        header = {"identity": self.identity, "seed": self.seed, "tick": self.tick, "rewards": self.rewards}
        header["lengths"] = [len(getattr(self, name)) for name in _ARRAYS]
        head = json.dumps(header).encode()
        # Gigabytes, perhaps: copied once.
        arrays: list[Any] = [np.ascontiguousarray(getattr(self, name)) for name in _ARRAYS]
        body = [struct.pack("<Q", len(head)), head, *arrays]
        checksum = 0
        for part in body:
            checksum = zlib.crc32(part, checksum)
        return b"".join([_MAGIC, _VERSION, struct.pack("<I", checksum), *body])

    @classmethod
    def from_bytes(cls, blob: bytes, identity: dict[str, Any]) -> SavedState:
        """Read what :meth:`to_bytes` returned, for an environment of the given identity.

        Raises
        ------
        SavedStateError
            The bytes are damaged, of another version, or of another environment: names the first
            difference and both values.
        """
        if not isinstance(blob, (bytes, bytearray, memoryview)):
            raise SavedStateError(f"a saved state is bytes, not {type(blob).__name__}")
        blob = bytes(blob)
        version, body = blob[len(_MAGIC) : len(_MAGIC) + 1], memoryview(blob)[len(_MAGIC) + 5 :]
        if not blob.startswith(_MAGIC):
            raise SavedStateError("these bytes are no saved state of PEARL-MARL")
        if version != _VERSION:
            raise SavedStateError(
                f"the saved state has version {version.decode(errors='replace')!r}; "
                f"this program reads version {_VERSION.decode()!r}"
            )
        if len(body) < 8 or zlib.crc32(body) != struct.unpack_from("<I", blob, len(_MAGIC) + 1)[0]:
            raise SavedStateError("the saved state is damaged or cut short: its checksum is wrong")
        start = 8 + struct.unpack_from("<Q", body)[0]
        header = json.loads(bytes(body[8:start]))
        arrays = np.split(np.frombuffer(body, np.uint8, offset=start), np.cumsum(header["lengths"])[:-1])
        saved = cls(
            identity=header["identity"],
            seed=tuple(header["seed"]),
            tick=header["tick"],
            rewards=tuple(header["rewards"]),
            **dict(zip(_ARRAYS, arrays, strict=True)),
        )
        saved.check(identity)
        return replace(saved, identity=identity)
