"""Files that survive a kill, or a loss of power: whoever reads one finds the whole old or the whole new."""

from __future__ import annotations

import contextlib
import errno
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

from pearl_marl.errors import ArgumentError


def replace_file(path: Path, content: bytes, keep: Path | None = None) -> None:
    """Write a file beside its place, and put it there once it is on the disk; or raise ArgumentError.

    Its folder is made. The file that was there goes to ``keep``, if that is given. For a moment there is only
    this one.
    """
    scratch = path.with_name(f"{path.name}.tmp")
    try:
        if path.exists() and not path.is_file():  # a device would be replaced as a file is
            raise OSError(errno.EEXIST, "there is something that is no file")
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if keep is not None and path.exists():
            os.replace(path, keep)
        os.replace(scratch, path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # the names in it: a file's own fsync() does not bring them to the disk
        finally:
            os.close(folder)
    except OSError as error:
        with contextlib.suppress(OSError):
            scratch.unlink()
        raise ArgumentError(
            f"{path} cannot be written: {error.strerror}; make room for it, or choose another place"
        ) from None


def check_files(folder: Path, *names: str) -> None:
    """Refuse a folder in which something that is no file has one of these names, before the work."""
    for path in (folder / name for name in names):
        if path.exists() and not path.is_file():
            what = "a folder" if path.is_dir() else "no file of a disk"
            raise ArgumentError(f"{path} is {what}, and a file is to be written there: choose another place")


def check_readable(path: Path) -> None:
    """Raise ValueError for what is no file: whoever opens a FIFO may wait for ever."""
    if not path.is_file():
        raise ValueError("it is a folder, or no file of a disk" if path.exists() else "there is no such file")


def load_array(path: Path, name: str = "", mmap_mode: Any = None) -> Any:
    """Return the array of a .npy file, or the one of that name in a .npz file; or raise ValueError."""
    import numpy as np  # not above: who only writes has no need of it, and `pearl --help` no time

    check_readable(path)
    with path.open("rb") as file:
        first = file.read(6)
    # Of anything else NumPy says that it is pickled, and how to load it all the same.
    if not first.startswith((b"\x93NUMPY", b"PK\x03\x04", b"PK\x05\x06")):
        raise ValueError("it does not begin as one that NumPy writes" if first else "it is empty")
    try:
        found = np.load(path, mmap_mode)
        if isinstance(found, np.ndarray):
            return found
        with found:
            if name in found.files:
                return found[name]
            listed = ", ".join(found.files) or "none"
    except (OverflowError, MemoryError):  # of the sizes in a header
        raise ValueError("it is damaged, or larger than memory") from None
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise ValueError("it holds Python objects" if "ickle" in str(error) else str(error)) from None
    raise ValueError(f"it has no array {name!r}; its arrays are {listed}" if name else "it is a .npz file")
