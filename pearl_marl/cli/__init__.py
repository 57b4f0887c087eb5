"""The command line: ``pearl``. One file a command, which is imported when it is called."""

from __future__ import annotations

import errno
import io
import os
import re
import sys
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from rich.markup import escape
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from pearl_marl.base.version import __version__
from pearl_marl.cli import usage
from pearl_marl.cli.common import error_console
from pearl_marl.cli.interrupts import STATUS, interrupts
from pearl_marl.envs import authors_mistake
from pearl_marl.errors import PearlError

COMMANDS = {
    "envs": "List the environments: spaces, widths, rewards, limits.",
    "doctor": "Check what this machine can run; each problem comes with its fix.",
    "warm": "Compile ahead, for images and clusters: some environments, or all and the trainers.",
    "run": "Step every agent with random (or given) actions, or a policy's: "
    "throughput and episode statistics.",
    "train": "Train a policy that all agents share; with the --out of a run that was killed, resume it.",
    "quantize": "Make a policy in integers of a trained one, and measure the returns of both.",
    "eval": "Evaluate a policy on a device: returns, lengths, latency of every stage, and a digest.",
    "match": "Let policies play each other where agents share a world: who wins, and what returns they get.",
    "bench": "Measure speed beside that of other packages: of steps, rollouts, many agents, and trainings.",
    "verify": "Compare a device with the golden functions, "
    "every word of every field, or replay a divergence.",
    "serve": "Serve a simulated board, to be used with --device xdma:DIR, until Ctrl-C.",
    "core": "Show the SystemVerilog core that an environment's golden functions become.",
    "synth": "Synthesise a design with Yosys: LUT, FF, block RAM, DSP.",
    "plan": "Choose processing elements and word width for a link and a part; "
    "predict throughput and bottleneck.",
    "board": "Make a board's bitstream, or everything that the vendor's tool needs to make it.",
    "new": "Write a package with a small environment of that name: golden step, spec, tests, all working.",
    "report": "Measure every table and figure of the paper's evaluation, "
    "and write them as a page with its data.",
}
"""The commands, in the order of their list, each with the first sentence of its own help."""


class _Command(TyperCommand):
    """A command that says itself which arguments it does not take."""

    allow_extra_args = True

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        others: list[str] = super().parse_args(ctx, args)
        if not ctx.resilient_parsing:  # a shell completes a word
            usage.refuse_others(ctx, others, sys.argv[1:])
        return others


class _Commands(TyperGroup):
    """Has the list of commands without importing any, and imports the one that is called."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if not ctx.resilient_parsing:  # a shell completes a word
            usage.refuse_empty(args)
        name, _, rest = super().resolve_command(ctx, args)  # which refuses what is no command
        alone = typer.Typer(add_completion=False, rich_markup_mode=self.rich_markup_mode)
        with interrupts.at_once():  # Numba and PyTorch take seconds to load
            module = import_module(f"{__name__}.{name}")
        if hasattr(module, "app"):  # of several commands
            for command in module.app.registered_commands:
                command.cls = _Command
            return name, typer.main.get_command(module.app), module.current(rest)
        alone.command(name, cls=_Command)(module.command)
        return name, typer.main.get_command(alone), rest


app = typer.Typer(
    name="pearl",
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _name, _help in COMMANDS.items():
    app.command(_name, help=_help)(lambda: None)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pearl {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
    ] = False,
) -> None:
    """Step tens of thousands of reinforcement-learning environments at once."""


def main() -> None:
    """Run the command line.

    A refused call prints its sentence and exits with status 2, an interrupted one with status 130; one whose
    output cannot be written, or in which an author's package fails, with status 1.
    """
    _complete_streams()
    with interrupts.watched():
        try:
            if not _is_somewhere():
                _leave("the current folder is no more: change to one that there is", 2)
            status = app(standalone_mode=False)
            sys.stdout.flush()  # what cannot be written is to be noticed here
            sys.exit(status)
        except BaseException as error:
            # A library may have made another exception of Ctrl-C.
            if interrupts.noted and not (isinstance(error, SystemExit) and not error.code):
                _leave(interrupts.sentence, STATUS)
            if isinstance(error, PearlError):
                _leave(str(error), 2)
            if isinstance(error, TyperException):
                if len(sys.argv) == 1:  # `pearl` alone has shown its help
                    sys.exit(2)
                _leave(usage.sentence(error, COMMANDS, sys.argv[1:]), 2)
            if isinstance(error, OSError) and error.errno in _UNWRITABLE and error.filename is None:
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Python writes the rest when it ends
                _leave(f"the output cannot be written: {error.strerror}", 1)
            if isinstance(error, MemoryError):
                _leave("there is not enough memory for that: take fewer agents, or a smaller file", 2)
            if isinstance(error, Exception) and (sentence := authors_mistake(error)):
                _leave(sentence, 1)
            raise


_UNWRITABLE = errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO
"""What a write fails with, to standard output or to a file that is open."""


def _complete_streams() -> None:
    """Have streams that take whatever is printed: a caller may have closed one, or have only ASCII."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - until Python ends
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _is_somewhere() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def _leave(sentence: str, status: int) -> NoReturn:
    sentence = re.sub(r"(\S{80})\S{160,}(\S{80})", r"\1...\2", sentence)  # a value may fill the screen
    error_console.print(f"[bold red]pearl:[/] {escape(sentence)}", soft_wrap=True)
    sys.exit(status)
