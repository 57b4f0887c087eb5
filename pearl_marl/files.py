"""Files that survive a kill, or a loss of power: whoever reads one finds the whole old or the whole new."""

from __future__ import annotations

import os
from pathlib import Path

from pearl_marl.errors import ArgumentError


def replace_file(path: Path, content: bytes, keep: Path | None = None) -> None:
    """Write a file beside its place, and put it there once it is on the disk.

    Parameters
    ----------
    path
        Its place.
    content
        All of it.
    keep
        Where the file that was there goes; ``None`` drops it. For a moment there is only this one.

    Raises
    ------
    ArgumentError
        The file cannot be written.
    """
    scratch = path.with_name(f"{path.name}.tmp")
    try:
        with scratch.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if keep is not None and path.exists():
            os.replace(path, keep)
        os.replace(scratch, path)
        _sync_folder(path.parent)
    except OSError as error:
        raise ArgumentError(f"{path} cannot be written: {error.strerror}") from None


def _sync_folder(folder: Path) -> None:
    """Bring a folder's names to the disk: a file's own fsync() does not."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
