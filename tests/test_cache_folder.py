"""The cache folder: damaged entries are made again, and nothing depends on a folder that can be written."""

import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path

import numba
import numpy as np
import pytest

from pearl_marl.base.cache import cache_folder, keep, kept, locked
from pearl_marl.base.machine_code import kept_code
from pearl_marl.compiler import kernels
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.envs import get_spec

_USE = """
import os, sys
from pearl_marl.base.cache import cache_folder
folder = cache_folder("kernels")
child = os.fork()
if not child:
    sys.exit()
os.waitpid(child, 0)
assert folder.is_dir()
print(folder)
"""

FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Let this process keep what it makes in a folder of the test's."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("PEARL_CACHE_DIR", str(folder))
    cache_folder.cache_clear()
    kernels._loaded.clear()
    yield folder
    monkeypatch.undo()
    cache_folder.cache_clear()
    kernels._loaded.clear()


def damaged(content: bytes, positions: range | np.ndarray) -> Iterator[bytes]:
    """Yield what becomes of a file: cut, zeroed, empty, longer, and with a bit flipped at each position."""
    yield from (b"", content[:-1], content[: len(content) // 2], bytes(len(content)), content + b"\0")
    yield content[: len(content) // 2] + bytes(len(content) - len(content) // 2)
    for position in positions:
        flipped = bytearray(content)
        flipped[position] ^= 1 << position % 8
        yield bytes(flipped)


@pytest.mark.parametrize("cache_dir", ["/dev/null/cache", "~nobody_of_that_name/cache"])
def test_a_forked_child_leaves_the_temporary_folder_to_its_parent(cache_dir: str) -> None:
    command = ["env", f"PEARL_CACHE_DIR={cache_dir}", sys.executable, "-c", _USE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "pearl_marl_kernels_" in done.stdout


def test_an_entry_comes_back_whole_or_not_at_all(tmp_path: Path) -> None:
    path, content = tmp_path / "folder" / "entry", bytes(range(256)) + b"\n\n"
    keep(path, content)
    assert kept(path) == content
    whole = path.read_bytes()
    for bad in damaged(whole, range(len(whole))):
        path.write_bytes(bad)
        assert kept(path) is None
        assert not path.exists(), "a damaged one is removed"
    assert kept(path) is None


def test_an_entry_is_for_everybody_who_may_read_the_folder(tmp_path: Path) -> None:
    """As in an image of a container, which one user fills and another one uses."""
    before = os.umask(0o022)
    try:
        keep(tmp_path / "entry", b"content")
    finally:
        os.umask(before)
    assert (tmp_path / "entry").stat().st_mode & 0o777 == 0o644


def test_a_full_disk_keeps_nothing_and_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise FULL

    monkeypatch.setattr(os, "fsync", full)
    keep(tmp_path / "entry", b"content")
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_cannot_be_made_stops_nobody(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with locked(tmp_path / "file" / "lock"):
        pass
    with locked(tmp_path / "gone" / "lock"), pytest.raises(ZeroDivisionError), locked(tmp_path / "other"):
        1 / 0  # noqa: B018


def test_a_full_disk_is_a_cache_that_cannot_be_written(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise FULL

    monkeypatch.setattr(os, "posix_fallocate", full)
    folder = cache_folder("kernels")
    assert cache not in folder.parents
    assert list((cache / "kernels").iterdir()) == [], "it has been tried"


def write_often(path: Path, content: bytes) -> None:
    for _ in range(300):
        keep(path, content)


def test_processes_that_write_one_entry_do_not_tear_it(tmp_path: Path) -> None:
    path, contents = tmp_path / "entry", [b"a" * 50_000, b"b" * 70_000]
    keep(path, contents[0])
    writers = [get_context("fork").Process(target=write_often, args=(path, content)) for content in contents]
    for writer in writers:
        writer.start()
    while any(writer.is_alive() for writer in writers):
        assert kept(path) in contents
    assert [writer.exitcode for writer in map(joined, writers)] == [0, 0]
    assert [left.name for left in tmp_path.iterdir()] == ["entry"]


def joined(process):
    process.join()
    return process


def tripled():
    """Return a function as kernels are: new to this process, and perhaps not to the cache."""
    return kept_code(numba.njit(lambda x: 3 * x + 1), "tripled")


def test_damaged_machine_code_is_made_again(cache: Path) -> None:
    function = tripled()
    assert function(2) == 7
    assert sum(function.stats.cache_misses.values()) == 1
    (path,) = (cache / "kernels").glob("*.code")
    whole = path.read_bytes()
    for bad in damaged(whole, np.linspace(0, len(whole) - 1, 20).astype(int)):
        path.write_bytes(bad)
        function = tripled()
        assert function(2) == 7
        assert sum(function.stats.cache_misses.values()) == 1
        assert kept(path) is not None, "the next process finds it whole"
    assert sum(tripled().stats.cache_hits.values()) == 0
    function = tripled()
    assert function(2) == 7
    assert sum(function.stats.cache_hits.values()) == 1


def test_the_folder_may_go_at_any_time(cache: Path) -> None:
    """Between the choice of a folder and its use, too."""
    spec = get_spec("CliffWalking")
    device = Native(threads=1).open(BatchConfig(spec=spec, n_envs=3))
    shutil.rmtree(cache)
    device.reset(seed=0)
    shutil.rmtree(cache)
    (cache.parent / "cache").write_text("no folder can be made here any more")
    assert device.step(np.ones(3, np.uint8)).obs.tolist() == [36, 36, 36]
    kernels._loaded.clear()
    other = Native(threads=1).open(BatchConfig(spec=spec.with_options(is_slippery=True), n_envs=3))
    other.reset(seed=0)
    device.close()
    other.close()


STEPS = """
import numpy as np, pearl_marl
env = pearl_marl.parallel_env("Taxi", 5)
obs = [env.reset_batch(seed=3)] + [env.step_batch(np.full(5, t % 6, np.uint8)).obs for t in range(20)]
print(np.array(obs).tolist())
"""


@pytest.mark.exhaustive
def test_no_damage_to_any_file_of_the_cache_shows(tmp_path: Path) -> None:
    """Of every start the results are right, there is no word about it, and the files are whole afterwards."""

    def start() -> str:
        command = [sys.executable, "-c", STEPS]
        variables = {**os.environ, "PEARL_CACHE_DIR": str(tmp_path)}
        done = subprocess.run(command, capture_output=True, text=True, env=variables, check=False)
        assert done.returncode == 0, done.stderr
        assert not done.stderr
        return done.stdout

    subprocess.run(
        [sys.executable, "-c", STEPS], env={**os.environ, "PEARL_CACHE_DIR": str(tmp_path)}, check=True
    )
    right, rng = start(), np.random.default_rng(0)
    for path in sorted((tmp_path / "kernels").glob("*.[cp]*")):
        whole = path.read_bytes()
        for bad in damaged(whole, rng.integers(len(whole), size=44)):
            path.write_bytes(bad)
            assert start() == right
            if path.suffix == ".code":
                assert kept(path) is not None
            elif path.suffix == ".py":
                assert path.read_bytes() == whole
