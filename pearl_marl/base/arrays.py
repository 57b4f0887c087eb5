"""Arrays from NumPy's files, which others may have written or damaged.

NumPy's own reader evaluates a header as Python, and takes the memory that it names before it looks for the
bytes. Here a header is what :func:`numpy.save` writes of numbers, its array as long as the bytes that follow,
and the caller has agreed to its shape and dtype before there is any memory for it.
"""

from __future__ import annotations

import contextlib
import errno
import io
import math
import os
import re
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from pearl_marl.base.files import check_readable, check_uncompressed
from pearl_marl.errors import ArgumentError, PearlError, brief, one_line

Array = npt.NDArray[Any]
Check = Callable[[tuple[int, ...], np.dtype[Any]], None]
"""Raises an error of this package for a shape and a dtype that are not wanted."""

_MAGIC = b"\x93NUMPY"
_LENGTHS = {b"\1\0": 2, b"\2\0": 4}
"""Bytes of the length of a header, by the format's version. Version 3 is for names of columns."""

_LONGEST = 10_000
_ITEM = rb"'(descr|fortran_order|shape)' *: *('[<>|=]?[biufcSU]\d{1,6}'|False|True|\([0-9L, ]*\)) *,? *"
_HEADER = re.compile(rb"\{ *((?:%s){3})\} *\n?" % _ITEM)


class _UnreadableError(ValueError):
    """Why there is no array in a file."""


def load_array(path: Path, what: str, check: Check, name: str = "", rows: int | None = None) -> Array:
    """Return the array of a .npy file, or the one of that name in a .npz file; or raise ArgumentError.

    ``what`` says what the file is to be. The array cannot be written to. Of a .npy file whose rows follow
    each other, no more than the first ``rows`` are read.
    """
    try:
        check_readable(path)
        with path.open("rb") as file:
            first = file.read(len(_MAGIC))
            file.seek(0)
            if not first:
                raise _UnreadableError("it is empty")
            if first == _MAGIC:
                return _array(file, os.fstat(file.fileno()).st_size, check, rows)
            if not first.startswith((b"PK\x03\x04", b"PK\x05\x06")):
                raise _UnreadableError("it does not begin as one that NumPy writes")
            return _named(file, check, name)
    except ArgumentError:
        raise
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise ArgumentError(f"{path} is no readable {what}: {one_line(why)}") from None


def unpacked_arrays(body: bytes, checks: dict[str, Check]) -> dict[str, Array]:
    """Return the arrays of what :func:`numpy.savez` wrote, by their names; or raise ValueError.

    They are those that there are checks for, and take no more memory than ``body``: none may be compressed.
    """
    with _archive(io.BytesIO(body)) as (archive, members):
        if members.keys() != checks.keys():
            raise _UnreadableError(f"it has the arrays {brief(list(members))}, not {list(checks)}")
        try:
            check_uncompressed(archive, len(body))
        except ValueError as error:
            raise _UnreadableError(error) from None
        return {name: _member(archive, members[name], checks[name]) for name in checks}


def _named(file: IO[bytes], check: Check, name: str) -> Array:
    with _archive(file) as (archive, members):
        if name in members:
            return _member(archive, members[name], check)
    listed = ", ".join(members) or "none"
    listed = listed if listed.isprintable() and len(listed) < 200 else brief(list(members))
    raise _UnreadableError(
        f"it has no array {name!r}; its arrays are {listed}" if name else "it is a .npz file"
    )


@contextlib.contextmanager
def _archive(file: IO[bytes]) -> Iterator[tuple[zipfile.ZipFile, dict[str, zipfile.ZipInfo]]]:
    """Open an archive of arrays, by their names; what reading it raises becomes :class:`_UnreadableError`."""
    try:
        with zipfile.ZipFile(file) as archive:
            yield archive, {each.filename.removesuffix(".npy"): each for each in archive.infolist()}
    except (PearlError, MemoryError, _UnreadableError):
        raise
    except Exception as error:  # of random bytes, a reader may raise any
        if isinstance(error, OSError) and error.errno != errno.EINVAL:  # that is of a place before the file
            raise
        raise _UnreadableError("it is a damaged archive") from None


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, check: Check) -> Array:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise _UnreadableError(
            f"{brief(member.filename)} in it is compressed in a way that NumPy does not use"
        )
    with archive.open(member) as file:  # which compares the checksum where all of it has been read
        return _array(file, member.file_size, check)


def _array(file: IO[bytes], size: int, check: Check, rows: int | None = None) -> Array:
    """Return the array of a .npy file of ``size`` bytes, or its first ``rows``."""
    magic, version = file.read(len(_MAGIC)), file.read(2)
    if magic != _MAGIC or version not in _LENGTHS:
        raise _UnreadableError("it does not begin as one of version 1.0 or 2.0 that NumPy writes")
    length = int.from_bytes(file.read(_LENGTHS[version]), "little")
    if length > _LONGEST:
        raise _UnreadableError(f"its header has {length:,} bytes; {_LONGEST:,} are possible")
    shape, dtype, order = _header(file.read(length))
    check(shape, dtype)
    needed = math.prod(shape) * dtype.itemsize
    there = size - len(_MAGIC) - len(version) - _LENGTHS[version] - length
    if needed != there:
        raise _UnreadableError(
            f"it is damaged: an array of shape {shape} and dtype {dtype} has {needed:,} bytes, and in it are "
            f"{there:,}"
        )
    if rows is not None and order == "C" and shape[0] > rows:
        shape = (rows, *shape[1:])
        needed = math.prod(shape) * dtype.itemsize
    content = file.read(needed)
    if len(content) != needed:
        raise _UnreadableError(f"it is damaged: it ends after {len(content):,} of {needed:,} bytes")
    try:
        return np.frombuffer(content, dtype).reshape(shape, order=order)
    except (ValueError, OverflowError):  # of no numbers, but of many dimensions
        raise _UnreadableError(f"its shape is {shape}, which NumPy cannot have") from None


def _header(text: bytes) -> tuple[tuple[int, ...], np.dtype[Any], Any]:
    """Return shape, dtype and order by a header."""
    if b"'|O" in text:
        raise _UnreadableError("it holds Python objects")
    found = _HEADER.fullmatch(text)
    items = dict(re.findall(_ITEM, found[1])) if found else {}
    kinds = {name: value[:1] for name, value in items.items()}
    if kinds not in [{b"descr": b"'", b"fortran_order": flag, b"shape": b"("} for flag in (b"F", b"T")]:
        raise _UnreadableError("its header is not one that NumPy writes for numbers")
    words = items[b"shape"].decode()[1:-1].replace("L", "").replace(" ", "").removesuffix(",")
    try:
        shape = tuple(int(word) for word in words.split(",")) if words else ()
        dtype = np.dtype(items[b"descr"].decode()[1:-1])
    except (TypeError, ValueError):
        raise _UnreadableError("its header has no shape or no dtype that NumPy knows") from None
    if not dtype.itemsize:
        raise _UnreadableError(f"its numbers have the dtype {dtype}, of no bytes")
    return shape, dtype, "F" if items[b"fortran_order"] == b"True" else "C"
