"""The backbone in Python: what it must answer, word for word, made of the golden functions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from pearl_marl.golden import call_reference, rng
from pearl_marl.hardware.codec import pack, stream_bytes, unpack
from pearl_marl.memory_map import ELAPSED_BITS, MemoryMap, Mode, Region, ter_bits
from pearl_marl.spec import EnvSpec, Field

Columns = list[npt.NDArray[np.integer]]

ELAPSED = (Field("elapsed", ELAPSED_BITS),)


def pack_region(layout: MemoryMap, region: Region, fields: Sequence[Field], columns: Columns) -> bytes:
    """The bytes of a region whose slots hold ``columns``, a value of each field."""
    row_bytes = region.row_words * layout.data_wl // 8
    packed = bytearray()
    for row in range(region.rows):
        slots = slice(row * region.row_slots, (row + 1) * region.row_slots)
        count = len(columns[0][slots])
        stream = np.zeros(max(stream_bytes(count, region.slot_bits), row_bytes + -row_bytes % 8), np.uint8)
        offset = 0
        for field, column in zip(fields, columns, strict=True):
            pack(column[slots], field.bits, stream, region.slot_bits, offset)
            offset += field.bits
        packed += stream.tobytes()[:row_bytes]
    return bytes(packed)


def unpack_region(layout: MemoryMap, region: Region, fields: Sequence[Field], data: bytes) -> Columns:
    """The inverse of :func:`pack_region`."""
    row_bytes = region.row_words * layout.data_wl // 8
    columns: Columns = [np.zeros(layout.n_envs, field.dtype) for field in fields]
    for row in range(region.rows):
        slots = slice(row * region.row_slots, (row + 1) * region.row_slots)
        count = len(columns[0][slots])
        stream = np.zeros(max(stream_bytes(count, region.slot_bits), row_bytes + -row_bytes % 8), np.uint8)
        stream[:row_bytes] = np.frombuffer(data[row * row_bytes : (row + 1) * row_bytes], np.uint8)
        offset = 0
        for field, column in zip(fields, columns, strict=True):
            values = np.zeros(count, field.dtype)
            unpack(stream, field.bits, values, region.slot_bits, offset)
            column[slots] = values
            offset += field.bits
    return columns


class Model:
    """All slots of one device."""

    def __init__(self, spec: EnvSpec, layout: MemoryMap) -> None:
        self.spec, self.layout = spec, layout
        n = layout.n_envs
        self.seed = (0, 0)
        self.tick = self.first_slot = self.max_cycles = 0
        self.initial_states: Columns = [np.zeros(n, f.dtype) for f in spec.state]
        self.states: Columns = [np.zeros(n, f.dtype) for f in spec.state]
        self.elapsed = np.zeros(n, np.uint32)
        self.ter = (Field("ter", ter_bits(spec)),)
        self.ters = np.zeros(n, self.ter[0].dtype)

    def step(
        self, mode: Mode, mask: npt.NDArray[np.bool_], actions: npt.NDArray[np.uint8]
    ) -> dict[str, bytes]:
        """Take a step; return the bytes of the three result regions."""
        spec, n = self.spec, self.layout.n_envs
        slots = np.arange(n) + self.first_slot
        draws = [rng.draws(self.seed, slots, self.tick, i) for i in range(spec.reset_draws + spec.step_draws)]
        # A slot has ended by its time limit, or once all its agents have.
        every = (1 << spec.agents) - 1
        ended = (self.ters >> spec.agents != 0) | (self.ters & every == every)
        named = (mask & bool(mode & Mode.RESET_MASK)) | bool(mode & Mode.RESET_ALL)
        first = ended | named
        hold = ended & ~named & bool(mode & Mode.NEXT_STEP)
        if mode & Mode.STORED:
            start = self.initial_states
        else:
            drawn = call_reference(spec.positional.initial, draws[: spec.reset_draws])
            start = [
                np.broadcast_to(np.asarray(w).astype(f.dtype), n)
                for w, f in zip(drawn, spec.state, strict=True)
            ]
        origin = [np.where(first, s, w) for s, w in zip(start, self.states, strict=True)]
        given = actions.reshape(n, spec.agents).T
        results = call_reference(spec.positional.step, [*origin, *given, *draws[spec.reset_draws :]])
        moved, outcome = results[: len(spec.state)], results[len(spec.state) :]
        rewards, flags = outcome[: spec.agents], outcome[spec.agents :]
        self.states = [np.where(hold, o, m) for o, m in zip(origin, moved, strict=True)]
        self.elapsed = np.where(hold, 0, np.where(first, 0, self.elapsed) + 1).astype(np.uint32)
        truncated = (self.elapsed >= self.max_cycles) & (self.max_cycles != 0) & ~hold
        gone = np.where(first, 0, self.ters)
        for k, flag in enumerate(flags):
            gone = gone | np.where(hold, 0, flag).astype(self.ters.dtype) << k
        self.ters = (truncated.astype(self.ters.dtype) << spec.agents | gone).astype(self.ters.dtype)
        self.tick += 1
        observed = [
            word
            for agent in spec.views
            for view in spec.functions[2:]
            for word in call_reference(view, self.states, *agent)
        ]
        columns = {
            "observations": (
                spec.agent_fields * spec.agents,
                [np.broadcast_to(word, n) for word in observed],
            ),
            "rewards": (spec.each_agent(spec.reward), [np.where(hold, 0, reward) for reward in rewards]),
            "ters": (self.ter, [self.ters]),
        }
        return {name: self.bytes_of(name, *of) for name, of in columns.items()}

    def bytes_of(self, name: str, fields: Sequence[Field], columns: Columns) -> bytes:
        return pack_region(self.layout, self.layout[name], fields, columns)
