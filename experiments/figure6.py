"""Figure 6: steps per second of this package, of its peers, simulated, and predicted on the paper's board."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np

from pearl_marl.batch.actions import random_actions
from pearl_marl.benchmark.measure import Contender, measure
from pearl_marl.benchmark.paper import TABLE_2
from pearl_marl.benchmark.steps import contenders, simulated
from pearl_marl.benchmark.tables import BATCH, ENVPOOL, KERNEL
from pearl_marl.devices import Rtl
from pearl_marl.envs import get_spec, names
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware.fitting import PARTS
from pearl_marl.latency import plan
from pearl_marl.latency.prediction import Overlap, Prediction
from pearl_marl.spec import EnvSpec

from . import paper, paper_builds, pipeline
from .section import LINES, Colour, Progress, Row, having, legend, log_axis, panels, row_of, select, tidy

TITLE = "Figure 6: throughput"
TEXT = (
    "Agent-steps per second over the number of environments: Gymnasium's vector environments, MinAtar, "
    "EnvPool, this package on the CPU, the FPGA design simulated by Verilator, and the same design "
    f"predicted behind the link of the paper's board (PCIe 2.0 x8, {pipeline.CLOCK / 1e6:g} MHz). The "
    "paper's own rates are of its machine. "
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

SIZES = (64, 1024, 8192, 43008)
QUICK_SIZES = (7, 64)
LARGE_SIMULATION = 64
"""Models of more slots are built of :data:`WHOLE_ENV` alone: others take long to compile."""
WHOLE_ENV = "CliffWalking"
"""The environment in which all of ``pearl bench steps`` is timed, at the largest size."""

SYNC = "Gymnasium SyncVectorEnv"
SIMULATED = "step_batch, device='rtl'"
SIMULATED_SERIAL = "simulated, without pipeline"
SIMULATIONS = (SIMULATED, SIMULATED_SERIAL)
BOARD_SERIAL = "predicted, without pipeline"
BOARD, BOARD_OVERLAP = "predicted on a VC707", "predicted, two half-batches in flight"
PEERS = (ENVPOOL, SYNC, "Gymnasium AsyncVectorEnv", "Gymnasium's own vectorisation", "MinAtar")
PART = PARTS[paper_builds.BOARD]


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Time every environment at every size; predict the board; add the paper's figures."""
    environments = [WHOLE_ENV, "CartPole"] if quick else names()
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
    """Time the contenders of ``pearl bench steps`` at one size, or ``only`` those of some names.

    Those are left out of which ``known`` has a row at their size: peers of pure Python are timed with fewer
    slots than asked for.
    """
    everything = spec.name == WHOLE_ENV and n == SIZES[-1]
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
        return spec.name == WHOLE_ENV and n == QUICK_SIZES[0]
    return spec.name == WHOLE_ENV or n <= LARGE_SIMULATION


def _row(spec: EnvSpec, contender: Contender) -> Row:
    common = {
        "environment": spec.name,
        "contender": contender.name,
        "ours": contender.ours,
        "n_envs": contender.n,
    }
    if contender.unavailable is not None:
        return row_of("missing", contender.unavailable, **common)
    return row_of(
        "simulated" if contender.name in SIMULATIONS else "measured",
        contender.counts,
        **common,
        steps_per_second=contender.rate,
        microseconds_per_step=contender.seconds_per_step * 1e6,
    )


def predicted(spec: EnvSpec, n: int) -> list[Row]:
    """Predict the build that ``pearl plan`` chooses for the paper's board: T1 to T7, and two half-batches.

    And the paper's form without pipeline behind the same link: states go to it and come back with every step.
    """
    try:
        plans = plan(spec, n, pipeline.LINK, pipeline.CLOCK, PART)
    except ArgumentError as error:  # so many slots do not fit the part
        return [row_of("missing", str(error), environment=spec.name, contender=BOARD, ours=True, n_envs=n)]
    chosen = plans.chosen.prediction
    behind = f"{chosen.data_wl}-bit words, {pipeline.CLOCK / 1e6:g} MHz, {pipeline.LINK.name}"
    build = f"{chosen.pe_num} PEs, {behind}"
    rows = [_predicted(spec, BOARD, n, chosen, f"{build}; T1 and T7 measured here")]
    if plans.overlap is not None:
        counts = f"{build}; two designs of half the slots, in turns"
        rows.append(_predicted(spec, BOARD_OVERLAP, n, plans.overlap, counts))
    serial = pipeline.predicted(spec, n, 1, chosen.data_wl, False, plans.host)
    counts = f"1 PE, {behind}; no overlap, states moved with every step; T1 and T7 measured here"
    return [*rows, _predicted(spec, BOARD_SERIAL, n, serial, counts)]


def _predicted(
    spec: EnvSpec, contender: str, n: int, step: Prediction | Overlap, counts: str, **more: Any
) -> Row:
    return row_of(
        "predicted",
        counts,
        environment=spec.name,
        contender=contender,
        ours=True,
        n_envs=n,
        steps_per_second=step.rate,
        microseconds_per_step=step.total * 1e6,
        **more,
    )


def simulated_without_pipeline(spec: EnvSpec, n: int) -> Contender:
    """Return the simulated design in the paper's form without pipeline: one slot after the other."""
    actions = random_actions(spec, np.random.default_rng(0), n)
    make = partial(simulated, spec, actions, partial(Rtl, pe_num=1, pipelined=False))
    counts = "the FPGA design with one PE and no overlap, under Verilator, by backdoor; one thread"
    return Contender(SIMULATED_SERIAL, counts, n, make, ours=True)


def compared(name: str) -> list[Row]:
    """Predict both forms in the processing elements and word of the paper, which compares them, too."""
    found = pipeline.compare(name)
    ours, fits = found.pipelined, found.fits
    size = f"{ours.data_wl}-bit words, as many slots as memory fits"
    form = "with pipeline" + (", does not fit" if fits.lacks else "")
    counts = f"{ours.pe_num} PEs, {size}; on a VC707: {fits.text} ({fits.source})"
    label = "predicted in the paper's sizes"
    return [
        _predicted(
            get_spec(name), f"{label}, {form}", ours.n_envs, ours, counts, over_no_pipeline=found.factor
        ),
        _predicted(get_spec(name), f"{label}, without", ours.n_envs, found.serial, f"1 PE, {size}"),
    ]


def _over(row: Row, rows: list[Row], rival: str) -> float | None:
    """Return how many times a rival's rate a row of ours has; the rival with as many slots, or its most."""
    if not row.get("ours") or row.get("steps_per_second") is None:
        return None
    others = having(select(rows, environment=row["environment"], contender=rival), "steps_per_second")
    rivals = [other for other in others if other["n_envs"] <= row["n_envs"]]
    best = max(rivals, key=lambda other: int(other["n_envs"]), default=None)
    return None if best is None else float(row["steps_per_second"] / best["steps_per_second"])


def _quoted() -> list[Row]:
    rows = [
        row_of(
            "quoted",
            paper.FRAMEWORKS_SOURCE,
            environment="CliffWalking",
            contender=f"the paper: {name}",
            steps_per_second=framework.steps_per_second,
        )
        for name, framework in paper.FRAMEWORKS.items()
    ]
    factors = [("over_vector_env", name, times) for name, times in paper.OVER_VECTOR_ENV.items()]
    ranges = {"over_envpool": paper.OVER_ENVPOOL, "over_no_pipeline": paper.OVER_NO_PIPELINE}
    for key, (least, most) in ranges.items():
        factors += [(key, "the least of five", least), (key, "the most of five", most)]
    board = "the paper: PEARL, their board"
    return rows + [
        row_of("quoted", paper.THROUGHPUT_SOURCE, environment=name, contender=board, **{key: times})
        for key, name, times in factors
    ]


STYLES = {
    KERNEL: (Colour.BLACK, "kernel only (no observations)"),
    BATCH: (Colour.BLUE, "step_batch, one thread"),
    SIMULATED: (Colour.SKY, "FPGA design, simulated"),
    BOARD: (Colour.GREEN, "FPGA design, predicted on a VC707"),
    SIMULATED_SERIAL: (Colour.PURPLE, "simulated, without pipeline"),
    BOARD_SERIAL: (Colour.PURPLE, "predicted, without pipeline"),
    ENVPOOL: (Colour.RED, "EnvPool, all cores"),
    SYNC: (Colour.ORANGE, "Gymnasium SyncVectorEnv"),
    "Gymnasium's own vectorisation": (Colour.PINK, "Gymnasium's NumPy form, or MinAtar"),
    "MinAtar": (Colour.PINK, "Gymnasium's NumPy form, or MinAtar"),
}
"""Colour and legend of a contender; a peer's line is thin."""


def draw(rows: list[Row]) -> Any:
    """Draw a panel an environment: steps per second over environments, both logarithmic."""
    environments = sorted({row["environment"] for row in having(rows, "n_envs")})
    figure, grid = panels(environments, 1.3, 2.6, sharex=True, sharey=True)
    timed = having(rows, "steps_per_second")
    handles: dict[str, Any] = {}
    for name, axes in grid.items():
        handles |= _draw_lines(axes, select(timed, environment=name))
        handles |= _draw_quoted(axes, select(timed, environment=name, kind="quoted"))
        axes.set_title(name, fontsize=10)
        axes.tick_params(axis="x", labelsize=7)
    tidy(*grid.values())
    first = grid[environments[0]]
    log_axis(first, "x", [row["n_envs"] for row in rows if row["contender"] == BATCH], ticks=True)
    log_axis(first, "y", [row["steps_per_second"] for row in timed])
    figure.supxlabel("environments (log scale)", fontsize=10)
    figure.supylabel("agent-steps per second (log scale)", fontsize=10)
    legend(figure, handles, 3)
    return figure


def _draw_lines(axes: Any, rows: list[Row]) -> dict[str, Any]:
    """Draw a line a contender of one environment; return them by their names in the legend."""
    handles: dict[str, Any] = {}
    for contender, (colour, label) in STYLES.items():
        mine = select(rows, contender=contender)
        points = sorted((row["n_envs"], row["steps_per_second"], row["kind"]) for row in mine)
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
        steps = row["steps_per_second"]
        handles["the paper's rates (quoted)"] = axes.axhline(steps, color="grey", linestyle=":", linewidth=1)
        axes.annotate(
            row["contender"].removeprefix("the paper: "),
            (0.02, steps),
            xycoords=("axes fraction", "data"),
            fontsize=6,
            color="dimgrey",
            va="bottom",
        )
    return handles
