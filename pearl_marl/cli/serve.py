"""``pearl serve``: a simulated board for other processes to use."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from pearl_marl.batch.config import worlds_of
from pearl_marl.batch.results import check_memory
from pearl_marl.cli import common
from pearl_marl.cli.common import console
from pearl_marl.devices import BatchConfig
from pearl_marl.devices.rtl import Rtl
from pearl_marl.devices.served import ServedBoard
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.engines import with_engine


def command(
    env_id: common.EnvName,
    at: Annotated[Path, common.folder_option("The folder of the board's files.")],
    n_agents: common.Agents = None,
    pe_num: Annotated[
        int | None, typer.Option(help="Number of processing elements.", show_default="chosen")
    ] = None,
    data_wl: Annotated[int | None, typer.Option(help="Bits of a word.", show_default="chosen")] = None,
    path: Annotated[
        str, typer.Option(help="How a step's bytes reach the memories: `backdoor`, or over `axi`.")
    ] = "backdoor",
    policy: common.EnginePolicy = None,
    option: common.Options = None,
    as_json: common.AsJson = False,
) -> None:
    """Serve a simulated board, to be used with --device xdma:DIR, until Ctrl-C.

    One program at a time can use it, like a real board; when that program ends, another may start. A folder
    in memory, such as /dev/shm/board, is fastest.
    """
    Rtl(pe_num, data_wl, path)  # refuses what is no size or path
    spec = common.spec_of(env_id, option)
    config = BatchConfig(spec=spec, n_envs=worlds_of(spec, common.agents_of(spec, n_agents)))
    check_memory(config)
    build = with_engine(Build.of(spec, config.n_envs, pe_num, data_wl), common.device_policy(policy, spec))
    board = ServedBoard(at, spec, config.n_envs, pe_num, data_wl, path, build.layout.engine)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: board.stop())
    layout = board.layout
    facts = {
        "environment": board.spec.id,
        "options": dict(board.spec.options),
        "n_agents": config.n_agents,
        "pe_num": layout.pe_num,
        "data_wl": layout.data_wl,
        "path": path,
        "device": f"xdma:{at}",
        "pid": os.getpid(),
    }
    try:
        if as_json:
            common.print_json(facts)
        else:
            console.print(
                f"Serving {board.spec.id}, {common.counted(config.n_agents, 'agent')} on "
                f"{common.counted(layout.pe_num, 'processing element')}, "
                f"words of {layout.data_wl} bits. Use it as [bold]--device xdma:{escape(str(at))}[/]; "
                "Ctrl-C ends it.",
                soft_wrap=True,
            )
        board.serve()
    finally:
        board.close()
    if not as_json:
        console.print(f"Served {board.steps:,} steps.")
