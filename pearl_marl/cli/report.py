"""``pearl report``: the paper's tables and figures, made here, as one page."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from pearl_marl.cli import common
from pearl_marl.cli.common import AsJson, console, error_console, print_json, progress, table


def command(
    quick: Annotated[
        bool, typer.Option("--quick", help="Measure a small part of everything, in a minute or two.")
    ] = False,
    out: Annotated[
        Path,
        common.folder_option(
            "The report's folder; if it holds an unfinished report, the command continues it."
        ),
    ] = Path("out/report"),
    only: Annotated[
        list[str] | None, typer.Option(metavar="SECTION", help="Make only this section; may be repeated.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure every table and figure of the paper's evaluation, and write them as a page with its data.

    A full run takes hours. Started again, it keeps the sections that it had finished. Exit status 1: one
    could not be made.
    """

    def say(line: str) -> None:
        error_console.print(escape(line), soft_wrap=True)

    from pearl_marl.experiments import report  # which takes what the report extra has

    made = report.report(out, quick, only or (), progress, say)
    if as_json:
        sections = [
            {"section": name, "rows": None if data is None else len(data["rows"]), "problem": problem}
            for name, data, problem in made
        ]
        print_json({"page": str(out / "index.html"), "sections": sections})
        sys.exit(any(each.problem for each in made))
    kinds = ["measured", "simulated", "predicted", "quoted", "missing"]
    grid = table("Report", ["section"], ["rows", *kinds])
    for name, data, problem in made:
        if data is None:
            grid.add_row(name, f"[bold red]not made[/]: {escape(problem or '')}")
            continue
        counts = Counter(row["kind"] for row in data["rows"])
        grid.add_row(name, f"{counts.total()}", *(f"{counts[kind] or ''}" for kind in kinds))
    console.print(grid)
    common.say(f"Wrote {out / 'index.html'}")
    if any(each.problem for each in made):
        sys.exit(1)
