"""A call in which two devices part, with all that it takes to make it again: a small JSON file.

One slot is enough where that slot alone parts again, which a fault of a core does: see :meth:`Replay.alone`.
A fault of what lies around the cores may need its neighbours; then the file holds the whole batch.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from pearl_marl.base.files import check_readable, replace_file
from pearl_marl.batch.actions import check_words, room_for_words
from pearl_marl.batch.config import GOLDEN, BatchConfig, worlds_of
from pearl_marl.batch.results import check_memory
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.batch.slot_memory import size
from pearl_marl.devices.divergence import Difference, Divergence
from pearl_marl.envs import registered_spec
from pearl_marl.errors import ArgumentError, PearlError, brief, one_line
from pearl_marl.golden.rng import checked_seed

_FORMAT = "pearl verify replay"
_VERSION = 2


@dataclass(frozen=True, kw_only=True)
class Replay:
    """One call of a device, and the state before it: a step with ``actions``, a reset, or a restore."""

    config: BatchConfig
    divergence: Divergence
    """What differed when it was recorded; ``divergence.call`` names the call."""
    before: SavedState | None
    """The state before the call (of a ``restore``, the one restored); ``None`` before the first reset."""
    actions: npt.NDArray[Any] | None = None
    """The words of a step."""
    seed: int | None = None
    mask: npt.NDArray[np.bool_] | None = None

    def alone(self) -> Replay:
        """Return the same call for the slot that differs, without the others."""
        config = replace(self.config, n_envs=1, first_slot=self.divergence.slot)
        i = self.divergence.slot - self.config.first_slot
        before = None if self.before is None else self.before.cut(self.config.spec, slice(i, i + 1))
        agents = self.config.spec.agents
        actions = None if self.actions is None else self.actions[i * agents : (i + 1) * agents].copy()
        mask = None if self.mask is None else self.mask[i : i + 1].copy()
        return replace(self, config=config, before=before, actions=actions, mask=mask)

    def write(self, path: Path) -> None:
        """Write the file."""
        before = self.before
        if before is not None:  # so that it can be replayed once the golden functions have changed
            before = replace(before, identity={k: v for k, v in before.identity.items() if k != GOLDEN})
        value = {
            "format": _FORMAT,
            "version": _VERSION,
            "divergence": self.divergence.as_json(),
            "batch": self.config.identity(),
            "before": None if before is None else _packed(before.to_bytes()),
            "actions": None if self.actions is None else _packed(self.actions.tobytes()),
            "seed": self.seed,
            "mask": None if self.mask is None else _packed(self.mask.tobytes()),
        }
        value["checksum"] = checksum(value)
        replace_file(path, f"{json.dumps(value, indent=2)}\n".encode())

    @classmethod
    def read(cls, path: Path) -> Replay:
        """Read what :meth:`write` wrote; raise ArgumentError for what is something else, or damaged."""
        try:
            check_readable(path)
            value = json.loads(path.read_bytes())
            right = checksum(value) if isinstance(value, dict) else ""
        except (OSError, ValueError, RecursionError) as error:
            raise ArgumentError(f"{path} cannot be read as a replay file: {_why(error)}") from None
        if not isinstance(value, dict) or value.get("format") != _FORMAT:
            raise ArgumentError(f"{path} is no replay file of pearl verify")
        if value.get("version") != _VERSION:
            raise ArgumentError(
                f"{path} has version {brief(value.get('version'))}; this program reads version {_VERSION}"
            )
        if value.pop("checksum", None) != right:
            raise ArgumentError(f"{path} is damaged: its checksum is wrong")
        try:
            return cls._from_json(value)
        except PearlError as error:
            raise ArgumentError(f"{path}: {one_line(error)}") from None
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, zlib.error) as error:
            raise ArgumentError(f"{path} is damaged: {type(error).__name__}: {_why(error)}") from None

    @classmethod
    def _from_json(cls, value: dict[str, Any]) -> Replay:
        batch = value["batch"]
        try:
            spec = registered_spec(batch["environment"].rpartition("-v")[0])
        except ArgumentError as error:  # nothing is imported because a file says so
            raise ArgumentError(f"{error}; for one of a package of yours, give --env PACKAGE:ENV") from None
        spec = spec.with_options(**batch["options"])
        if spec.id != batch["environment"]:
            raise ArgumentError(f"it is of {batch['environment']}; here is {spec.id}")
        config = BatchConfig(
            spec=spec,
            n_envs=worlds_of(spec, batch["n_agents"]),
            autoreset_mode=AutoresetMode(batch["autoreset_mode"]),
            max_cycles=batch["max_cycles"],
            initial_states=batch["initial_states"],
            first_slot=batch["first_slot"],
        )
        check_memory(config)
        _check_divergence(value["divergence"], config)
        # What they take in memory follows from the batch; only the header of a state is not known so well.
        room = room_for_words(spec, config.n_agents)
        most = {
            "before": 3 * size(spec, config.n_envs) + len(json.dumps(batch)) + 10_000,
            "actions": room.nbytes,
            "mask": config.n_envs,
        }
        before, actions, mask = (
            None if value[name] is None else _unpacked(value[name], most[name], name) for name in most
        )
        if mask is not None and (len(mask) != config.n_envs or max(mask, default=0) > 1):
            raise ArgumentError(f"its mask is none of {config.n_envs} worlds")
        saved = None if before is None else SavedState.from_bytes(before, config)
        call = value["divergence"]["call"]
        words = None if actions is None else np.frombuffer(actions, room.dtype)
        if (words is not None) != (call == "step") or (before is None and call != "reset"):
            raise ArgumentError(f"it lacks what a {call} begins with, or has what that does not take")
        if call != "reset" and (value["seed"], mask) != (None, None):
            raise ArgumentError(f"a {call} has no seed and no mask")
        if words is not None:
            words = words.reshape(-1, *room.shape[1:])
            check_words(words, spec, room, config.first_slot)
        return cls(
            config=config,
            divergence=Divergence.from_json(value["divergence"]),
            before=saved,
            actions=words,
            seed=None if value["seed"] is None else checked_seed(value["seed"]),
            mask=None if mask is None else np.frombuffer(mask, np.bool_),
        )


_KINDS: dict[str, type] = {
    "environment": str,
    "device": str,
    "reference": str,
    "call": str,
    "step": int,
    "slot": int,
    "slots": int,
    "differences": list,
}
"""What a divergence is told by."""


def _check_divergence(told: dict[str, Any], config: BatchConfig) -> None:
    """Refuse what is told of a divergence that cannot have been."""
    for name, kind in _KINDS.items():
        # What is printed has no codes that a terminal would follow.
        if type(told[name]) is not kind or (kind is str and not told[name].isprintable()):
            raise ArgumentError(f"its {name} is {brief(told[name])}; it must be of the type {kind.__name__}")
    if told["call"] not in ("step", "reset", "restore", "snapshot"):
        raise ArgumentError(f"its call is {told['call']!r}; there is no such call")
    if not 0 <= told["step"] < 1 << 64 or not 1 <= told["slots"] <= config.n_envs:
        raise ArgumentError(
            f"its step is {brief(told['step'])}, and {brief(told['slots'])} of {config.n_envs} slots differ"
        )
    if not told["differences"]:
        raise ArgumentError("it has no differences")
    for difference in told["differences"]:
        if difference.keys() != set(Difference._fields) or not all(map(_is_word, difference.values())):
            raise ArgumentError(f"one of its differences is {brief(difference)}")
    actions = told["action"] if isinstance(told["action"], list) else [told["action"]]
    if not all(action is None or (_is_word(action) and not isinstance(action, str)) for action in actions):
        raise ArgumentError(f"its action is {brief(told['action'])}")
    if not 0 <= told["slot"] - config.first_slot < config.n_envs or told["environment"] != config.spec.id:
        raise ArgumentError(f"its slot {told['slot']} of {told['environment']} is none of its batch")
    state = {} if told["state_before"] is None else told["state_before"]
    if not isinstance(state, dict) or not all(type(w) is int and _is_word(n) for n, w in state.items()):
        raise ArgumentError(f"its state_before is {brief(state)}; it must be words by name")


def _is_word(value: Any) -> bool:
    """Return whether a value is a number, or a word for one that can be printed."""
    return value.isprintable() if isinstance(value, str) else isinstance(value, (bool, int, float))


def checksum(value: dict[str, Any]) -> str:
    """Return the checksum of a replay file's value, of all but itself."""
    text = json.dumps({name: value[name] for name in value if name != "checksum"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _why(error: Exception) -> str:
    return one_line(error.strerror if isinstance(error, OSError) and error.strerror else error)


def _packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode()


def _unpacked(text: str, most: int, name: str) -> bytes:
    """Return what :func:`_packed` packed; refuse more bytes than there can be, before there are."""
    stream = zlib.decompressobj()
    data = stream.decompress(base64.b64decode(text, validate=True), most + 1)
    if len(data) > most or not stream.eof or stream.unused_data:
        raise ArgumentError(f"its {name} is cut short, or longer than the {most:,} bytes that it can have")
    return data
