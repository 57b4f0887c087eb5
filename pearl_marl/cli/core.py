"""``pearl core``: an environment's hardware core, generated from its golden functions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pearl_marl.base.files import replace_file
from pearl_marl.cli import common
from pearl_marl.cli.common import console, error_console
from pearl_marl.compiler.cores import generated_core
from pearl_marl.compiler.targets import FAMILIES, Target
from pearl_marl.errors import ArgumentError


def command(
    env_id: common.EnvName,
    clock: Annotated[
        float, typer.Option(metavar="MHZ", help="The clock rate that the pipeline is built for.")
    ] = 150.0,
    family: Annotated[str, typer.Option(metavar="|".join(FAMILIES), help="The FPGA family.")] = "xc7",
    option: common.Options = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.sv", help="The file to write the core to; without it, the core is printed."
        ),
    ] = None,
    graph: Annotated[
        Path | None,
        typer.Option(metavar="FILE.svg", help="Draw the operations, stage by stage, into this file."),
    ] = None,
    as_json: common.AsJson = False,
) -> None:
    """Show the SystemVerilog core that an environment's golden functions become.

    It takes a slot in every clock cycle; options of the environment are constants in it.
    """
    if graph is not None and graph.suffix.lower() != ".svg":
        raise ArgumentError(f"--graph is {graph}; it must be a file that ends in .svg")
    if graph is not None and out is not None and graph.resolve() == out.resolve():
        raise ArgumentError(f"--out and --graph are both {out}: give one of them another name")
    for name, path in (("--out", out), ("--graph", graph)):
        if path is not None:
            common.check_file(name, path)
    spec = common.spec_of(env_id, option)
    core = generated_core(spec, Target(family, clock))
    if out is not None:
        replace_file(out, core.text.encode())
    if graph is not None:
        replace_file(graph, core.picture().encode())
    figures = {
        "environment": spec.id,
        "family": family,
        "clock_mhz": clock,
        "latency": core.latency,
        "interval": 1,
        "register_bits": core.register_bits,
        "multipliers": core.multipliers,
        "levels": round(core.levels, 1),
    }
    if as_json:
        common.print_json(figures)
        return
    if out is None:
        typer.echo(core.text, nl=False)
    (error_console if out is None else console).print(
        f"Latency {common.counted(core.latency, 'cycle')}, one result a cycle; "
        f"{common.counted(core.register_bits, 'register bit')}, "
        f"{common.counted(core.multipliers, 'multiplier')}, "
        f"{core.levels:.1f} levels of logic in the slowest stage (estimated).",
        soft_wrap=True,
    )
    for path in (out, graph):
        if path is not None:
            error_console.print(f"Wrote {path}.", soft_wrap=True, markup=False)
