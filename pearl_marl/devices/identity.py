"""What hardware says that it is, and whether a batch can be stepped by it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pearl_marl.envs import get_spec, names
from pearl_marl.errors import DeviceError
from pearl_marl.hardware import elaboration
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import MAGIC, PROTOCOL_VERSION, Control, MemoryMap, stream_bits
from pearl_marl.spec import EnvSpec, word_bits

_IDENTITY = tuple(word for word in Control if word < Control.SEED_0)


def identity(build: Build) -> tuple[int, ...]:
    """Return what the hardware of a batch has in the read-only words of its control region."""
    spec, layout = build
    return (
        MAGIC,
        PROTOCOL_VERSION,
        elaboration.env_hash(spec),
        layout.n_envs,
        layout.pe_num,
        layout.data_wl,
        word_bits(spec.state),
        sum(bits for name, bits in stream_bits(spec).items() if name != "actions"),
    )


def check_identity(name: str, read: Callable[[int, Any], None], build: Build) -> None:
    """Refuse hardware that is not what a batch needs; name the first word that differs, and both values.

    ``read`` is a transport's.
    """
    spec, layout = build
    expected = identity(build)
    found = np.empty(4 * len(_IDENTITY), np.uint8)
    read(layout["control"].offset, found)
    for field, mine, theirs in zip(_IDENTITY, expected, found.view("<u4").tolist(), strict=True):
        if theirs != mine:
            show = hex if field in (Control.MAGIC, Control.ENV_HASH) else str
            raise DeviceError(
                f"the {name} device has {field.name.lower()} {show(theirs)}, this batch needs {show(mine)}: "
                + _what_differs(field, theirs, spec, layout)
            )


def _what_differs(field: Control, theirs: int, spec: EnvSpec, layout: MemoryMap) -> str:
    """Return what hardware was built for, as far as a word of its identity tells, and what to do."""
    k, known = spec.agents, [get_spec(name) for name in names()]
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
