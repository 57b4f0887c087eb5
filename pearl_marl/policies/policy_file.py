"""The file of a trained policy: tensors, a description, and a checksum over all of it.

A ``safetensors`` file, which other programs read too. Its metadata have ``format``, ``policy`` (JSON) and
``checksum``: SHA-256 of the header without it, in :func:`sealed`'s form, and of the tensors' bytes.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import load, save
from torch import Tensor, nn

from pearl_marl.base.files import check_readable, replace_file
from pearl_marl.errors import ArgumentError, brief

FORMAT = "pearl-policy-2"
_OLDER = "pearl-policy-1"


def write(path: Path, about: dict[str, Any], tensors: dict[str, Tensor]) -> None:
    """Write what :func:`read` reads."""
    replace_file(path, sealed(save(tensors, {"format": FORMAT, "policy": json.dumps(about)})))


def read(path: Path) -> tuple[Any, dict[str, Tensor]]:
    """Return a policy's description in a file, and its tensors; or raise ArgumentError.

    No memory is taken for more than the file holds, and a bit that flipped anywhere is noticed.
    """
    try:
        check_readable(path)
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise ArgumentError(f"{path} cannot be read as a policy: {why}") from None
    try:
        header, body = _parts(content)
        checksum = _checksum(header, body)
    except (ValueError, RecursionError):
        raise ArgumentError(f"{path} cannot be read as a policy: its header is damaged") from None
    metadata = header["__metadata__"]
    if metadata.get("format") == _OLDER:
        raise ArgumentError(
            f"{path} was written by an older version of this package, whose policies have no checksum: train "
            "it again, or use that version"
        )
    if metadata.get("format") != FORMAT:
        raise ArgumentError(
            f"{path} is no policy of `pearl train`: its format is {brief(metadata.get('format'))}"
        )
    if metadata.get("checksum") != checksum:
        raise ArgumentError(f"{path} is damaged: its checksum is wrong")
    try:
        return json.loads(metadata["policy"]), load(content)
    except (KeyError, TypeError, ValueError, RecursionError):
        raise ArgumentError(f"{path} is damaged: its metadata say nothing of its policy") from None
    except MemoryError:
        raise
    except Exception:  # whatever the library makes of places and types of tensors that nobody writes
        raise ArgumentError(f"{path} is damaged: its tensors are not where its header says") from None


_FIXED = "bound", "offsets"
"""Buffers that follow from the environment, and are not learned."""


def check_weights(module: nn.Module, tensors: Any, owner: str) -> None:
    """Refuse tensors from a file that are not those of a module, or that no training leaves.

    Compiled loops trust them: with other offsets, they would read beside a table.
    """
    wanted = module.state_dict()
    found = tensors if isinstance(tensors, Mapping) else {}
    for name in {**wanted, **found}:
        kinds = [
            f"{of[name].dtype} of shape {tuple(of[name].shape)}"
            if isinstance(of.get(name), Tensor)
            else "nothing"
            for of in (found, wanted)
        ]
        if kinds[0] != kinds[1]:
            raise ArgumentError(
                f"its tensors are not those of {owner}: {brief(name)} is {kinds[0]}, not {kinds[1]}"
            )
        tensor, last = found[name], name.rpartition(".")[2]
        if not tensor.isfinite().all():
            raise ArgumentError(f"{name} has NaN or an infinity among its numbers: the training diverged")
        if last in _FIXED and not tensor.equal(wanted[name].to(tensor.device)):
            raise ArgumentError(f"{name} has other numbers than {owner} has")
        if last in ("variance", "count") and tensor.min() < 0:
            raise ArgumentError(f"{name} has a number below 0")


def sealed(content: bytes) -> bytes:
    """Return a safetensors file with a checksum, and its header in order.

    The library's order differs from run to run.
    """
    header, body = _parts(content)
    header["__metadata__"]["checksum"] = _checksum(header, body)
    text = _ordered(header)
    text += b" " * (-len(text) % 8)  # tensors begin at a multiple of eight
    return struct.pack("<Q", len(text)) + text + body


def _parts(content: bytes) -> tuple[dict[str, Any], memoryview]:
    """Return the header of a safetensors file, which has metadata, and the rest; or raise ValueError."""
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    if not isinstance(header, dict) or not isinstance(header.get("__metadata__"), dict):
        raise ValueError("no metadata")
    return header, memoryview(content)[8 + size :]


def _checksum(header: dict[str, Any], body: memoryview) -> str:
    metadata = {name: text for name, text in header["__metadata__"].items() if name != "checksum"}
    summed = hashlib.sha256(_ordered({**header, "__metadata__": metadata}))
    summed.update(body)
    return summed.hexdigest()


def _ordered(header: dict[str, Any]) -> bytes:
    return json.dumps(header, sort_keys=True, separators=(",", ":")).encode()
