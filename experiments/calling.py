"""How a script of this folder is called: ``-h`` is for help, and what is refused is told by one sentence."""

from __future__ import annotations

import sys
from collections.abc import Callable

import typer
from rich.console import Console

from pearl_marl.errors import PearlError


def call(main: Callable[..., None]) -> None:
    """Call a script's function with the arguments of the command line."""
    app = typer.Typer(add_completion=False, context_settings={"help_option_names": ["-h", "--help"]})
    app.command()(main)
    try:
        app()
    except PearlError as error:
        console = Console(stderr=True, highlight=False, markup=False, emoji=False)
        console.print(f"Error: {error}", soft_wrap=True)
        sys.exit(2)
