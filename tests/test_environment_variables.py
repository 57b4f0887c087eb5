"""Variables of the environment: they change nothing, or one sentence says what to do."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numba
import pytest

from pearl_marl.base.cache import cache_folder
from pearl_marl.base.machine_code import Entries
from pearl_marl.errors import DeviceError

from .sampling import sampled

STEP = """
import pearl_marl
env = pearl_marl.parallel_env("CliffWalking", 5)
env.reset_batch(seed=0)
print(env.step_batch([1] * 5).obs.tolist())
"""

NOBODY = """
import os, pwd
del os.environ["HOME"]
os.environ.pop("XDG_CACHE_HOME", None)
def unknown(*_): raise KeyError("uid not found")
pwd.getpwuid = pwd.getpwnam = unknown
"""


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that the first of these tests fills."""
    return tmp_path_factory.mktemp("cache")


def run(script: str, cache: Path | None, **variables: str) -> subprocess.CompletedProcess[str]:
    own = {} if cache is None else {"PEARL_CACHE_DIR": str(cache)}
    environment = {**os.environ, **own, **variables}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd="/")


HARMLESS = [
    {"NUMBA_CACHE_DIR": "/dev/null/numba"},
    {"TMPDIR": "/dev/null/tmp"},
    {"PYTHONOPTIMIZE": "2"},
    {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"PYTHONHASHSEED": "0"},
    {"TZ": "nonsense"},
    {"NUMBA_CPU_NAME": "generic"},
    {"NUMBA_THREADING_LAYER": "nonsense"},
    {"NUMBA_CACHE_LOCATOR_CLASSES": "no.such.class"},
    {"NUMBA_NUM_THREADS": "many"},
    {"NUMBA_BOUNDSCHECK": "1"},
    {"NUMBA_OPT": "0"},
    {"PYTHONWARNINGS": "error"},
]


@pytest.mark.parametrize("variables", sampled(HARMLESS, HARMLESS[:3]), ids=lambda given: next(iter(given)))
def test_harmless_ones(variables: dict[str, str], cache: Path) -> None:
    done = run(STEP, cache, **variables)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "[36, 36, 36, 36, 36]\n"


def test_a_user_whom_the_machine_does_not_know() -> None:
    """As in a container that runs under any number: there is no home, and no cache."""
    done = run(
        f"{NOBODY}\nfrom pearl_marl.base.cache import *\nprint(is_kept(cache_folder('kernels')))", None
    )
    assert (done.returncode, done.stdout) == (0, "False\n"), done.stderr


@pytest.mark.slow
def test_the_doctor_of_a_user_whom_the_machine_does_not_know() -> None:
    done = run(f"{NOBODY}\nfrom pearl_marl.cli import app\napp(['doctor'], standalone_mode=False)", None)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("variables", "says"),
    [
        ({"NUMBA_DISABLE_JIT": "1"}, "DeviceError: NUMBA_DISABLE_JIT turns off .*unset this variable"),
        ({"NUMBA_NUM_THREADS": "0"}, "ArgumentError: the environment variable NUMBA_NUM_THREADS is 0.*unset"),
    ],
    ids=["NUMBA_DISABLE_JIT", "NUMBA_NUM_THREADS"],
)
def test_those_that_cannot_work(variables: dict[str, str], says: str, cache: Path) -> None:
    done = run(STEP, cache, **variables)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith("pearl_marl.errors.")
    assert re.search(says, last)


def test_the_reference_needs_no_compiler(cache: Path) -> None:
    done = run(STEP.replace("5)", "5, device='reference')", 1), cache, NUMBA_DISABLE_JIT="1")
    assert done.stdout == "[36, 36, 36, 36, 36]\n", done.stderr


def test_no_folder_at_all(monkeypatch: pytest.MonkeyPatch, forgotten: None) -> None:
    def refuse(*_: object, **__: object) -> str:
        raise FileNotFoundError(2, "No usable temporary directory found")

    monkeypatch.setenv("PEARL_CACHE_DIR", "/dev/null/cache")
    monkeypatch.setattr(tempfile, "mkdtemp", refuse)
    with pytest.raises(DeviceError, match="set PEARL_CACHE_DIR or TMPDIR to a folder that can"):
        cache_folder("kernels")


@pytest.fixture
def forgotten() -> Iterator[None]:
    cache_folder.cache_clear()
    yield
    cache_folder.cache_clear()


def test_code_made_under_other_settings_is_another_entry(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forgotten: None
) -> None:
    """Or else slow code, once made with ``NUMBA_OPT=0``, would be found ever after."""
    monkeypatch.setenv("PEARL_CACHE_DIR", str(tmp_path))
    entries = Entries("function")
    entries.save("key", "code")
    assert entries.load("key") == "code"
    monkeypatch.setattr(numba.config, "OPT", 0)
    assert entries.load("key") is None


def test_code_written_by_another_version_is_another_entry(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forgotten: None
) -> None:
    """What a file holds may differ, and the cache outlives an upgrade."""
    monkeypatch.setenv("PEARL_CACHE_DIR", str(tmp_path))
    entries = Entries("function")
    entries.save("key", "code")
    monkeypatch.setattr("pearl_marl.base.machine_code._format", lambda: "another")
    assert entries.load("key") is None
