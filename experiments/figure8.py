"""Figure 8: energy, where the machine can measure it; and how busy the FPGA design is, which is no energy."""

from __future__ import annotations

from typing import Any

from pearl_marl.benchmark.measure import UnavailableError
from pearl_marl.benchmark.steps import contenders
from pearl_marl.benchmark.tables import BATCH, ENVPOOL
from pearl_marl.envs import get_spec
from pearl_marl.spec import EnvSpec

from . import activity, energy, figure6, paper
from .section import (
    HATCHES,
    Colour,
    Progress,
    Row,
    bars,
    having,
    labelled,
    legend,
    row_of,
    select,
    subplots,
    tidy,
)

TITLE = "Figure 8: energy"
TEXT = (
    "Agent-steps per joule, where the machine's own counters can be read: of the whole processor (RAPL), or "
    "of the whole GPU (NVML), idle power included. The FPGA's share is not known without a board: toggles of "
    "the simulated design say how busy it is, and are never made into watts."
)
COLUMNS = {
    "environment": "environment",
    "contender": "contender",
    "n_envs": "environments",
    "steps_per_joule": "steps/J",
    "watts": "W",
    "power_growth": "W grow by",
    "over_envpool": "over EnvPool",
    "over_vector_env": "over VectorEnv",
    "toggles_per_step": "toggles a slot's step",
    "counts": "what is counted, or from where",
}

METERS: dict[type[energy.Meter], tuple[str, ...]] = {
    energy.Rapl: (BATCH, ENVPOOL, figure6.SYNC),
    energy.Nvml: ("step_batch, device='cuda'",),
}
"""Whose energy is counted by what."""
N_ENVS = 43008


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Measure what contenders take, where that is possible; count toggles; add the paper's figures."""
    environments = list(paper.ENERGY_OVER)
    rows = measured(environments[:1] if quick else environments, quick, progress)
    if not quick:  # a model each to compile
        rows += _activity(progress)
    rows += [
        row_of(
            "quoted",
            paper.ENERGY_SOURCE,
            environment=name,
            contender="the paper: PEARL, their board",
            over_envpool=over_envpool,
            over_vector_env=over_vector_env,
        )
        for name, (over_vector_env, over_envpool) in paper.ENERGY_OVER.items()
    ]
    small, large = paper.GROWTH_SIZES
    grown, quoted = f"the paper: {large:,} over {small:,} environments", {"environment": "CliffWalking"}
    growth = paper.GROWTH["power"]
    rows.append(row_of("quoted", paper.GROWTH_SOURCE, **quoted, contender=grown, power_growth=growth))
    for name, framework in paper.FRAMEWORKS.items():
        found = {"contender": f"the paper: {name}", "steps_per_joule": framework.steps_per_joule}
        rows.append(row_of("quoted", paper.FRAMEWORKS_SOURCE, **quoted, **found))
    return rows


def measured(environments: list[str], quick: bool, progress: Progress) -> list[Row]:
    """Return steps per joule and watts of all whose energy the machine counts; where it does not, why."""
    rows: list[Row] = []
    for meter_class, names in METERS.items():
        try:
            meter = meter_class()
        except energy.UnmeasuredError as error:
            common = {"environment": "all", "contender": ", ".join(names), "platform": meter_class.platform}
            rows.append(row_of("missing", f"not measured here: {error}", **common))
            continue
        for name in progress(environments, len(environments), "energy"):
            rows += _measured(get_spec(name), meter, names, quick)
    return rows


def _measured(spec: EnvSpec, meter: energy.Meter, names: tuple[str, ...], quick: bool) -> list[Row]:
    """Return the rows of the contenders named, each stepped for some seconds."""
    n, seconds = (1024, 0.1) if quick else (N_ENVS, 5.0)
    rows: list[Row] = []
    for contender in contenders(spec, n):
        if contender.name not in names:
            continue
        common: Row = {
            "environment": spec.name,
            "contender": contender.name,
            "platform": meter.platform,
            "n_envs": contender.n,
        }
        try:
            step = contender.make()
        except UnavailableError as error:
            rows.append(row_of("missing", str(error), **common))
            continue
        step()
        contender.wait()
        spent = energy.spend(meter, step, contender.wait, seconds)
        if not spent.joules:  # some virtual machines have counters that stand still
            rows.append(row_of("missing", f"not measured here: {meter.counts} counts nothing", **common))
            continue
        counts = f"{meter.counts} for {seconds:g} s; {contender.counts}"
        rate, watts = spent.steps * contender.n / spent.joules, spent.joules / spent.seconds
        rows.append(row_of("measured", counts, **common, steps_per_joule=rate, watts=watts))
    found = select(rows, kind="measured")
    rates = {row["contender"]: row["steps_per_joule"] for row in found}
    for row in found:
        if row["contender"] == BATCH:
            for key, peer in (("over_envpool", ENVPOOL), ("over_vector_env", figure6.SYNC)):
                row[key] = row["steps_per_joule"] / rates[peer] if peer in rates else None
    return rows


def _activity(progress: Progress) -> list[Row]:
    sizes = activity.CONFIGURATIONS
    return [
        row_of(
            "simulated",
            f"changes of {found.registers:,} register bits, a slot's share over AXI; no energy",
            environment=found.environment,
            contender=f"FPGA design, {found.pe_num} PEs, {found.data_wl}-bit words",
            n_envs=found.n_envs,
            toggles_per_step=found.toggles_per_slot,
        )
        for found in (activity.measure(*size) for size in progress(sizes, len(sizes), "toggles"))
    ]


def draw(rows: list[Row]) -> Any:
    """Draw how many more steps a joule makes than a peer's, quoted and where measured; and toggles."""
    figure, (*both, right) = subplots(1, 3, 3.6)
    environments = list(paper.ENERGY_OVER)
    measured = select(rows, kind="measured", contender=BATCH)
    width, shift = (0.38, 0.19) if measured else (0.6, 0.0)
    for axes, key, peer in zip(
        both, ("over_envpool", "over_vector_env"), ("EnvPool", "VectorEnv"), strict=True
    ):
        for place, kind, shade, label, chosen in (
            (-shift, "quoted", Colour.ORANGE, "the paper's board (quoted)", select(rows, kind="quoted")),
            (shift, "measured", Colour.BLUE, "step_batch (measured)", measured),
        ):
            points = having(chosen, key)
            if not points:
                continue
            x = [environments.index(row["environment"]) + place for row in points]
            y = [row[key] for row in points]
            drawn = axes.bar(x, y, width, color=shade, edgecolor="white", hatch=HATCHES[kind], label=label)
            axes.bar_label(drawn, fmt="{:,.0f}", fontsize=7)
        axes.set_xticks(range(len(environments)), environments, rotation=40, ha="right", fontsize=8)
        axes.set(title=f"steps a joule, over {peer}", yscale="log", ylim=(1, 20_000))
    both[0].set_ylabel("times as many (log scale)")
    if not measured:
        both[0].set_title("steps a joule, over EnvPool\n(ours: not measured here)")
    toggles = select(rows, kind="simulated")
    places = range(len(toggles))
    values, label = [row["toggles_per_step"] for row in toggles], "this design's registers (simulated)"
    bars(right, places, values, 0.8, color=Colour.GREEN, hatch=HATCHES["simulated"], label=label)
    right.set_yticks(
        places, [f"{row['environment']}\n{row['n_envs']:,} slots" for row in toggles], fontsize=7
    )
    right.invert_yaxis()
    right.set(title="activity, which is no energy", xlabel="toggles a slot's step (log scale)", xscale="log")
    right.set_xlim(10, 100_000)
    for axes in (*both, right):
        axes.title.set_fontsize(10)
    tidy(*both, right, grid=False)
    legend(figure, {**labelled(both[0]), **labelled(right)}, 3, "lower")
    return figure
