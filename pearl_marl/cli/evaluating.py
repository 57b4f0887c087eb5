"""What ``pearl eval`` and ``pearl match`` share: options, and running in lockstep."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.markup import escape

from pearl_marl.cli import common
from pearl_marl.cli.common import error_console, in_file_name, replaying
from pearl_marl.devices import Device, Lockstep
from pearl_marl.errors import ArgumentError, LockstepError
from pearl_marl.evaluation.run import LIMIT
from pearl_marl.spec import EnvSpec

MaxCycles = Annotated[int | None, common.max_cycles_option(f"the environment's, or {LIMIT:,}")]
InLockstep = Annotated[
    bool, typer.Option("--lockstep", help="Compare every word of every step with the golden functions.")
]
REFERENCE = "reference"
"""The device that ``--lockstep`` compares with."""


def device_maker(device: str, lockstep: bool) -> Callable[[], str | Device]:
    """Return a function that makes the device to step with; in lockstep it is compared with the reference."""
    if not lockstep:
        return lambda: device
    if device == REFERENCE:
        raise ArgumentError(
            f"--lockstep compares with {REFERENCE!r}, which always agrees with itself: name another --device"
        )
    return lambda: Lockstep(device, REFERENCE)


def divergence_file(spec: EnvSpec, device: str) -> str:
    """Return the name of the file that tells where a device differs from the golden functions."""
    return f"divergence_{spec.name}_{in_file_name(device)}.json"


def end_with(error: LockstepError, out: Path | None, file: str, env_id: str, device: str) -> NoReturn:
    """Print where a device differs, write the file that replays it, and end with status 1."""
    error_console.print(f"[bold red]Not bit-exact.[/] {escape(str(error))}", soft_wrap=True)
    if out is not None:
        path = out / file
        error.replay.write(path)
        again = replaying(path, env=env_id, device=device)
        error_console.print(f"Wrote {path}: {again} replays it.", markup=False, soft_wrap=True)
    sys.exit(1)
