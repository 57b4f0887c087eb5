"""Builds modules under Verilator once and runs a cocotb bench on them.

Most of a bench's time is the start of a compiler or a simulator. So the variants of a module stand side by
side in one build, and one simulation goes from one to the next.
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import hashlib
import json
import os
import re
import shutil
import tempfile
import time
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest import mock

import platformdirs
from cocotb_tools.config import libs_dir
from cocotb_tools.runner import get_runner

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
    text: str = ""
    """The top, where no file has it."""

    def digest(self) -> str:
        texts = [path.read_text() for path in self.sources]
        return _digest(self.top, self.text, texts, dict(self.parameters), dict(self.macros))


MAKE = ("OPT_FAST=-O0", "OPT_SLOW=-O0", "OPT_GLOBAL=-O1", "VM_PARALLEL_BUILDS=0")
"""To optimise takes the compiler longer than it saves any bench. So does reading the same headers again for
every file of a design: it is made one, and those of Verilator are compiled once."""
HEADERS = "#include <verilated.h>\n#include <verilated_vpi.h>\n"


def build_args() -> list[str]:
    counted = ["--coverage-line", "--coverage-toggle"] if os.environ.get(COVERAGE_VARIABLE) else []
    # What nobody has set is random, so that no result can lean on it: see _simulate.
    unknown = ["--x-initial", "unique", "--x-assign", "unique"]
    return ["--assert", *unknown, "-Wno-fatal", "--output-split", "0", *counted]


def _digest(*parts: Any) -> str:
    tools = [version("verilator"), version("cocotb"), build_args(), MAKE]
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


BUS = (
    "pearl_top.sv",
    *(f"pearl_axi_{name}.sv" for name in ("slave", "read", "write", "answers", "address")),
)
"""The sources that lie between the bus and the backbone; tests of the backbone alone do without them."""


def whole(build: Build) -> Design:
    """The whole design of a build."""
    spec, parameters = build.spec, elaboration.top_parameters(build)
    return Design("pearl_top", tuple(elaboration.sources(spec, engine=build.layout.engine)), parameters)


AXI_PROPERTIES = HERE / "axi_properties.sv"


def checked(design: Design) -> Design:
    """A design with an AXI slave, and what AXI4 demands of it and of its master bound to that."""
    return dataclasses.replace(design, sources=(*design.sources, AXI_PROPERTIES))


def side_by_side(designs: Sequence[Design]) -> Design:
    """A design with an instance of each, ``v0`` and so on; they are wired to nothing but the bench.

    They have to agree in their macros, and in every file that two of them share.
    """
    instances = []
    for i, design in enumerate(designs):
        given = ", ".join(f".{name}({value})" for name, value in design.parameters.items())
        instances.append(f"  {design.top} #({given}) v{i} ();\n")
        assert design.macros == designs[0].macros
    sources = dict.fromkeys(path for design in designs for path in design.sources)
    text = f"module {VARIANTS};\n{''.join(instances)}endmodule\n"
    return Design(VARIANTS, tuple(sources), macros=designs[0].macros, text=text)


VARIANTS = "variants"


def build(design: Design) -> Path:
    """Build a design unless it is in the cache; safe with many processes at it."""
    folder = CACHE / design.digest()
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / f"{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            scratch = Path(tempfile.mkdtemp(dir=CACHE))
            own = scratch / f"{design.top}.sv"
            if design.text:
                own.write_text(design.text)
            tools = toolchain.environment()
            # Verilator's own library takes most of a small build's time and is always the same. It is
            # dated ahead, since make would otherwise find it older than this build's makefile.
            library = CACHE / f"library-{_digest(HEADERS)}"
            headers = library / "headers.h"
            for built in library.glob("*.o"):
                os.utime(shutil.copy(built, scratch), times=(time.time() + 3600,) * 2)
            included = rf"\ -include\ {headers}" if headers.exists() else ""
            tools["MAKEFLAGS"] = " ".join([tools["MAKEFLAGS"], MAKE[0] + included, *MAKE[1:]])
            try:
                with mock.patch.dict(os.environ, tools):
                    get_runner("verilator").build(
                        sources=[*design.sources, *([own] if design.text else [])],
                        hdl_toplevel=design.top,
                        parameters=dict(design.parameters),
                        defines=dict(design.macros),
                        build_args=build_args(),
                        build_dir=scratch,
                        timescale=("1ns", "1ps"),
                        log_file=scratch / "build.log",
                    )
                if not library.exists():
                    spare = Path(tempfile.mkdtemp(dir=CACHE))
                    for built in scratch.glob("verilated*.o"):
                        shutil.copy(built, spare)
                    (scratch / headers.name).write_text(HEADERS)
                    make = ["make", "-C", str(scratch), "-f", "Vtop.mk", *MAKE]
                    toolchain.run([*make, f"{headers.name}.fast.gch"])
                    shutil.copy(scratch / headers.name, spare)
                    shutil.copy(scratch / f"{headers.name}.fast.gch", spare / f"{headers.name}.gch")
                    with contextlib.suppress(OSError):  # another process was faster
                        spare.rename(library)
                    shutil.rmtree(spare, ignore_errors=True)
                for path in scratch.iterdir():  # all that a run needs is the program
                    if path.name not in (design.top, "build.log"):
                        path.unlink() if path.is_file() else shutil.rmtree(path)
                # Only whole builds get the name that is looked for.
                scratch.rename(folder)
            except (SystemExit, RuntimeError) as error:
                log = (scratch / "build.log").read_text().splitlines()[-40:]
                raise AssertionError("\n".join(log)) from error
            finally:
                shutil.rmtree(scratch, ignore_errors=True)
    return folder


def run(design: Design, bench: str, tmp_path: Path, only: str | None = None, **arguments: Any) -> None:
    """Run all cocotb tests of the module ``bench`` on a design, or one; ``arguments`` reach it as JSON."""
    results, log = _simulate(design, bench, tmp_path, arguments, only)
    assert results, f"no test of {bench} ran\n{log}"
    assert all(result == PASSED for result in results.values()), log


@dataclass(frozen=True)
class Variant:
    """A design among others, and what the bench has to know of it."""

    name: str
    design: Design
    arguments: Mapping[str, Any]


def run_variants(variants: Sequence[Variant], bench: str, tmp_path: Path) -> list[str]:
    """Run all cocotb tests of the module ``bench`` on every variant, one after the other in one simulation.

    Return of each variant an empty text if all its tests passed, else the log of the simulation that says
    why not.
    """
    design = side_by_side([variant.design for variant in variants])
    waiting = {f"v{i}": dict(variant.arguments) for i, variant in enumerate(variants)}
    logs = dict.fromkeys(waiting, "")
    while waiting:
        folder = Path(tempfile.mkdtemp(dir=tmp_path))
        results, log = _simulate(design, bench, folder, waiting)
        found = {name: [v for k, v in results.items() if f"/variant={name}/" in f"{k}/"] for name in waiting}
        bad = {name for name, of_one in found.items() if not of_one or any(v != PASSED for v in of_one)}
        # An assertion of the sources ends the simulation, and what comes after it has not been tried yet.
        ended = {name for name, of_one in found.items() if ENDED in of_one}
        logs |= dict.fromkeys(ended or bad, log)
        waiting = {name: waiting[name] for name in waiting if ended and name not in ended}
    return list(logs.values())


PASSED, ENDED = "", "SimFailure"
"""Results of a test; of a failed one it is its failure's type, and that one says that the simulator ended."""


RESET_BY = 100_000
"""The time, in picoseconds, by which every bench has reset its design."""

STARTS = 16
"""So many seeds are tried until a simulation gets as far as its reset: about half of them do."""


def _simulate(
    design: Design, bench: str, folder: Path, arguments: Mapping[str, Any], only: str | None = None
) -> tuple[dict[str, str], str]:
    """Run the tests of a bench; return the result of each, and the end of what the simulation wrote."""
    built = build(design)
    log, results = folder / "bench.log", folder / "results.xml"
    # Every run begins with other values in what no reset sets, and always with the same.
    seed = 1 + zlib.crc32(json.dumps([bench, arguments]).encode()) % 0x7FFFFF00
    for start in range(STARTS):
        _run(design, bench, folder, arguments, built, seed + start, only)
        # The clock and the reset, too, are random before the bench sets them, at time 0. Until the first
        # edges of a reset, assertions may fail: that is no fault of a design that nobody has reset yet.
        failed_at = re.findall(r"\[(\d+)\] %Error", log.read_text(errors="replace"))
        if all(int(picoseconds) > RESET_BY for picoseconds in failed_at):
            break
    text = "\n".join(log.read_text(errors="replace").splitlines()[-60:])
    if not results.exists():
        return {}, text
    if counted := os.environ.get(COVERAGE_VARIABLE):
        with tempfile.NamedTemporaryFile(dir=counted, suffix=".dat", delete=False) as kept:
            kept.write((folder / "coverage.dat").read_bytes())
    cases = ET.parse(results).getroot().iter("testcase")
    return {str(case.get("name")): _result(case) for case in cases if case.find("skipped") is None}, text


def _run(
    design: Design,
    bench: str,
    folder: Path,
    arguments: Mapping[str, Any],
    built: Path,
    seed: int,
    only: str | None,
) -> None:
    # The runner raises one or the other when a test fails, or the simulator does. The results say it too.
    with contextlib.suppress(SystemExit, RuntimeError):
        get_runner("verilator").test(
            hdl_toplevel=design.top,
            hdl_toplevel_lang="verilog",
            test_module=bench,
            test_filter=only,
            build_dir=built,
            test_dir=folder,
            # A build remembers where cocotb was when it was made; another virtual environment that
            # finds it in the cache keeps its own cocotb elsewhere.
            extra_env={
                BENCH_VARIABLE: json.dumps(arguments),
                "PYTHONPATH": str(HERE),
                "LD_LIBRARY_PATH": str(libs_dir),
                # cocotb would have pytest rewrite, and so compile anew, every module that is imported.
                "COCOTB_REWRITE_ASSERTION_FILES": "bench*.py",
            },
            plusargs=["+verilator+rand+reset+2", f"+verilator+seed+{seed}"],
            log_file=folder / "bench.log",
            results_xml=str(folder / "results.xml"),
        )


def _result(case: ET.Element) -> str:
    failures = [*case.iter("failure"), *case.iter("error")]
    return str(failures[0].get("type")) if failures else PASSED


def arguments() -> Any:
    """In a bench: what the pytest side passed to :func:`run`, or of each variant by its instance's name."""
    return json.loads(os.environ[BENCH_VARIABLE])
