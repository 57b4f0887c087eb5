"""A section of ``pearl report``: a module of this package with the attributes of :class:`ReportSection`.

To add one, write the module and put its name into ``SECTIONS`` of ``report.py``. Everything that it shows,
picture and table alike, is made of the rows that its ``collect()`` returned: these are what is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from pearl_marl.rendering import new_figure

T = TypeVar("T")

Row = dict[str, Any]
"""A flat dict of texts and numbers, as JSON and CSV have them. Each has ``kind``, one of :data:`KINDS`; what
a row has no value for is ``None``, or left out."""

KINDS = {
    "measured": "timed or counted on the machine named under the section",
    "simulated": "counted in the FPGA design, which Verilator simulates; a rate is that of the simulation",
    "predicted": "by a model of latency, or a tool's estimate of a design that has not been on a board",
    "quoted": "somebody else's figure, from the place named",
    "missing": "not measured here, for the reason named",
}


QUICK_ENVS = ("CliffWalking", "Blackjack", "CartPole")
"""The environments of a quick report's tables: a core of each is made, and those of others are larger."""


class Progress(Protocol):
    """Iterates over items and shows how far it is; ``pearl_marl.cli.common.progress`` is one."""

    def __call__(self, items: Iterable[T], total: int, label: str) -> Iterator[T]:
        """Yield the items."""
        ...


class ReportSection(Protocol):
    """A table or a figure; its name is that of its module, and of its files."""

    TITLE: str
    TEXT: str
    """What it shows, in a sentence or two, for the page."""
    COLUMNS: Mapping[str, str]
    """Headings of the page's table by keys of a row; ``kind`` always comes first, and is not named here."""

    def collect(self, quick: bool, progress: Progress) -> list[Row]:
        """Measure everything, or with ``quick`` a small part in some seconds.

        Raises
        ------
        PearlError
            It cannot be done here; the message says why and what to do. Other sections are made all the same.
        """
        ...

    def draw(self, rows: list[Row]) -> Any:
        """Return a figure of matplotlib; a mere table has no such function."""
        ...


def row_of(kind: str, counts: str, **values: Any) -> Row:
    """Return a row: its kind, its values, and what is counted or from where."""
    return {"kind": kind, **values, "counts": counts}


def select(rows: Iterable[Row], **wanted: Any) -> list[Row]:
    """Return the rows that have all these values."""
    return [row for row in rows if all(row.get(key) == value for key, value in wanted.items())]


def having(rows: Iterable[Row], key: str) -> list[Row]:
    """Return the rows that have a value of that key."""
    return [row for row in rows if row.get(key) is not None]


# ---- What the pictures have in common ----

WIDTH = 9.0
"""Inches: at 100 dots an inch as wide as the page."""


class Colour:
    """Okabe and Ito's colours, which people tell apart who do not see all of them, and a dark purple."""

    BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
    BLUE, RED, PINK, PURPLE = "#0072B2", "#D55E00", "#CC79A7", "#5B2A86"


LINES: dict[str, dict[str, Any]] = {
    "measured": {"linestyle": "-", "marker": "o"},
    "simulated": {"linestyle": "--", "marker": "s"},
    "predicted": {"linestyle": "-.", "marker": "^", "markerfacecolor": "white"},
    "quoted": {"linestyle": ":", "marker": "x"},
}
"""How a line of each kind looks."""

HATCHES = {"measured": "", "simulated": "///", "predicted": "...", "quoted": "xx"}
"""How a bar of each kind looks."""


def log_axis(axes: Any, which: str, values: Iterable[float], ticks: bool = False) -> None:
    """Make the ``"x"`` or ``"y"`` axis logarithmic: over whole decades, or with ``ticks`` one a value."""
    found = sorted(set(values))
    axes.set(**{f"{which}scale": "log"})
    if ticks:
        axis = axes.xaxis if which == "x" else axes.yaxis
        axis.set_ticks(found, [f"{value:,}" for value in found])
        axis.set_ticks([], minor=True)
    elif found:
        low, high = math.floor(math.log10(found[0])), math.ceil(math.log10(found[-1]))
        axes.set(**{f"{which}lim": (10.0**low, 10.0 ** max(high, low + 1))})


def subplots(lines: int, columns: int, height: float, **options: Any) -> Any:
    """Return a figure as wide as the page and so many inches high, and its panels."""
    figure = new_figure(WIDTH, height)
    return figure, figure.subplots(lines, columns, **options)


def panels(names: Sequence[str], head: float, height: float, **options: Any) -> tuple[Any, dict[str, Any]]:
    """Return a figure with a panel for each name, four in a line; the heights are inches."""
    columns = min(4, len(names))
    lines = -(-len(names) // columns)
    figure, grid = subplots(lines, columns, head + height * lines, squeeze=False, **options)
    for axes in list(grid.flat)[len(names) :]:
        axes.axis("off")
    return figure, dict(zip(names, list(grid.flat)[: len(names)], strict=True))


def bars(axes: Any, places: Any, values: Any, height: float, form: str = "{:,.0f}", **options: Any) -> None:
    """Draw bars to the right, and their values beside them."""
    drawn = axes.barh(places, values, height, edgecolor="white", **options)
    axes.bar_label(drawn, fmt=form, fontsize=7, padding=2)


def tidy(*panels: Any, grid: bool = True) -> None:
    """Take lines away from around panels, and put pale ones into them."""
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
        if grid:
            axes.grid(alpha=0.3)


def legend(
    figure: Any, handles: Mapping[str, Any], columns: int, place: str = "upper", **options: Any
) -> None:
    """Put a legend above a figure, or below it; the handles by their labels."""
    options = {"loc": f"outside {place} center", "ncols": columns, "fontsize": 8, "frameon": False, **options}
    figure.legend(handles.values(), handles.keys(), **options)


def labelled(axes: Any) -> dict[str, Any]:
    """Return what has been drawn in a panel, by its labels."""
    handles, labels = axes.get_legend_handles_labels()
    return dict(zip(labels, handles, strict=True))
