"""``pearl synth``: what a design costs on an FPGA, how that grows, and how many slots fit."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from pearl_marl.checks import checked_choice
from pearl_marl.cli import common
from pearl_marl.cli.common import console, error_console
from pearl_marl.envs import get_spec, names
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.engines import with_engine
from pearl_marl.hardware.fitting import PARTS, Fit, confirm, largest_fit
from pearl_marl.hardware.synthesis import PLACEMENTS, Family, Usage, synthesise
from pearl_marl.memory_map import default_map
from pearl_marl.spec import EnvSpec

CAVEATS = {
    Family.XC7: " That of a 7-series part is another and needs the vendor's tools.",
    Family.GOWIN: " Its authors found rates for Gowin's parts some 20 % above those of the vendor's tools.",
}
"""What a clock rate is worth, by the family that was asked for."""


def command(
    env_id: Annotated[
        str | None, typer.Argument(metavar="[ENV]", help="An environment of `pearl envs`.")
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Synthesise every environment, at the first size.")
    ] = False,
    n_envs: Annotated[
        list[str],
        typer.Option(
            metavar="N[,N...]",
            help="Number of slots (worlds) of the design; several give a table of how it grows.",
        ),
    ] = ["1024"],  # noqa: B006 - Typer copies it
    pe_num: Annotated[
        int | None,
        typer.Option(help="Number of processing elements; by default as many as the words can feed."),
    ] = None,
    data_wl: Annotated[
        int | None,
        typer.Option(help="Bits of a word; by default wide enough to carry one group of slots per cycle."),
    ] = None,
    part: Annotated[Family, typer.Option(help="The family of FPGA to synthesise for.")] = Family.XC7,
    policy: common.EnginePolicy = None,
    option: common.Options = None,
    fmax: Annotated[
        bool,
        typer.Option(
            "--fmax",
            help="Also place and route each size, to find its clock rate; designs for xc7 are placed on an "
            "ECP5.",
        ),
    ] = False,
    fit: Annotated[
        str | None,
        typer.Option(metavar="|".join(PARTS), help="Find the largest --n-envs whose memories fit this part."),
    ] = None,
    confirmed: Annotated[
        bool,
        typer.Option(
            "--confirm", help="Synthesise the size that --fit predicts; takes minutes for a large part."
        ),
    ] = False,
    out: common.Out = None,
    as_json: common.AsJson = False,
) -> None:
    """Synthesise a design with Yosys: LUT, FF, block RAM, DSP.

    The exit status is 1 if a large memory did not become block RAM.
    """
    if every:
        if env_id is not None or option or policy or fmax or fit is not None or confirmed:
            raise ArgumentError(
                "--all takes every environment as it is: leave out ENV, --option, --policy, --fmax, "
                "--fit, --confirm"
            )
        _every(_numbers(n_envs)[0], pe_num, data_wl, part, out, as_json)
        return
    if env_id is None:
        raise ArgumentError("name an environment of `pearl envs`, or give --all")
    spec = common.spec_of(env_id, option)
    sizes = _numbers(n_envs)
    # One design grows: what is chosen for the fewest slots holds for all.
    chosen = default_map(spec, sizes[0], pe_num, data_wl)
    name = f"synth_{spec.name}_{part}_{chosen.pe_num}_{chosen.data_wl}.json"
    common.check_results(out, name)
    taken = common.device_policy(policy, spec)
    builds = [with_engine(Build.of(spec, n, chosen.pe_num, chosen.data_wl), taken) for n in sizes]
    _check_fit(fit, part, confirmed)
    work = [(build, part, False) for build in builds]
    # There are no free tools that place a design on a 7-series part.
    other = part if part in PLACEMENTS else Family.ECP5
    if fmax:
        work += [(build, other, True) for build in builds]
    bar = common.progress(work, len(work), f"{spec.name}, {chosen.pe_num} PEs")
    usages = [synthesise(build, family, fmax=placed) for build, family, placed in bar]
    points, rates = usages[: len(builds)], usages[len(builds) :]
    found = None if fit is None else largest_fit(spec, points, PARTS[fit])
    if found is not None and confirmed:
        for predicted in common.progress([found], 1, f"{spec.name}, {found.n_envs:,} slots on {fit}"):
            found = confirm(spec, predicted, chosen.pe_num, chosen.data_wl)

    result = {
        "environment": spec.id,
        "options": dict(spec.options),
        "family": str(part),
        "points": [usage.as_json() for usage in points],
        "growth": _growth(points),
        "fmax": [usage.as_json() for usage in rates],
        "fmax_device": PLACEMENTS[other].device if rates else None,
        "fit": None if found is None else found.as_json(),
    }
    if not common.delivered(result, as_json, out, name):
        _show(spec.id, part, points, other, rates, found)
    _exit_if_misplaced([(spec, usage) for usage in points])


def _check_fit(fit: str | None, part: Family, confirmed: bool) -> None:
    if fit is not None:
        checked_choice("--fit", fit, PARTS)
        if part is not Family.XC7:
            raise ArgumentError("--fit is for 7-series parts: leave --part at xc7")
    if confirmed and fit is None:
        raise ArgumentError("--confirm synthesises what --fit predicts: name a part with --fit")


def _exit_if_misplaced(usages: list[tuple[EnvSpec, Usage]]) -> None:
    """Name every large memory that did not become block RAM; exit with status 1 if there is one."""
    misplaced = [(spec, usage, memory) for spec, usage in usages for memory in usage.misplaced]
    for spec, usage, memory in misplaced:
        error_console.print(
            f"[bold red]Not block RAM:[/] at {usage.n_envs:,} slots of {spec.name} {memory.name} of "
            f"{memory.depth:,} words of {memory.width} bits became {memory.kind}.",
            soft_wrap=True,
        )
    if misplaced:
        sys.exit(1)


def _every(
    n_envs: int, pe_num: int | None, data_wl: int | None, part: Family, out: Path | None, as_json: bool
) -> None:
    file = f"synth_all_{part}_{n_envs}.json"
    common.check_results(out, file)
    builds = [Build.of(get_spec(name), n_envs, pe_num, data_wl) for name in names()]
    work = common.progress(builds, len(builds), f"{n_envs:,} slots")
    usages = [(build.spec, synthesise(build, part)) for build in work]
    result = [{"environment": spec.id, "family": str(part), **usage.as_json()} for spec, usage in usages]
    if not common.delivered(result, as_json, out, file):
        columns = ["PEs", "word", "LUT", "FF", "BRAM36", "DSP"]
        grid = common.table(f"{n_envs:,} slots, {part}", ["environment"], columns)
        for spec, usage in usages:
            figures = (f"{figure:,}" for figure in (usage.pe_num, usage.data_wl, usage.lut, usage.ff))
            grid.add_row(spec.name, *figures, f"{usage.bram36:g}", f"{usage.dsp}")
        console.print(grid)
    _exit_if_misplaced(usages)


def _numbers(texts: list[str]) -> list[int]:
    try:
        return sorted({int(number.replace("_", "")) for text in texts for number in text.split(",")})
    except ValueError:
        raise ArgumentError(f"--n-envs {','.join(texts)} is no list of numbers such as 1024,43008") from None


def _growth(points: list[Usage]) -> dict[str, float] | None:
    """Return how much more the largest point takes than the smallest."""
    if len(points) < 2:
        return None
    return {name: getattr(points[-1], name) / getattr(points[0], name) for name in ("lut", "ff")}


def _show(
    title: str, part: Family, points: list[Usage], other: Family, rates: list[Usage], fit: Fit | None
) -> None:
    first = points[0]
    sizes = f"{first.pe_num} PEs, {first.data_wl}-bit words, {part}"
    console.print(_table(f"{title}, {sizes}", points, f"Fmax ({other})", rates))
    tools = {**first.tools, **(rates[0].tools if rates else {})}
    console.print(
        "Synthesis, before placement; LUTs of memory and shift registers included. "
        + ", ".join(f"{name} {number}" for name, number in tools.items()),
        style="dim",
    )
    if rates:
        console.print(
            f"Fmax is nextpnr's estimate after routing for the {PLACEMENTS[other].device}, without pads."
            f"{CAVEATS.get(part, '')}",
            style="dim",
        )
    if fit is not None:
        console.print(_sentence(fit))


def _table(title: str, points: list[Usage], heading: str, rates: list[Usage]) -> Table:
    """Return a row a size, and below them how much more the largest takes than the smallest."""
    headings = ["slots", "LUT", "FF", "BRAM36", "DSP", "memories", "in BRAM"]
    grid = common.table(title, [], [*headings, *([heading] if rates else [])])
    for i, usage in enumerate(points):
        blocks = sum(memory.kind == "block RAM" for memory in usage.memories)
        figures = [f"{figure:,}" for figure in (usage.n_envs, usage.lut, usage.ff)]
        figures += [f"{usage.bram36:g}", f"{usage.dsp}", f"{len(usage.memories)}", f"{blocks}"]
        grid.add_row(*figures, *([f"{rates[i].fmax_mhz:.1f} MHz"] if rates else []))
    growth = _growth(points)
    if growth is not None:
        grid.add_section()
        grid.add_row("growth", f"x{growth['lut']:.2f}", f"x{growth['ff']:.2f}")
    return grid


def _sentence(fit: Fit) -> str:
    part = fit.part
    what = f"{fit.n_envs:,} slots, {fit.bram36:,.1f} of the {part.bram36:,} BRAM36 of the {part.name}"
    if fit.usage is not None:
        return (
            f"Largest that fits: {what}. Synthesised: {fit.usage.lut:,} of {part.lut:,} LUT, "
            f"{fit.usage.ff:,} of {part.ff:,} FF."
        )
    return (
        f"Largest that fits, predicted: {what}. The model of the memories' shapes is scaled by "
        f"{fit.calibration:.3f}, as synthesised at the largest size above; --confirm synthesises it."
    )
