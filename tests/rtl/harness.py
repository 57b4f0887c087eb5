"""Builds a module under Verilator once and runs a cocotb bench on it."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import platformdirs
from cocotb_tools.config import libs_dir
from cocotb_tools.runner import get_results, get_runner

from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.spec import EnvSpec

HERE = Path(__file__).parent
CACHE = Path(platformdirs.user_cache_dir("pearl_marl")) / "cocotb"
BENCH_VARIABLE = "PEARL_BENCH"
COVERAGE_VARIABLE = "PEARL_RTL_COVERAGE"
"""A folder that every run leaves its coverage in; without it nothing is counted."""


@dataclass(frozen=True)
class Design:
    """What makes one Verilator build different from another."""

    top: str
    sources: tuple[Path, ...]
    parameters: Mapping[str, int | str] = field(default_factory=dict)
    macros: Mapping[str, str] = field(default_factory=dict)
    build_args: tuple[str, ...] = ()
    """For Verilator, on top of those of all designs."""

    def digest(self) -> str:
        texts = [path.read_text() for path in self.sources]
        return _digest(self.top, texts, dict(self.parameters), dict(self.macros), self.build_args)


def build_args() -> list[str]:
    counted = ["--coverage-line", "--coverage-toggle"] if os.environ.get(COVERAGE_VARIABLE) else []
    return ["--assert", "-Wno-fatal", *counted]


def _digest(*parts: Any) -> str:
    tools = [version("verilator"), version("cocotb"), build_args()]
    return hashlib.sha256(json.dumps([tools, parts]).encode()).hexdigest()[:24]


def module(top: str, **parameters: int) -> Design:
    """A module of the backbone, or a bench's own top, that contains no core, and the files it needs."""
    own = HERE / f"{top}.sv"
    return Design(top, _with_needed(top, [own] if own.exists() else []), parameters)


def core(spec: EnvSpec) -> Design:
    """An environment's core alone, and the files it needs."""
    path = elaboration.core_path(spec)
    return Design(path.stem, _with_needed(path.stem, [path]), elaboration.core_parameters(spec))


def _with_needed(top: str, last: list[Path]) -> tuple[Path, ...]:
    """Return the file of ``top`` and those of the modules in it; ``last`` are those beside the backbone's.

    Not every file there is, so that a change of one module leaves the builds of others in the cache.
    """
    files = {path.stem: path for path in (*elaboration.backbone_paths(), *last)}
    needed, waiting = set(), [top]
    while waiting:
        name = waiting.pop()
        needed.add(name)
        mentioned = re.findall(r"\bpearl_\w+", re.sub("//.*", "", files[name].read_text()))
        waiting += [other for other in mentioned if other in files and other not in needed]
    return tuple(path for name, path in files.items() if name in needed)


def whole(build: Build) -> Design:
    """The whole design of a build."""
    spec, parameters = build.spec, elaboration.top_parameters(build)
    return Design("pearl_top", tuple(elaboration.sources(spec)), parameters, elaboration.macros(spec))


def build(design: Design) -> Path:
    """Build a design unless it is in the cache; safe with many processes at it."""
    folder = CACHE / design.digest()
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / f"{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            os.environ.update(toolchain.environment())
            scratch = Path(tempfile.mkdtemp(dir=CACHE))
            # Verilator's own library takes most of a small build's time and is always the same. It is
            # dated ahead, since make would otherwise find it older than this build's makefile.
            library = CACHE / f"library-{_digest()}"
            for built in library.glob("*.o"):
                os.utime(shutil.copy(built, scratch), times=(time.time() + 3600,) * 2)
            try:
                get_runner("verilator").build(
                    sources=list(design.sources),
                    hdl_toplevel=design.top,
                    parameters=dict(design.parameters),
                    defines=dict(design.macros),
                    build_args=[*build_args(), *design.build_args],
                    build_dir=scratch,
                    timescale=("1ns", "1ps"),
                    log_file=scratch / "build.log",
                )
                if not library.exists():
                    spare = Path(tempfile.mkdtemp(dir=CACHE))
                    for built in scratch.glob("verilated*.o"):
                        shutil.copy(built, spare)
                    with contextlib.suppress(OSError):  # another process was faster
                        spare.rename(library)
                    shutil.rmtree(spare, ignore_errors=True)
                for path in scratch.iterdir():  # all that a run needs is the program
                    if path.name not in (design.top, "build.log"):
                        path.unlink() if path.is_file() else shutil.rmtree(path)
                # Only whole builds get the name that is looked for.
                scratch.rename(folder)
            except SystemExit as error:
                log = (scratch / "build.log").read_text().splitlines()[-40:]
                raise AssertionError("\n".join(log)) from error
            finally:
                shutil.rmtree(scratch, ignore_errors=True)
    return folder


def run(design: Design, bench: str, tmp_path: Path, **arguments: Any) -> None:
    """Run all cocotb tests of the module ``bench`` on a design; ``arguments`` reach it as JSON."""
    built = build(design)
    runner = get_runner("verilator")
    log = tmp_path / "bench.log"
    try:
        results = runner.test(
            hdl_toplevel=design.top,
            hdl_toplevel_lang="verilog",
            test_module=bench,
            build_dir=built,
            test_dir=tmp_path,
            # A build remembers where cocotb was when it was made; another virtual environment that
            # finds it in the cache keeps its own cocotb elsewhere.
            extra_env={
                BENCH_VARIABLE: json.dumps(arguments),
                "PYTHONPATH": str(HERE),
                "LD_LIBRARY_PATH": str(libs_dir),
                # cocotb would have pytest rewrite, and so compile anew, every module that is imported.
                "COCOTB_REWRITE_ASSERTION_FILES": "bench*.py",
            },
            log_file=log,
            results_xml=str(tmp_path / "results.xml"),
        )
    except SystemExit as error:
        raise AssertionError("\n".join(log.read_text().splitlines()[-60:])) from error
    if folder := os.environ.get(COVERAGE_VARIABLE):
        with tempfile.NamedTemporaryFile(dir=folder, suffix=".dat", delete=False) as kept:
            kept.write((tmp_path / "coverage.dat").read_bytes())
    count, failed = get_results(results)
    assert count > 0, f"no test of {bench} ran"
    # The runner fails by itself under pytest only.
    assert failed == 0, f"{failed} tests of {bench} failed"


def arguments() -> Any:
    """In a bench: what the pytest side passed to :func:`run`."""
    return json.loads(os.environ[BENCH_VARIABLE])
