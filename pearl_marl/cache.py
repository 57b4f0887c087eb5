"""The user's cache folder: compiled kernels and simulated devices are kept there between runs.

``PEARL_CACHE_DIR`` moves it.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import functools
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import platformdirs
from numba import njit

from pearl_marl.files import open_lock

_TEMPORARY = "pearl_marl_"
"""With what the name of a folder begins that stands in for one that cannot be written."""


@functools.cache
def cache_folder(name: str) -> Path:
    """Return the folder of that name in the cache; a temporary one if the cache cannot be written."""
    folder = Path(os.environ.get("PEARL_CACHE_DIR") or platformdirs.user_cache_dir("pearl_marl")) / name
    try:
        folder = folder.expanduser().resolve()  # a RuntimeError where nobody knows the user's home
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError):  # what is made is made again in every process, and no harm done
        temporary = Path(tempfile.mkdtemp(prefix=f"{_TEMPORARY}{name}_"))
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
    """Let one process or thread at a time make an entry of the cache; ``path`` serves the lock alone."""
    lock = open_lock(path)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function of this package with Numba, and keep the result where Numba can."""
    try:
        result: Callable[..., Any] = njit(cache=True, nogil=True)(function)
    except RuntimeError:  # neither the package nor the home folder can be written
        result = njit(nogil=True)(function)
    return result
