"""An evaluation as one HTML page, with its plots in it."""

from __future__ import annotations

import html
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.base.files import replace_file
from pearl_marl.evaluation.run import Evaluation
from pearl_marl.rendering import new_figure

_STYLE = """\
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 56rem; margin: 2rem auto;
  padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
table { border-collapse: collapse; } th, td { padding: .2rem .9rem .2rem 0; text-align: right; }
th:first-child, td:first-child { text-align: left; } thead th { border-bottom: 1px solid #999; }
td { font-variant-numeric: tabular-nums; overflow-wrap: anywhere; } svg { max-width: 100%; height: auto; }
.note { color: #666; font-size: .9rem; }
"""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{title}</title>
<style>
{style}</style>
</head>
<body>
<h1>{title}</h1>
{facts}
<h2>Episodes</h2>
{episodes}
<p class="note">{interval}</p>
{outcomes}
{latency}
</body>
</html>
"""

_LATENCY = """<h2>Latency of a step of all agents</h2>
{table}
<p class="note">T1 to T7 are the times of the latency model. The first step is left out: it loads code.</p>
{stages}"""

_BLUE, _GREY = "#3b6ea5", "#999999"


def write_report(evaluation: Evaluation, result: dict[str, Any], path: Path) -> None:
    """Write the page. Needs matplotlib, of the ``render`` extra.

    ``result`` is the evaluation's :meth:`~pearl_marl.evaluation.Evaluation.summary`, and what the caller
    knows besides: ``policy``, ``lockstep`` and ``machine``.
    """
    note = ", simulated: times are the simulator's" if result["simulated"] else ""
    facts = {
        "Policy": result["policy"],
        "Device": result["device"] + note,
        "Agents": f"{result['n_agents']:,}, seed {result['seed']}",
        "Steps": f"{result['steps']:,} of every agent",
        "Time limit": f"{result['max_cycles']:,} steps" if result["max_cycles"] else "none",
        "Digest": result["digest"],
    }
    if "agent_steps_per_second" in result:
        facts["Rollouts"] = f"{result['agent_steps_per_second']:,.0f} agent-steps/s with the policy"
    if result["options"]:
        facts["Options"] = ", ".join(f"{name}={value}" for name, value in result["options"].items())
    if result["lockstep"] is not None:
        facts["Lockstep"] = f"{result['words_compared']:,} words equal to those of {result['lockstep']}"
    if "clock_cycles" in result:
        cycles = result["clock_cycles"]
        facts["Clock cycles of a step"] = f"{cycles['min']:,} to {cycles['max']:,}"
    machine = result["machine"]
    facts["Machine"] = f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}"
    spans = [
        (
            name.capitalize(),
            *(_number(result[name][key]) for key in ("mean", "ci95_low", "ci95_high", "std", "min", "max")),
        )
        for name in ("return", "length")
    ]
    page = _PAGE.format(
        style=_STYLE,
        title=html.escape(f"{result['environment']} on {result['device']}"),
        facts=_table((), facts.items()),
        episodes=f"<p>{result['episodes']:,} episodes, of them truncated {result['truncated']:,}.</p>"
        + _table(("", "mean", "95 % from", "to", "std", "min", "max"), spans),
        interval=html.escape(result["interval"]),
        outcomes=_outcomes(evaluation, result),
        latency=_latency(result) if "latency" in result else "",
    )
    replace_file(path, page.encode("utf-8", "xmlcharrefreplace"))  # a name may have what is no letter


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:,.2f}"


def _table(headings: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    head = "".join(f"<th>{html.escape(heading)}</th>" for heading in headings)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) + "</tr>\n" for row in rows
    )
    return f"<table>{f'<thead><tr>{head}</tr></thead>' if head else ''}<tbody>\n{body}</tbody></table>"


def _outcomes(evaluation: Evaluation, result: dict[str, Any]) -> str:
    figure = new_figure(9, 2.8)
    both = figure.subplots(1, 2)
    for axes, name, values in zip(
        both, ("return", "length"), (evaluation.returns, evaluation.lengths), strict=True
    ):
        distinct = np.unique(values)
        # A bar for each value where there are few, so that no bin has two of them and its neighbour one.
        if distinct.size <= 40:
            counts = [np.count_nonzero(values == value) for value in distinct]
            width = 0.8 * min(np.diff(distinct), default=1.0)
            axes.bar(distinct, counts, width=width, color=_BLUE)
            if distinct.size == 1:
                axes.set_xlim(distinct[0] - 5, distinct[0] + 5)
        else:
            axes.hist(values, bins=40, color=_BLUE)
        axes.axvline(
            result[name]["mean"], color="black", linewidth=1, label=f"mean {result[name]['mean']:,.2f}"
        )
        if result[name]["ci95_low"] is not None:
            axes.axvspan(
                result[name]["ci95_low"], result[name]["ci95_high"], color="black", alpha=0.2, linewidth=0
            )
        axes.set(xlabel=f"{name} of an episode", ylabel="episodes")
        axes.legend(frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
    return _svg(figure, "Histograms of returns and lengths")


def _latency(result: dict[str, Any]) -> str:
    rows = [
        (
            row["stage"],
            row["paper"] or "",
            *(f"{row[key]:,.1f}" for key in ("p50_us", "p90_us", "p99_us", "max_us")),
        )
        for row in (
            *result["latency"],
            {"stage": "step, without the policy", "paper": "", **result["step"]},
        )
    ]
    table = _table(("stage", "time", "median, us", "90 %", "99 %", "max"), rows)
    return _LATENCY.format(table=table, stages=_stages(result))


def _stages(result: dict[str, Any]) -> str:
    rows = result["latency"]
    figure = new_figure(9, 0.5 + 0.75 * len(rows))
    grid = figure.subplots(len(rows), 1, sharex=True, squeeze=False)
    for axes, row in zip(grid[:, 0], rows, strict=True):
        edges, counts = np.array(row["histogram"]["edges_us"]), row["histogram"]["counts"]
        axes.stairs(counts, edges, fill=True, color=_BLUE if row["paper"] else _GREY)
        axes.axvline(row["p50_us"], color="black", linewidth=1)
        label = row["stage"] + (f" ({row['paper']})" if row["paper"] else "")
        axes.set_ylabel(label, rotation=0, ha="right", va="center")
        axes.set(xscale="log", yticks=[])
        axes.spines[["top", "right", "left"]].set_visible(False)
    grid[-1, 0].set_xlabel("microseconds (log scale); the line is the median")
    return _svg(figure, "Histogram of each stage's latency")


def _svg(figure: Any, title: str) -> str:
    import matplotlib

    text = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):  # letters, not outlines of them
        figure.savefig(text, format="svg", metadata={"Date": None})
    _, _, drawing = text.getvalue().partition("<svg ")  # what comes before is for a file of its own
    return f'<svg role="img" aria-label="{html.escape(title)}" {drawing}'
