"""``pearl board``: a design for a board, up to the bitstream where the tools are free."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from pearl_marl.base.files import claimed
from pearl_marl.cli import common
from pearl_marl.cli.common import console
from pearl_marl.hardware import boards
from pearl_marl.hardware.boards import BOARDS, Placed


def command(
    board_name: Annotated[str, typer.Argument(metavar="|".join(BOARDS), help="The board.")],
    env_id: common.EnvName,
    out: Annotated[Path, common.folder_option("The folder to write everything into.")],
    n_envs: Annotated[int, typer.Option(help="Number of slots (worlds) of the design.")] = 1024,
    pe_num: Annotated[
        int | None,
        typer.Option(help="Number of processing elements; by default as many as the board's bus can feed."),
    ] = None,
    policy: common.EnginePolicy = None,
    option: common.Options = None,
    as_json: common.AsJson = False,
) -> None:
    """Make a board's bitstream, or everything that the vendor's tool needs to make it.

    For ECP5 and Gowin boards the tools are free, and this runs them. For a Xilinx board it writes the sources
    with a script for Vivado.
    """
    board, spec = boards.find(board_name), common.spec_of(env_id, option)
    build = boards.board_build(board, spec, n_envs, pe_num, common.device_policy(policy, spec))
    placed: Placed | None = None
    with claimed(out, "makes a bitstream"):
        files = boards.write(board, build, out)
        if board.flow:
            stages = boards.make_bitstream(board, board.flow, out)
            for _ in common.progress(stages, boards.STAGES, f"{spec.name} on {board.name}, {n_envs:,} slots"):
                pass
            placed = boards.placed(board.flow, out)
    if as_json:
        made = None if placed is None else asdict(placed)
        common.print_json({**boards.facts(board, build), "placed": made, "files": files})
        return
    title = f"{spec.id} for the {board.title} ({board.part}): {boards.size(build.layout)}"
    if placed is None:
        common.say(f"{title}. Wrote {len(files)} files into {out}. The bitstream is Vivado's to make:")
        common.say(f"cd {out} && vivado -mode batch -source build.tcl")
    else:
        grid = common.table(title, [], ["clock", "Fmax", "LUT", "FF", "block RAM", "DSP"])
        used = (f"{getattr(placed, name):,} of {count:,}" for name, count in placed.available.items())
        grid.add_row(f"{board.clock_mhz:g} MHz", f"{placed.fmax_mhz:.1f} MHz", *used)
        console.print(grid)
        common.say(
            f"Wrote {out / board.bitstream}; openFPGALoader -b {board.name} {out / board.bitstream} loads it."
        )
