"""The command line: ``pearl``. One file a command; this one puts them together."""

from __future__ import annotations

import sys

import typer
from rich.markup import escape

from pearl_marl.cli import (
    bench,
    board,
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
from pearl_marl.errors import PearlError

app = typer.Typer(
    name="pearl",
    help="Step tens of thousands of reinforcement-learning environments at once.",
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
)
for module in (envs, doctor, run, train, eval, bench, verify, serve, synth, plan, board, new, report):
    app.command(module.__name__.rpartition(".")[2])(module.command)


def main() -> None:
    """Run the command line; a refused call prints its sentence and exits with status 2."""
    try:
        app()
    except PearlError as error:
        error_console.print(f"[bold red]pearl:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        sys.exit(2)
