"""Files that survive a kill, or a loss of power: whoever reads one finds the whole old or the whole new."""

from __future__ import annotations

import contextlib
import errno
import os
import zipfile
from pathlib import Path

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


def check_uncompressed(archive: zipfile.ZipFile, size: int) -> None:
    """Raise ValueError for an archive of ``size`` bytes whose content takes more memory than it does itself.

    For those whose writers compress nothing, before any of it is unpacked.
    """
    members = archive.infolist()
    unpacked = sum(member.file_size for member in members)
    if unpacked > size or any(member.compress_type != zipfile.ZIP_STORED for member in members):
        raise ValueError(f"its {size:,} bytes are compressed, and unpacked they are {unpacked:,}")
