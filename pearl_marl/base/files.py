"""Files that survive a kill, or a loss of power: whoever reads one finds the whole old or the whole new."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import secrets
import stat
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from pearl_marl.errors import ArgumentError


def replace_file(path: Path, content: bytes, keep: Path | None = None) -> None:
    """Do what :func:`write_whole` does, or raise ArgumentError that says how to go on."""
    try:
        write_whole(path, content, keep)
    except OSError as error:
        raise ArgumentError(
            f"{path} cannot be written: {error.strerror}; make room for it, or choose another place"
        ) from None


def write_whole(path: Path, content: bytes, keep: Path | None = None) -> None:
    """Write a file beside its place, and put it there once it is on the disk; or raise OSError.

    Its folder is made. The file that was there goes to ``keep``, if that is given. For a moment there is only
    this one. Of several writers at once, one is the last, and its file is whole. The scratch files of writers
    that were killed are removed.
    """
    if _what(path) not in (None, stat.S_IFREG):  # a device would be replaced as a file is
        raise OSError(errno.EEXIST, "there is something that is no file")
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(path.parent)
    with _scratch(path.parent) as (scratch, file):
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
        if keep is not None:
            with contextlib.suppress(FileNotFoundError):
                os.replace(path, keep)
        os.replace(scratch, path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # the names in it: a file's own fsync() does not bring them to the disk
    finally:
        os.close(folder)


@contextlib.contextmanager
def _scratch(folder: Path) -> Iterator[tuple[Path, IO[bytes]]]:
    """Open a new file of a name of its own, and remove that at the end if it is still there.

    It is locked for as long as its writer lives: see :func:`_remove_leftovers`.
    """
    while True:
        scratch = folder / f".pearl-{secrets.token_hex(4)}.tmp"
        try:
            file = scratch.open("xb")  # which follows no link
        except FileExistsError:
            continue
        with file:
            try:
                with contextlib.suppress(OSError):  # some networks' file systems have no locks
                    fcntl.flock(file, fcntl.LOCK_EX)
                if os.fstat(file.fileno()).st_nlink:  # it was not taken for a leftover before it was locked
                    yield scratch, file
                    return
            finally:
                scratch.unlink(missing_ok=True)


def _remove_leftovers(folder: Path) -> None:
    """Remove what writers who were killed left in a folder: nobody holds a lock on that."""
    for scratch in folder.glob(f".pearl-{'[0-9a-f]' * 8}.tmp"):
        with contextlib.suppress(OSError):
            file = os.open(scratch, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                scratch.unlink()
            finally:
                os.close(file)


@contextlib.contextmanager
def claimed(folder: Path, does: str) -> Iterator[None]:
    """Write into a folder in the block, alone; it is made if need be.

    Raises
    ------
    ArgumentError
        Another process ``does`` so, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        claim = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise ArgumentError(f"--out {folder} is no folder that can be written: {error.strerror}") from None
    try:
        with contextlib.suppress(OSError):  # some networks' file systems have no locks of folders
            try:
                fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ArgumentError(
                    f"another process {does} in {folder}: wait for its end, or give another --out"
                ) from None
        yield
    finally:
        os.close(claim)


def open_lock(path: Path) -> int:
    """Open a file that serves as a lock, and make it if need be; or raise OSError.

    Nothing in it changes, and no link is followed: in a folder of several users, another one may have put a
    link there to a file that is dear to us.
    """
    why = "it is a link, or no file of a disk: remove it"
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise OSError(error.errno, why if error.errno == errno.ELOOP else error.strerror, str(path)) from None
    found = os.fstat(lock)
    if not stat.S_ISREG(found.st_mode) or found.st_nlink != 1:
        os.close(lock)
        raise OSError(errno.EEXIST, why, str(path))
    return lock


def check_files(folder: Path, *names: str) -> None:
    """Refuse a folder in which something that is no file has one of these names, before the work."""
    for path in (folder / name for name in names):
        found = _what(path)
        if found not in (None, stat.S_IFREG):
            what = "a folder" if found == stat.S_IFDIR else "no file of a disk"
            raise ArgumentError(f"{path} is {what}, and a file is to be written there: choose another place")


def check_readable(path: Path) -> None:
    """Raise ValueError for what is no file: whoever opens a FIFO may wait for ever."""
    found = _what(path)
    if found != stat.S_IFREG:
        raise ValueError("there is no such file" if found is None else "it is a folder, or no file of a disk")


def _what(path: Path) -> int | None:
    """Return what sort of thing is there, if any; looked at once, as others may take it away."""
    try:
        return stat.S_IFMT(path.stat().st_mode)
    except OSError:
        return None


def check_uncompressed(archive: zipfile.ZipFile, size: int) -> None:
    """Raise ValueError for an archive of ``size`` bytes whose content takes more memory than it does itself.

    For those whose writers compress nothing, before any of it is unpacked.
    """
    members = archive.infolist()
    unpacked = sum(member.file_size for member in members)
    if unpacked > size or any(member.compress_type != zipfile.ZIP_STORED for member in members):
        raise ValueError(f"its {size:,} bytes are compressed, and unpacked they are {unpacked:,}")
