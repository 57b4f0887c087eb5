"""The user's cache folder: compiled kernels and simulated devices are kept there between runs.

``PEARL_CACHE_DIR`` moves it. What is loaded from it carries a checksum: an entry that a full disk or a crash
has damaged is made again. Nothing depends on the folder: where it cannot be written, or is removed under way,
what is made is not kept.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import functools
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import platformdirs

from pearl_marl.base.files import open_lock, write_whole
from pearl_marl.errors import DeviceError

_TEMPORARY = "pearl_marl_"
"""With what the name of a folder begins that stands in for one that cannot be written."""

ROOM = 4 << 20
"""Bytes that a folder has to have room for; machine code of the largest environment takes less."""


@functools.cache
def cache_folder(name: str, room: int = ROOM) -> Path:
    """Return the folder of that name in the cache; if that is full or cannot be written, a temporary one.

    Raises
    ------
    DeviceError
        There is no temporary one either.
    """
    try:
        folder = Path(os.environ.get("PEARL_CACHE_DIR") or platformdirs.user_cache_dir("pearl_marl")) / name
        folder = folder.expanduser().resolve()  # a RuntimeError where nobody knows the user's home
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, room)
            return folder
    except (OSError, RuntimeError):  # what is made is made again in every process, and no harm done
        try:
            temporary = Path(tempfile.mkdtemp(prefix=f"{_TEMPORARY}{name}_"))
        except OSError as error:
            raise DeviceError(
                f"neither the cache nor a temporary folder can be written ({error.strerror}): set "
                "PEARL_CACHE_DIR or TMPDIR to a folder that can"
            ) from error
        atexit.register(_remove, temporary, os.getpid())
        return temporary


def _remove(temporary: Path, maker: int) -> None:
    """Remove a temporary folder at the end of the process that made it; a forked child only uses it."""
    if os.getpid() == maker:
        shutil.rmtree(temporary, ignore_errors=True)


def is_kept(folder: Path) -> bool:
    """Return whether a cache's folder outlives this process."""
    return not folder.name.startswith(_TEMPORARY)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Let one process or thread at a time make an entry of the cache; ``path`` serves the lock alone.

    Where there is no room for a lock, several may make the same entry: that takes time, and no harm is done.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)  # it may have been removed under way
            lock = open_lock(path)
            stack.callback(os.close, lock)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def checksum(content: bytes) -> bytes:
    """Return the line that an entry of the cache begins with."""
    return hashlib.sha256(content).hexdigest().encode() + b"\n"


def keep(path: Path, content: bytes) -> None:
    """Keep an entry for :func:`kept` to return, unless there is no room for it."""
    with contextlib.suppress(OSError):
        write_whole(path, checksum(content) + content)


def kept(path: Path) -> bytes | None:
    """Return an entry; ``None`` for one that is not there, or is damaged: then it is removed."""
    with contextlib.suppress(OSError):
        line, end, content = path.read_bytes().partition(b"\n")
        if line + end == checksum(content):
            return content
        path.unlink()
    return None
