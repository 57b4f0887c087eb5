"""A batch's whole state as bytes, so that any device can go on where another stopped.

::

    magic and version (8 bytes) | CRC-32 (4) | length of header (8) | header, JSON | the three arrays
"""

from __future__ import annotations

import itertools
import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.batch.config import GOLDEN, BatchConfig
from pearl_marl.batch.rewards import reward_table
from pearl_marl.batch.slot_checks import check_counters, check_observations, check_words
from pearl_marl.batch.slot_memory import SlotMemory, size
from pearl_marl.errors import ArgumentError, SavedStateError, brief, one_line
from pearl_marl.golden.tracing.records import comparable
from pearl_marl.spec import EnvSpec

Bytes = npt.NDArray[np.uint8]

_MAGIC = b"PEARLST"
_VERSION = b"1"
_ARRAYS = ("memory", "stored", "present")


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
    present: Bytes
    """For strict PettingZoo lifetimes, one ``uint8`` an agent: whether it is still there."""

    def check(self, config: BatchConfig, autoreset: bool = True) -> None:
        """Raise SavedStateError where no batch of ``config`` can have been saved like this.

        Without ``autoreset``, agents that ended may have left.
        """
        check_identity(self.identity, config.identity())
        spec, n = config.spec, config.n_envs
        _check_integers("seed", self.seed, 2, 32)
        _check_integers("tick", (self.tick,), 1, 64)
        if not isinstance(self.rewards, tuple) or not all(
            type(reward) in (int, float) for reward in self.rewards
        ):
            raise SavedStateError(
                f"the saved state has rewards = {brief(self.rewards)}; they must be numbers"
            )
        try:
            reward_table(spec, self.rewards if self.rewards or spec.rewards is not None else None)
        except ArgumentError as error:
            raise SavedStateError(f"the saved state's {error}") from None
        slots = size(spec, n)
        lengths = (
            slots,
            slots if config.initial_states == "stored" else 0,
            0 if autoreset else config.n_agents,
        )
        for name, length in zip(_ARRAYS, lengths, strict=True):
            array = getattr(self, name)
            if not isinstance(array, np.ndarray) or array.dtype != np.uint8 or array.shape != (length,):
                raise SavedStateError(
                    f"the saved state has {np.size(array):,} bytes of {name}; this environment has {length:,}"
                )
        if self.present.size and self.present.max() > 1:
            raise SavedStateError(
                f"the saved state has {self.present.max()} for an agent that is present; possible are 0 and 1"
            )
        memory = SlotMemory(spec, n, self.memory)
        check_words(config, memory)
        check_counters(config, memory)
        if self.stored.size:
            check_words(config, SlotMemory(spec, n, self.stored))

    def cut(self, spec: EnvSpec, slots: slice) -> SavedState:
        """Return the state of some of the slots, for a device that has no others."""
        first, n = self.identity["first_slot"], self.identity["n_agents"] // spec.agents
        size = slots.stop - slots.start
        here = {"n_agents": size * spec.agents, "first_slot": first + slots.start}

        def share_of(memory: Bytes) -> Bytes:
            if not memory.size:  # there may be no stored initial states
                return memory
            whole, share = SlotMemory(spec, n, memory), SlotMemory(spec, size)
            for name, column in share.columns.items():
                column[:] = whole.columns[name][slots]
            return share.bytes

        return replace(
            self,
            identity={**self.identity, **here},
            memory=share_of(self.memory),
            stored=share_of(self.stored),
            present=self.present[slots.start * spec.agents : slots.stop * spec.agents],
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
            present=np.concatenate([part.present for part in parts]),
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
    def from_bytes(cls, blob: bytes, config: BatchConfig, autoreset: bool | None = None) -> SavedState:
        """Read what :meth:`to_bytes` returned, for an environment of ``config``.

        ``autoreset`` is part of its identity where it has agents that may leave: see :meth:`check`.

        Raises
        ------
        SavedStateError
            The bytes are damaged, of another version, or of another environment: names the first
            difference and both values. Or they hold what no step leaves.
        """
        identity = config.identity() if autoreset is None else {**config.identity(), "autoreset": autoreset}
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
        header = _header(bytes(body[8:start]))
        # Under other rules of the compiler the same functions have another hash.
        golden = header["identity"].get(GOLDEN)
        if not isinstance(golden, str) or not comparable(golden, identity[GOLDEN]):
            header["identity"][GOLDEN] = identity[GOLDEN]
        check_identity(header["identity"], identity, exactly=True)
        edges = list(itertools.accumulate(header["lengths"], initial=start))
        if edges[-1] != len(body):
            raise SavedStateError(
                f"the saved state is of {len(body):,} bytes, and by its header of {edges[-1]:,}"
            )
        whole = np.frombuffer(body, np.uint8)
        arrays = [whole[first:end] for first, end in itertools.pairwise(edges)]
        saved = cls(
            identity=identity,
            seed=tuple(header["seed"]),
            tick=header["tick"],
            rewards=tuple(header["rewards"]),
            **dict(zip(_ARRAYS, arrays, strict=True)),
        )
        saved.check(config, autoreset is not False)
        memories = [saved.memory, saved.stored] if saved.stored.size else [saved.memory]
        for memory in memories:
            check_observations(config, SlotMemory(config.spec, config.n_envs, memory))
        return saved


def check_identity(saved: dict[str, Any], mine: dict[str, Any], exactly: bool = False) -> None:
    """Raise SavedStateError where a saved identity differs; unless ``exactly`` it may have more."""
    # Options may hold what JSON has no type for, such as tuples: compare what becomes of them.
    saved, mine = json.loads(json.dumps([saved, mine]))
    for name in {**mine, **saved} if exactly else mine:
        # As text: True is 1 in Python.
        if name not in saved or json.dumps(saved[name]) != json.dumps(mine.get(name)):
            raise SavedStateError(
                f"the saved state has {one_line(name)} = {brief(saved.get(name))}; "
                f"this environment has {mine.get(name)!r}"
            )


def _header(text: bytes) -> dict[str, Any]:
    """Return the header of a saved state: the keys are there, and lists and dicts where they are due."""
    try:
        header = json.loads(text)
    except (ValueError, RecursionError):
        header = None
    kinds = {"identity": dict, "seed": list, "tick": int, "rewards": list, "lengths": list}
    if not isinstance(header, dict) or header.keys() != kinds.keys():
        raise SavedStateError("the saved state is damaged: its header is not one of this package's")
    for name, kind in kinds.items():
        if type(header[name]) is not kind:
            raise SavedStateError(
                f"the saved state has {name} = {brief(header[name])}; it must be of the type {kind.__name__}"
            )
    _check_integers("lengths", tuple(header["lengths"]), len(_ARRAYS), 63)
    return header


def _check_integers(name: str, value: Any, count: int, bits: int) -> None:
    """Raise SavedStateError for what is not a tuple of so many integers from 0, of so many bits."""
    right = isinstance(value, tuple) and len(value) == count
    if not right or not all(type(word) is int and 0 <= word < 1 << bits for word in value):
        told = value[0] if right and count == 1 else value
        what = "an integer" if count == 1 else f"{count} integers"
        raise SavedStateError(
            f"the saved state has {name} = {brief(told)}; it must be {what} from 0, below 2**{bits}"
        )
