"""Eq. 1 to 3: the latency model beside what was measured on the host, and counted in simulation."""

from __future__ import annotations

from typing import Any

import numpy as np

from pearl_marl.envs import get_spec, names
from pearl_marl.hardware.build import Build
from pearl_marl.latency import axi_cycles, draws_wait, loop_cycles, measure_host, step_cycles
from pearl_marl.memory_map import default_map, memory_map
from pearl_marl.spec import EnvSpec

from . import latency_model
from .section import HATCHES, LINES, Colour, Progress, Row, log_axis, row_of, select, subplots, tidy

TITLE = "Eq. 1 to 3: the latency model"
TEXT = (
    "Eq. 1: what the host takes to pack actions (T1) and to unpack results (T7), measured over the bytes, "
    "and the line alpha * k + beta through it. Eq. 2 and 3: clock cycles of all slots one after the other, "
    "and with a unit for each, beside this design's. And this design's own model beside the simulated "
    "hardware."
)
COLUMNS = {
    "what": "what",
    "environment": "environment",
    "n_envs": "environments",
    "pe_num": "PEs",
    "data_wl": "word",
    "bytes": "bytes",
    "microseconds": "us",
    "alpha": "alpha, s/GB",
    "beta": "beta, us",
    "cycles": "cycles",
    "counts": "what is counted",
}

SIZES = (1024, 4096, 16384, 43008)
HOST_ENVS = ("CliffWalking", "Blackjack", "CartPole", "Pendulum", "Seaquest")
LOOPS = ((43008, 256, 1024), (43008, 128, 1024), (43008, 64, 256))
"""Slots, processing elements and bits of a word of docs/latency.md's table."""
QUICK_BUILD = ("CliffWalking", 7, 4, 32, True)


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Measure the host, and simulate every configuration of ``latency_model``."""
    environments = HOST_ENVS[:1] if quick else HOST_ENVS
    rows: list[Row] = []
    for name in progress(environments, len(environments), "T1 and T7"):
        rows += _host(get_spec(name), quick)
    builds = [QUICK_BUILD] if quick else latency_model.BUILDS
    for build in progress(builds, len(builds), "clock cycles"):
        rows += _simulated(*build)
    for name in environments if quick else names():
        spec = get_spec(name)
        layouts = [memory_map(spec, *loop) for loop in LOOPS] if name == "CliffWalking" else []
        for layout in layouts or [default_map(spec, SIZES[-1])]:
            cycles = loop_cycles(spec, layout)
            size = {"n_envs": layout.n_envs, "pe_num": layout.pe_num, "data_wl": layout.data_wl}
            rows += [
                row_of("predicted", counts, what=what, environment=name, **size, cycles=count)
                for what, count, counts in (
                    ("Eq. 2", cycles.serial, "one unit, slot after slot"),
                    ("Eq. 3", cycles.parallel, "a unit for each slot, transfers one after the other"),
                    ("this design", cycles.ours, "reading, computing and writing at the same time"),
                )
            ]
    return rows


def _host(spec: EnvSpec, quick: bool) -> list[Row]:
    sizes = SIZES[:2] if quick else SIZES
    rows: list[Row] = []
    for n in sizes:
        times, layout = measure_host(spec, n, 20 if quick else 200), default_map(spec, n)
        for what, seconds, moved in (
            ("T1, pack", times.pack, layout.step_write[1]),
            ("T7, unpack", times.unpack, layout.step_read[1]),
        ):
            found = {"n_envs": n, "bytes": moved, "microseconds": seconds * 1e6}
            counts = "median processor time of one thread"
            rows.append(row_of("measured", counts, what=what, environment=spec.name, **found))
    for what in ("T1, pack", "T7, unpack"):
        points = select(rows, what=what)
        slope, constant = fitted([row["bytes"] for row in points], [row["microseconds"] for row in points])
        line = {"alpha": slope * 1e3, "beta": constant}
        counts = "Eq. 1, the line through the measurements (least squares of relative errors)"
        rows.append(row_of("predicted", counts, what=what, environment=spec.name, **line))
    return rows


def fitted(x: list[float], y: list[float]) -> tuple[float, float]:
    """Return slope and constant of the line whose relative errors are least; neither is negative.

    Absolute errors would be those of the largest sizes alone, whose arrays are in no cache any more.
    """
    matrix = np.stack([x, np.ones(len(x))], 1) / np.array(y)[:, None]
    lines = []
    for chosen in ([0, 1], [0], [1]):
        line = np.zeros(2)
        line[chosen] = np.linalg.lstsq(matrix[:, chosen], np.ones(len(x)))[0]
        if (line >= 0).all():
            lines.append(line)
    slope, constant = min(lines, key=lambda line: float(np.square(matrix @ line - 1).sum()))
    return float(slope), float(constant)


def _simulated(name: str, n: int, pe_num: int, data_wl: int, pipelined: bool) -> list[Row]:
    build = Build.of(get_spec(name), n, pe_num, data_wl)
    cycles, whole = latency_model.measure(build, pipelined)
    modelled = step_cycles(*build, pipelined) + draws_wait(*build), axi_cycles(*build, pipelined)
    size = {"environment": name, "n_envs": n, "pe_num": pe_num, "data_wl": data_wl}
    form = "" if pipelined else "; without pipeline"
    return [
        row_of(kind, f"{counts}{form}", what=what, **size, cycles=count)
        for what, counts, simulated, model in (
            ("a step", "doorbell to last result", cycles, modelled[0]),
            ("over AXI", "with every transfer over AXI", whole, modelled[1]),
        )
        for kind, count in (("simulated", simulated), ("predicted", model))
    ]


def draw(rows: list[Row]) -> Any:
    """Draw T1 and T7 over bytes with their lines, the model over simulated cycles, and the three loops."""
    figure, panels = subplots(1, 3, 4.1)
    _draw_host(panels[0], rows)
    _draw_model(panels[1], rows)
    _draw_loops(panels[2], rows)
    tidy(*panels, grid=False)
    for axes in panels:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), fontsize=7, frameon=False)
    return figure


def _draw_host(axes: Any, rows: list[Row]) -> None:
    measured = select(rows, kind="measured")
    for what, colour in (("T1, pack", Colour.BLUE), ("T7, unpack", Colour.ORANGE)):
        points = select(measured, what=what)
        moved, times = [row["bytes"] for row in points], [row["microseconds"] for row in points]
        axes.plot(
            moved, times, color=colour, linestyle="", marker="o", markersize=4, label=f"{what} (measured)"
        )
        for i, line in enumerate(select(rows, what=what, kind="predicted")):
            mine = [row["bytes"] for row in select(points, environment=line["environment"])]
            across = np.geomspace(min(mine), max(mine), 50)
            axes.plot(
                across,
                line["alpha"] * 1e-3 * across + line["beta"],
                color=colour,
                linewidth=1,
                linestyle=LINES["predicted"]["linestyle"],
                label=f"{what}, Eq. 1 (fitted)" if i == 0 else None,
            )
    log_axis(axes, "x", [row["bytes"] for row in measured])
    log_axis(axes, "y", [row["microseconds"] for row in measured])
    axes.set(title="Eq. 1: the host", xlabel="bytes a step (log scale)", ylabel="us (log scale)")


def _draw_model(axes: Any, rows: list[Row]) -> None:
    for what, colour in (("a step", Colour.GREEN), ("over AXI", Colour.RED)):
        simulated, predicted = (
            [row["cycles"] for row in select(rows, what=what, kind=kind)]
            for kind in ("simulated", "predicted")
        )
        style = {"linestyle": "", "marker": "s", "markersize": 5, "markerfacecolor": "none"}
        axes.plot(simulated, predicted, color=colour, label=what, **style)
    axes.axline((1, 1), (10, 10), color="black", linewidth=0.8, label="model = simulation")
    for which in ("x", "y"):
        log_axis(axes, which, [row["cycles"] for row in select(rows, kind="simulated")])
    axes.set(title="This design's model", xlabel="cycles, simulated (log scale)")
    axes.set_ylabel("cycles, predicted (log scale)")


def _draw_loops(axes: Any, rows: list[Row]) -> None:
    environments = list(dict.fromkeys(row["environment"] for row in select(rows, what="Eq. 2")))
    height = 0.27
    for i, (what, colour) in enumerate(
        (("Eq. 2", Colour.RED), ("Eq. 3", Colour.ORANGE), ("this design", Colour.BLUE))
    ):
        found = [select(rows, what=what, environment=name)[0]["cycles"] for name in environments]
        places = [y + (i - 1) * height for y in range(len(environments))]
        style = {"color": colour, "hatch": HATCHES["predicted"], "edgecolor": "white"}
        axes.barh(places, found, height, label=f"{what} (predicted)", **style)
    axes.set_yticks(range(len(environments)), environments, fontsize=8)
    axes.invert_yaxis()
    axes.set(
        title=f"Eq. 2 and 3, {SIZES[-1]:,} slots", xscale="log", xlabel="cycles of all slots (log scale)"
    )
