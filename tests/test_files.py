"""Files that several write at once, or that a writer leaves when it is killed."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from pearl_marl.base import files
from pearl_marl.base.cache import locked
from pearl_marl.base.files import open_lock, replace_file
from pearl_marl.errors import ArgumentError

WRITER = """
import sys
from pathlib import Path
from pearl_marl.base.files import replace_file
path, letter, times = Path(sys.argv[1]), sys.argv[2].encode(), int(sys.argv[3])
for length in range(times):
    replace_file(path, letter * (1000 + length), keep=Path(sys.argv[4]) if sys.argv[4:] else None)
"""


def writer(path: Path, letter: str, times: int, *keep: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", WRITER, path, letter, str(times), *keep]
    return subprocess.Popen(command, stderr=subprocess.PIPE)


@pytest.mark.parametrize("keeping", [False, True])
def test_several_writers_at_once(keeping: bool, tmp_path: Path) -> None:
    """None fails, and who reads finds one of theirs, whole."""
    path = tmp_path / "file"
    replace_file(path, b"_" * 1000)
    keep = [tmp_path / "before"] if keeping else []
    writers = [writer(path, letter, 150, *keep) for letter in "abc"]
    reads = 0
    while any(each.poll() is None for each in writers):
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            assert keeping, "between the two renames, there is only the one before"
            continue
        reads += 1
        assert len(content) >= 1000
        assert len(set(content)) == 1
    for each in writers:
        assert each.communicate()[1] == b""
        assert each.returncode == 0
    assert reads
    assert {each.name for each in tmp_path.iterdir()} == {"file", *(each.name for each in keep)}


def test_threads_of_one_process(tmp_path: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda k: replace_file(tmp_path / "file", b"%d" % (k % 10) * 5000), range(64)))
    content = (tmp_path / "file").read_bytes()
    assert (len(content), len(set(content))) == (5000, 1)
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_leftovers_of_a_writer_that_was_killed(tmp_path: Path) -> None:
    """The next one removes them, and not what somebody is writing."""
    program = """
import os, sys, time
from pathlib import Path
from pearl_marl.base import files
files.os.fsync = lambda _: (print("there", flush=True), time.sleep(600))
files.replace_file(Path(sys.argv[1]), b"half")
"""
    others = tmp_path / "other.tmp", tmp_path / ".pearl-config.tmp", tmp_path / "file.tmp"
    for other in others:
        other.touch()
    both = [
        subprocess.Popen([sys.executable, "-c", program, tmp_path / "file"], stdout=subprocess.PIPE)
        for _ in range(2)
    ]
    try:
        for each in both:
            assert each.stdout is not None
            assert each.stdout.readline() == b"there\n"
        scratches = set(tmp_path.glob(".pearl-????????.tmp"))
        assert len(scratches) == 2
        both[0].send_signal(signal.SIGKILL)
        both[0].wait()
        replace_file(tmp_path / "another", b"whole")
        left = set(tmp_path.glob(".pearl-????????.tmp"))
        assert len(left) == 1
        assert left < scratches
        assert all(other.exists() for other in others)
    finally:
        for each in both:
            each.kill()
            each.communicate()
    replace_file(tmp_path / "another", b"whole")
    assert not set(tmp_path.glob(".pearl-????????.tmp"))


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_nothing_is_left_of_a_write_that_failed(
    error: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace_file(tmp_path / "file", b"before")

    def fails(_: int) -> None:
        raise error

    monkeypatch.setattr(files.os, "fsync", fails)
    with pytest.raises(KeyboardInterrupt if error is KeyboardInterrupt else ArgumentError):
        replace_file(tmp_path / "file", b"after")
    assert [each.name for each in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_bytes() == b"before"


def test_a_file_has_the_rights_that_the_user_gives(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        replace_file(tmp_path / "file", b"")
    finally:
        os.umask(before)
    assert (tmp_path / "file").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("make", [os.symlink, os.link], ids=["symbolic", "hard"])
def test_a_link_to_a_file_that_is_dear_is_not_written_to(make: Any, tmp_path: Path) -> None:
    dear = tmp_path / "dear"
    dear.write_bytes(b"dear")
    make(dear, tmp_path / "link")
    replace_file(tmp_path / "link", b"other")
    assert dear.read_bytes() == b"dear"
    make(dear, tmp_path / "lock")
    with pytest.raises(OSError, match="it is a link, or no file of a disk: remove it"):
        open_lock(tmp_path / "lock")
    with contextlib.suppress(OSError), locked(tmp_path / "lock"):
        pass
    assert dear.read_bytes() == b"dear"


def test_a_lock_that_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    for name in ("fifo", "folder"):
        with pytest.raises(OSError, match=r"it is a link, or no file of a disk|Is a directory"):
            open_lock(tmp_path / name)


def test_a_lock_keeps_its_content_and_others_out(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    path.write_bytes(b"kept")
    order = []

    def second() -> None:
        with locked(path):
            order.append("second")

    with ThreadPoolExecutor(1) as pool:
        with locked(path):
            done = pool.submit(second)
            time.sleep(0.05)
            order.append("first")
        done.result()
    assert order == ["first", "second"]
    assert path.read_bytes() == b"kept"
