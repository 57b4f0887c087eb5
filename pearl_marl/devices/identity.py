"""What hardware says that it is, and whether a batch can be stepped by it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pearl_marl.envs import get_spec, names
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware import elaboration
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import (
    ENGINE_KINDS,
    MAGIC,
    PROTOCOL_VERSION,
    Control,
    Engine,
    MemoryMap,
    Statistics,
    default_map,
    memory_map,
    stream_bits,
)
from pearl_marl.spec import EnvSpec, word_bits

Read = Callable[[int, Any], None]
"""A transport's: fill an array with what is at a byte address."""

_IDENTITY = tuple(word for word in Control if word < Control.SEED_0)


def identity(build: Build) -> tuple[int, ...]:
    """Return what the hardware of a batch has in the read-only words of its control region."""
    spec, layout = build
    kind = "none" if layout.engine is None else layout.engine.kind
    return (
        MAGIC,
        PROTOCOL_VERSION | ENGINE_KINDS.index(kind) << 16,
        elaboration.env_hash(spec),
        layout.n_envs,
        layout.pe_num,
        layout.data_wl,
        word_bits(spec.state),
        sum(bits for name, bits in stream_bits(spec).items() if name != "actions"),
    )


def stated_map(read: Read, spec: EnvSpec, n_envs: int) -> MemoryMap:
    """Return the memory map of hardware for so many slots, with the sizes and the engine that it states.

    Hardware that is not for so many slots gets the default map, and :func:`check_identity` refuses it.
    """
    words = _words(read, 4 * Control.MAGIC, len(_IDENTITY))
    try:
        layout = memory_map(spec, n_envs, words[Control.PE_NUM], words[Control.DATA_WL])
    except ArgumentError:
        return default_map(spec, n_envs)
    kind = words[Control.PROTOCOL_VERSION] >> 16
    words[Control.PROTOCOL_VERSION] &= 0xFFFF
    if not 0 < kind < len(ENGINE_KINDS) or words != [*identity(Build(spec, layout))]:
        return layout
    engine = Engine.of_words(kind, _engine_words(read, layout))
    return memory_map(spec, n_envs, layout.pe_num, layout.data_wl, engine)


def _engine_words(read: Read, layout: MemoryMap) -> list[int]:
    """Return what hardware says of its policy engine; it stands behind the status."""
    return _words(read, layout.end("status") + 4 * Statistics.ENGINE, len(Engine().words))


def _words(read: Read, address: int, count: int) -> list[int]:
    found = np.empty(4 * count, np.uint8)
    read(address, found)
    words: list[int] = found.view("<u4").tolist()
    return words


def check_identity(name: str, read: Read, build: Build) -> None:
    """Refuse hardware that is not what a batch needs; name the first word that differs, and both values."""
    spec, layout = build
    expected, found = identity(build), _words(read, layout["control"].offset, len(_IDENTITY))
    version, stated = expected[Control.PROTOCOL_VERSION], found[Control.PROTOCOL_VERSION]
    found[Control.PROTOCOL_VERSION] ^= (version ^ stated) & 0xFFFF0000  # which is looked at last
    for field, mine, theirs in zip(_IDENTITY, expected, found, strict=True):
        if theirs != mine:
            show = hex if field in (Control.MAGIC, Control.ENV_HASH) else str
            raise DeviceError(
                f"the {name} device has {field.name.lower()} {show(theirs)}, this batch needs {show(mine)}: "
                + _what_differs(field, theirs, spec, layout)
            )
    engine = layout.engine
    if version != stated or (engine is not None and _engine_words(read, layout) != engine.words):
        raise DeviceError(
            f"the {name} device has another policy engine than this batch has been opened for: load the same "
            "bitstream, or make a new environment"
        )


def _what_differs(field: Control, theirs: int, spec: EnvSpec, layout: MemoryMap) -> str:
    """Return what hardware was built for, as far as a word of its identity tells, and what to do."""
    k, known = spec.agents, [get_spec(name) for name in names()]
    if field is Control.PROTOCOL_VERSION:
        return "it is built by another version of this program; build it anew"
    if field is Control.N_ENVS:
        ours = layout.n_envs * k
        return f"it is built for {theirs * k:,} agents, not {ours:,}: take as many, or build it anew"
    if field is Control.ENV_HASH:
        hashes = {elaboration.env_hash(other): other.id for other in known}
        usual = next((other.options for other in known if other.id == spec.id), {})
        changed = {name: value for name, value in spec.options.items() if usual.get(name) != value}
        wanted = spec.id + (f" with {changed}" if changed else "")
        held = hashes.get(theirs, "another environment, or one with other options or golden functions")
        if held == wanted:
            held += " with other golden functions"
        return f"it is built for {held}, not for {wanted}: name that, or build it anew"
    return (
        f"it takes hardware built for {spec.id}, {layout.n_envs:,} slots, pe_num {layout.pe_num} and data_wl "
        f"{layout.data_wl}"
    )
