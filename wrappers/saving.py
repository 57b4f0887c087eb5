"""A wrapper's part of a saved state, around the bytes of the environment inside."""

from __future__ import annotations

import io
import zipfile
import zlib
from typing import Any

import numpy as np

from pearl_marl.batch.step import Array
from pearl_marl.errors import SavedStateError

from .transform import Transform

_FORMAT = b"PEARLWR1"


def packed(inner: bytes, transform: Transform) -> bytes:
    """Return the bytes of an environment and of the transform around it, as one."""
    file = io.BytesIO()
    arrays: dict[str, Any] = {"inner": np.frombuffer(inner, np.uint8), **transform.snapshot()}
    np.savez(file, **arrays)
    return _FORMAT + type(transform).__name__.encode() + b"\0" + file.getvalue()


def unpacked(blob: bytes, transform: Transform) -> tuple[bytes, dict[str, Array]]:
    """Return the environment's bytes, and the snapshot for a transform like the one that was packed."""
    if not isinstance(blob, (bytes, bytearray, memoryview)):
        raise SavedStateError(f"a saved state is bytes, not {type(blob).__name__}")
    blob = bytes(blob)
    head, _, body = blob.partition(b"\0")
    name = type(transform).__name__.encode()
    if head != _FORMAT + name:
        raise SavedStateError(f"this is no saved state of an environment in a {name.decode()} wrapper")
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as file:
            saved = dict(file)
        inner = saved.pop("inner").tobytes()
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise SavedStateError(f"the saved state is damaged: {error}") from None
    for key, array in transform.snapshot().items():
        if key not in saved or saved[key].shape != array.shape or saved[key].dtype != array.dtype:
            raise SavedStateError(f"the saved state's {key!r} is not that of this wrapper")
    return inner, saved
