"""What is known of every environment: the tables of docs/environment_figures.md.

``python -m experiments.environment_figures`` prints them, and ``make tables`` writes them there. What has to
be measured stands in ``facts.json`` in the environments' folders, and the rest follows from specs and
sources. Measurements come there by

- ``--rates FILE``, which ``pearl bench steps --all --json`` has printed;
- ``--verified FILE``, which ``pearl verify ENV --device rtl --json`` has printed;
- ``python -m experiments.core_sizes ENV --keep``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from pearl_marl.benchmark.tables import (
    BATCH,
    ENVPOOL,
    KERNEL,
    OTHER_PEERS,
    MeasuredTable,
    rate,
    times,
)
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.experiments.calling import call
from pearl_marl.hardware import elaboration
from pearl_marl.latency import step_cycles
from pearl_marl.latency.cycles import RESULTS
from pearl_marl.layout.fields import word_bits
from pearl_marl.memory_map import default_map
from pearl_marl.spec import snake_case

FOLDER = Path(__file__).resolve().parents[1] / "envs"
SLOTS = 43_008
FAMILIES = ("xc7", "ecp5")
CELLS = ("latency", "lut", "ff", "dsp")

SOFTWARE = (
    "environment | original | transitions compared | lines | bits | kernel | step_batch | best peer | x"
)
HARDWARE = (
    "environment | xc7: latency | LUT | FF | DSP | ecp5: latency | LUT | FF | DSP | "
    "pe_num | data_wl | bound | cycles | over bound + latency | verified"
)


def main(
    rates: Annotated[Path | None, typer.Option(help="Keep the rates of this result first.")] = None,
    verified: Annotated[list[Path] | None, typer.Option(help="Keep that this was verified first.")] = None,
) -> None:
    """Print both tables in Markdown."""
    if rates is not None:
        for result in _read(rates):
            keep_fact(result["environment"], "rates", _rates(result))
    for path in verified or ():
        result = _read(path)
        if not result["exact"] or result["device"] != "rtl":
            raise ArgumentError(f"{path} is not of a simulated device that agrees with its reference")
        worlds = result["n_agents"] // get_spec(result["environment"]).agents
        keep_fact(result["environment"], "verified", {"slots": worlds, "agent_steps": result["agent_steps"]})
    print(f"{software()}\n\n{hardware()}")


def software() -> str:
    """Return the first table and its heading, in Markdown."""
    rows = [[*_software(name)] for name in ours()]
    return f"## In software\n\n{MeasuredTable(SOFTWARE.split(' | '), rows, (0, 1, 2, 7)).markdown()}"


def hardware() -> str:
    """Return the second table and its heading, in Markdown; the compiler makes every core for it."""
    rows = [[*_hardware(name)] for name in ours()]
    return f"## In hardware\n\n{MeasuredTable(HARDWARE.split(' | '), rows).markdown()}"


def ours() -> list[str]:
    """Return the names of this package's environments, in alphabetical order."""
    return sorted(get_spec(path.parent.name).name for path in FOLDER.glob("*/spec.py"))


def facts(name: str) -> dict[str, Any]:
    """Return what stands in an environment's ``facts.json``."""
    known: dict[str, Any] = _read(_path(name))
    return known


def keep_fact(name: str, what: str, value: Any) -> None:
    """Write a fact into an environment's ``facts.json``."""
    known = facts(name) | {what: value}
    _path(name).write_text(f"{json.dumps(known, indent=4)}\n", "utf-8")


def _path(name: str) -> Path:
    path = FOLDER / snake_case(get_spec(name).name) / "facts.json"
    if not path.exists():
        raise ArgumentError(f"{name} has no facts: there is no {path}, as environments here have")
    return path


def _read(path: Path) -> Any:
    return json.loads(path.read_text("utf-8"))


def _rates(result: dict[str, Any]) -> dict[str, Any]:
    """Return our rates, and that of the fastest peer that was there."""
    found = {row["name"]: row["steps_per_second"] for row in result["contenders"] if "unavailable" not in row}
    peers = {name: found[name] for name in (ENVPOOL, *OTHER_PEERS) if name in found}
    best = max(peers, key=peers.__getitem__, default=None)
    return {
        "kernel": round(found[KERNEL]),
        "step_batch": round(found[BATCH]),
        "peer": best and OTHER_PEERS.get(best, "EnvPool"),
        "peer_rate": best and round(peers[best]),
    }


def _software(name: str) -> Iterator[str]:
    spec, known = get_spec(name), facts(name)
    folder = snake_case(spec.name)
    yield f"[{name}](../envs/{folder}/README.md#how-it-is-checked)"
    yield known["original"]
    yield known["transitions"]
    yield str(len((FOLDER / folder / "step.py").read_text("utf-8").splitlines()))
    yield str(word_bits(spec.state))
    yield from _speed(known["rates"])


def _speed(rates: dict[str, Any] | None) -> Iterable[str]:
    if rates is None:
        return ("-",) * 4
    ours = rate(rates["kernel"]), rate(rates["step_batch"])
    if rates["peer"] is None:
        return *ours, "-", "-"
    return (
        *ours,
        f"{rate(rates['peer_rate'])}, {rates['peer']}",
        times(rates["step_batch"] / rates["peer_rate"]),
    )


def _hardware(name: str) -> Iterator[str]:
    spec, known = get_spec(name), facts(name)
    layout, timing = default_map(spec, SLOTS), elaboration.core_timing(spec)
    yield name
    for cells in map((known["core"] or {}).get, FAMILIES):
        yield from (f"{cells[cell]:,}" if cells else "-" for cell in CELLS)
    words = max(layout["actions"].words, *(layout[result].words for result in RESULTS))
    bound, cycles = max(layout.groups * timing.interval, words), step_cycles(spec, layout)
    yield from (f"{figure:,}" for figure in (layout.pe_num, layout.data_wl, bound, cycles))
    yield f"+{100 * (cycles / (bound + timing.latency) - 1):.1f} %"
    yield "-" if known["verified"] is None else f"{known['verified']['agent_steps']:,}"


if __name__ == "__main__":
    call(main)
