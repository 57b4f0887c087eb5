"""Figure 6: steps per second of this package, of its peers, simulated, and predicted on the paper's board."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np

from pearl_marl.batch.actions import random_actions
from pearl_marl.benchmark.contenders import contenders, simulated
from pearl_marl.benchmark.measure import Contender, measure
from pearl_marl.benchmark.paper import TABLE_2
from pearl_marl.devices import Rtl
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware.fitting import PARTS
from pearl_marl.latency import LINKS
from pearl_marl.plan import Plan, plan
from pearl_marl.registry import get_spec, names
from pearl_marl.rendering import import_pyplot
from pearl_marl.spec import EnvSpec

from . import paper, pipeline
from .section import (
    BLACK,
    BLUE,
    GREEN,
    LINES,
    ORANGE,
    PINK,
    PURPLE,
    RED,
    SKY,
    WIDTH,
    Progress,
    Row,
    log_axis,
    select,
)

TITLE = "Figure 6: throughput"
TEXT = (
    "Agent-steps per second over the number of environments: Gymnasium's vector environments, MinAtar, "
    "EnvPool, this package on the CPU, the FPGA design simulated by Verilator, and the same design "
    "predicted behind the link of the paper's board (PCIe 2.0 x8, 125 MHz). The paper's own rates are of "
    "its machine. "
    "Solid lines are measured, dashed ones simulated, dash-dotted ones predicted, dotted ones quoted."
)
COLUMNS = {
    "environment": "environment",
    "contender": "contender",
    "n_envs": "environments",
    "steps_per_second": "steps/s",
    "microseconds_per_step": "us a step of all",
    "over_envpool": "over EnvPool",
    "over_vector_env": "over SyncVectorEnv",
    "over_no_pipeline": "over no pipeline",
    "counts": "what is counted, or from where",
}
SEEDS = (0,)

SIZES = (64, 1024, 8192, 43008)
QUICK_SIZES = (7, 64)
LARGE_SIMULATION = 64
"""Models of more slots are built of :data:`README_ENV` alone: others take long to compile."""
README_ENV = "CliffWalking"
"""What the README's first table is about: everything of ``pearl bench`` is timed, at the largest size."""

ENVPOOL, SYNC, KERNEL, BATCH = "EnvPool, sync", "Gymnasium SyncVectorEnv", "kernel only", "step_batch"
SIMULATED = "step_batch, device='rtl'"
SIMULATED_SERIAL = "simulated, without pipeline"
SIMULATIONS = (SIMULATED, SIMULATED_SERIAL)
BOARD_SERIAL = "predicted, without pipeline"
BOARD, BOARD_OVERLAP = "predicted on a VC707", "predicted, two half-batches in flight"
PEERS = (ENVPOOL, SYNC, "Gymnasium AsyncVectorEnv", "Gymnasium's own vectorisation", "MinAtar")
LINK, CLOCK, PART = LINKS["gen2x8"], 125e6, PARTS["vc707"]


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Time every environment at every size; predict the board; add the paper's figures."""
    environments = [README_ENV, "CartPole"] if quick else names()
    sizes = QUICK_SIZES if quick else SIZES
    rows: list[Row] = []
    for name in environments:
        spec = get_spec(name)
        for n in sizes:
            rows += throughput(spec, n, rows, quick, progress)
            rows += predicted(spec, n)
    for row in rows:
        # How long Verilator takes for either form says nothing of hardware.
        serial = BOARD_SERIAL if row["contender"] == BOARD else ""
        rivals = {"over_envpool": ENVPOOL, "over_vector_env": SYNC, "over_no_pipeline": serial}
        row |= {key: _over(row, rows, rival) for key, rival in rivals.items()}
    for name in list(TABLE_2)[: 1 if quick else None]:
        rows += compared(name)
    return rows + _quoted()


def throughput(
    spec: EnvSpec,
    n: int,
    known: Iterable[Row],
    quick: bool,
    progress: Progress,
    only: Iterable[str] | None = None,
) -> list[Row]:
    """Time the contenders of ``pearl bench`` at one size, but for those that ``known`` has at theirs.

    Parameters
    ----------
    spec, n
        What is stepped.
    known
        Rows already there. Peers of pure Python are timed with fewer slots than asked for, at most.
    quick
        One short round.
    progress
        Shows how far it is.
    only
        Names of contenders; all that suit the size, if not given.
    """
    everything = spec.name == README_ENV and n == SIZES[-1]
    had = {(row["environment"], row["contender"], row["n_envs"]) for row in known}
    timed = [
        c
        for c in [*contenders(spec, n), simulated_without_pipeline(spec, n)]
        if (spec.name, c.name, c.n) not in had
        and (only is None or c.name in only)
        and (
            everything
            or c.name in (KERNEL, BATCH, *PEERS)
            or (c.name in SIMULATIONS and _built(spec, n, quick))
        )
    ]
    rounds, seconds = (1, 0.01) if quick else (5, 0.2)
    for _ in progress(measure(timed, rounds, seconds), len(timed) * (rounds + 1), f"{spec.name}, {n:,}"):
        pass
    return [_row(spec, c) for c in timed if not (c.unavailable or "").startswith(_NOT_OF_IT)]


_NOT_OF_IT = ("MinAtar has no", "Gymnasium has no")
"""How those say so that have only some of the environments: it is no gap in the measurements."""


def _built(spec: EnvSpec, n: int, quick: bool) -> bool:
    if quick:
        return spec.name == README_ENV and n == QUICK_SIZES[0]
    return spec.name == README_ENV or n <= LARGE_SIMULATION


def _row(spec: EnvSpec, contender: Contender) -> Row:
    row: Row = {
        "kind": "simulated" if contender.name in SIMULATIONS else "measured",
        "environment": spec.name,
        "contender": contender.name,
        "ours": contender.ours,
        "n_envs": contender.n,
    }
    if contender.unavailable is not None:
        return {**row, "kind": "missing", "counts": contender.unavailable}
    return {
        **row,
        "steps_per_second": contender.n / contender.seconds_per_step,
        "microseconds_per_step": contender.seconds_per_step * 1e6,
        "counts": contender.counts,
    }


def predicted(spec: EnvSpec, n: int) -> list[Row]:
    """Predict the build that ``pearl plan`` chooses for the paper's board: T1 to T7, and two half-batches."""
    common: Row = {"environment": spec.name, "contender": BOARD, "ours": True, "n_envs": n}
    try:
        chosen = plan(spec, n, LINK, CLOCK, PART)
    except ArgumentError as error:  # so many slots do not fit the part
        return [{**common, "kind": "missing", "counts": str(error)}]
    prediction = chosen.chosen.prediction
    build = f"{prediction.pe_num} PEs, {prediction.data_wl}-bit words, {CLOCK / 1e6:g} MHz, {LINK.name}"
    rows: list[Row] = [
        {
            **common,
            "kind": "predicted",
            "steps_per_second": prediction.rate,
            "microseconds_per_step": prediction.total * 1e6,
            "counts": f"{build}; T1 and T7 measured here",
        }
    ]
    if chosen.overlap is not None:
        rows.append(
            {
                **common,
                "contender": BOARD_OVERLAP,
                "kind": "predicted",
                "steps_per_second": chosen.overlap.rate,
                "microseconds_per_step": chosen.overlap.total * 1e6,
                "counts": f"{build}; two designs of half the slots, in turns",
            }
        )
    return [*rows, predicted_without_pipeline(spec, chosen)]


def simulated_without_pipeline(spec: EnvSpec, n: int) -> Contender:
    """Return the simulated design in the paper's form without pipeline: one slot after the other."""
    actions = random_actions(spec, np.random.default_rng(0), n)
    make = partial(simulated, spec, actions, partial(Rtl, pe_num=1, pipelined=False))
    counts = "the FPGA design with one PE and no overlap, under Verilator, by backdoor; one thread"
    return Contender(SIMULATED_SERIAL, counts, n, make, ours=True)


def predicted_without_pipeline(spec: EnvSpec, chosen: Plan) -> Row:
    """Predict the same form behind the same link: states go to it and come back with every step."""
    layout = chosen.chosen.layout
    prediction = pipeline.predicted(spec, layout.n_envs, 1, layout.data_wl, False, chosen.host)
    build = f"1 PE, {layout.data_wl}-bit words, {CLOCK / 1e6:g} MHz, {LINK.name}"
    return {
        "kind": "predicted",
        "environment": spec.name,
        "contender": BOARD_SERIAL,
        "ours": True,
        "n_envs": layout.n_envs,
        "steps_per_second": prediction.rate,
        "microseconds_per_step": prediction.total * 1e6,
        "counts": f"{build}; no overlap, states moved with every step; T1 and T7 measured here",
    }


def compared(name: str) -> list[Row]:
    """Predict both forms in the processing elements and word of the paper, which compares them, too."""
    found = pipeline.compare(name)
    return [
        {
            "kind": "predicted",
            "environment": name,
            "contender": f"predicted in the paper's sizes, {form}",
            "ours": True,
            "n_envs": prediction.n_envs,
            "steps_per_second": prediction.rate,
            "microseconds_per_step": prediction.total * 1e6,
            "over_no_pipeline": over,
            "counts": f"{prediction.pe_num} PEs, {prediction.data_wl}-bit words, as many slots as fit",
        }
        for form, prediction, over in (
            ("with pipeline", found.pipelined, found.factor),
            ("without", found.serial, None),
        )
    ]


def _over(row: Row, rows: list[Row], rival: str) -> float | None:
    """Return how many times a rival's rate a row of ours has; the rival with as many slots, or its most."""
    if not row.get("ours") or row.get("steps_per_second") is None:
        return None
    rivals = [
        other
        for other in select(rows, environment=row["environment"], contender=rival)
        if other.get("steps_per_second") is not None and other["n_envs"] <= row["n_envs"]
    ]
    if not rivals:
        return None
    best = max(rivals, key=lambda other: int(other["n_envs"]))
    return float(row["steps_per_second"] / best["steps_per_second"])


def _quoted() -> list[Row]:
    rows: list[Row] = [
        {
            "kind": "quoted",
            "environment": "CliffWalking",
            "contender": f"the paper: {name}",
            "steps_per_second": framework.steps_per_second,
            "counts": paper.FRAMEWORKS_SOURCE,
        }
        for name, framework in paper.FRAMEWORKS.items()
    ]
    rows += [
        {
            "kind": "quoted",
            "environment": name,
            "contender": "the paper: PEARL, their board",
            "over_vector_env": times,
            "counts": paper.THROUGHPUT_SOURCE,
        }
        for name, times in paper.OVER_VECTOR_ENV.items()
    ]
    for what, times in zip(("least", "most"), paper.OVER_ENVPOOL, strict=True):
        rows.append(
            {
                "kind": "quoted",
                "environment": f"the {what} of five",
                "contender": "the paper: PEARL, their board",
                "over_envpool": times,
                "counts": paper.THROUGHPUT_SOURCE,
            }
        )
    for what, times in zip(("least", "most"), paper.OVER_NO_PIPELINE, strict=True):
        rows.append(
            {
                "kind": "quoted",
                "environment": f"the {what} of five",
                "contender": "the paper: PEARL, their board",
                "over_no_pipeline": times,
                "counts": paper.THROUGHPUT_SOURCE,
            }
        )
    return rows


STYLES = {
    KERNEL: (BLACK, "kernel only (no observations)"),
    BATCH: (BLUE, "step_batch, one thread"),
    SIMULATED: (SKY, "FPGA design, simulated"),
    BOARD: (GREEN, "FPGA design, predicted on a VC707"),
    SIMULATED_SERIAL: (PURPLE, "simulated, without pipeline"),
    BOARD_SERIAL: (PURPLE, "predicted, without pipeline"),
    ENVPOOL: (RED, "EnvPool, all cores"),
    SYNC: (ORANGE, "Gymnasium SyncVectorEnv"),
    "Gymnasium's own vectorisation": (PINK, "Gymnasium's NumPy form, or MinAtar"),
    "MinAtar": (PINK, "Gymnasium's NumPy form, or MinAtar"),
}
"""Colour and legend of a contender; a peer's line is thin."""


def draw(rows: list[Row]) -> Any:
    """Draw a panel an environment: steps per second over environments, both logarithmic."""
    plt = import_pyplot()
    environments = sorted({row["environment"] for row in rows if row.get("n_envs") is not None})
    columns = min(4, len(environments))
    lines = -(-len(environments) // columns)
    figure, grid = plt.subplots(
        lines,
        columns,
        figsize=(WIDTH, 1.3 + 2.6 * lines),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    handles: dict[str, Any] = {}
    for axes, name in zip(grid.flat, environments, strict=False):
        handles |= _draw_lines(axes, select(rows, environment=name))
        handles |= _draw_quoted(axes, select(rows, environment=name, kind="quoted"))
        axes.set_title(name, fontsize=10)
        axes.tick_params(axis="x", labelsize=7)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    log_axis(grid[0, 0], "x", [row["n_envs"] for row in rows if row["contender"] == BATCH], ticks=True)
    log_axis(grid[0, 0], "y", [row["steps_per_second"] for row in rows if row.get("steps_per_second")])
    for axes in list(grid.flat)[len(environments) :]:
        axes.axis("off")
    figure.supxlabel("environments (log scale)", fontsize=10)
    figure.supylabel("agent-steps per second (log scale)", fontsize=10)
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=3, fontsize=8, frameon=False
    )
    return figure


def _draw_lines(axes: Any, rows: list[Row]) -> dict[str, Any]:
    """Draw a line a contender of one environment; return them by their names in the legend."""
    handles: dict[str, Any] = {}
    for contender, (colour, label) in STYLES.items():
        points = sorted(
            (row["n_envs"], row["steps_per_second"], row["kind"])
            for row in select(rows, contender=contender)
            if row.get("steps_per_second") is not None
        )
        if points:
            n, steps, kinds = zip(*points, strict=True)
            width = 1.0 if contender in PEERS else 2.0
            (handles[label],) = axes.plot(
                n, steps, color=colour, linewidth=width, markersize=4, label=label, **LINES[kinds[0]]
            )
    return handles


def _draw_quoted(axes: Any, rows: list[Row]) -> dict[str, Any]:
    """Draw the paper's rates as lines across; return the last by its name in the legend."""
    handles: dict[str, Any] = {}
    for row in rows:
        if row.get("steps_per_second") is not None:
            handles["the paper's rates (quoted)"] = axes.axhline(
                row["steps_per_second"], color="grey", linestyle=":", linewidth=1
            )
            axes.annotate(
                row["contender"].removeprefix("the paper: "),
                (0.02, row["steps_per_second"]),
                xycoords=("axes fraction", "data"),
                fontsize=6,
                color="dimgrey",
                va="bottom",
            )
    return handles
