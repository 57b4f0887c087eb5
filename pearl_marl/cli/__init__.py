"""The command line: ``pearl``. One file a command; this one puts them together.

May import everything; of the experiments, :mod:`~pearl_marl.cli.report` alone.
"""

from __future__ import annotations

import sys
from typing import Annotated, NoReturn

import typer
from rich.markup import escape

from pearl_marl.cli import (
    bench,
    board,
    core,
    doctor,
    envs,
    eval,
    new,
    plan,
    report,
    run,
    serve,
    synth,
    train,
    verify,
)
from pearl_marl.cli.common import error_console
from pearl_marl.cli.interrupts import STATUS, interrupts
from pearl_marl.errors import PearlError
from pearl_marl.version import __version__

app = typer.Typer(
    name="pearl",
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
COMMANDS = {
    module.__name__.rpartition(".")[2]: module.command
    for module in (
        envs,
        doctor,
        run,
        train,
        eval,
        bench,
        verify,
        serve,
        core,
        synth,
        plan,
        board,
        new,
        report,
    )
}
for name, command in COMMANDS.items():
    app.command(name)(command)


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

    A refused call prints its sentence and exits with status 2, an interrupted one with status 130.
    """
    with interrupts.watched():
        try:
            app()
        except BaseException as error:
            # A library may have made another exception of Ctrl-C.
            if interrupts.noted and not (isinstance(error, SystemExit) and not error.code):
                _leave(interrupts.sentence, STATUS)
            if isinstance(error, PearlError):
                _leave(str(error), 2)
            raise


def _leave(sentence: str, status: int) -> NoReturn:
    error_console.print(f"[bold red]pearl:[/] {escape(sentence)}", soft_wrap=True)
    sys.exit(status)
