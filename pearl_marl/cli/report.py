"""``pearl report``: the paper's tables and figures, made here, as one page."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from pearl_marl.cli.common import console, error_console, progress

Quick = Annotated[bool, typer.Option("--quick", help="A small part of everything, in a minute or two.")]
Folder = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="The report's folder, new or to go on with.")
]
Only = Annotated[
    list[str] | None, typer.Option("--only", metavar="SECTION", help="Make this section; may be repeated.")
]


def command(quick: Quick = False, out: Folder = Path("out/report"), only: Only = None) -> None:
    """Measure every table and figure of the paper's evaluation, and write them as a page with its data.

    A full run takes hours. Started again, it keeps the sections that it had finished. Exit status 1: one
    could not be made.
    """

    def say(line: str) -> None:
        error_console.print(escape(line), highlight=False, soft_wrap=True)

    from pearl_marl.experiments import report  # which takes what the report extra has

    made = report.report(out, quick, only or (), progress, say)
    table = Table(title="Report")
    for heading in ("section", "rows", "measured", "simulated", "predicted", "quoted", "missing"):
        table.add_column(heading, justify="left" if heading == "section" else "right", no_wrap=True)
    for name, data, problem in made:
        if data is None:
            table.add_row(name, f"[bold red]not made[/]: {escape(problem or '')}")
            continue
        kinds = [row["kind"] for row in data["rows"]]
        counts = [kinds.count(str(column.header)) for column in table.columns[2:]]
        table.add_row(name, f"{len(kinds)}", *(f"{count}" if count else "" for count in counts))
    console.print(table)
    console.print(f"Wrote {out / 'index.html'}", highlight=False, soft_wrap=True)
    if any(each.problem for each in made):
        sys.exit(1)
