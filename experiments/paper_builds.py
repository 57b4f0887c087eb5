"""The builds of the paper's Table II, and what they take of the part on its board by our synthesis.

``python experiments/paper_builds.py`` synthesises them, which takes an hour of processor time, and writes
``paper_builds.json`` anew: what they take, with the date and the commit of the sources. By this file,
whatever shows a figure of such a build marks those that do not fit.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import track

from pearl_marl.base.files import replace_file
from pearl_marl.benchmark.paper import TABLE_2
from pearl_marl.benchmark.tables import MeasuredTable
from pearl_marl.envs import get_spec
from pearl_marl.experiments.calling import call
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.fitting import PARTS, modelled_bram36, modelled_dsp
from pearl_marl.hardware.synthesis import Family, Usage, synthesise
from pearl_marl.memory_map import memory_map

BOARD = "vc707"
"""The paper's."""

MOST, STEP = 43_008, 1024
SIZES, RESOURCES = ("n_envs", "pe_num", "data_wl"), ("lut", "ff", "bram36", "dsp")
FILE = Path(__file__).with_suffix(".json")


def build(env_id: str, n_envs: int | None = None) -> Build:
    """Return a build in the paper's sizes.

    By default it has as many slots, in steps of 1,024 up to 43,008, as the part has block RAM for.
    """
    spec, sizes = get_spec(env_id), TABLE_2[env_id]

    def fits(n: int) -> bool:
        return modelled_bram36(memory_map(spec, n, sizes.pe_num, sizes.data_wl)) <= PARTS[BOARD].bram36

    n = n_envs or next(n for n in range(MOST, 0, -STEP) if fits(n))
    return Build.of(spec, n, sizes.pe_num, sizes.data_wl)


class Verdict(NamedTuple):
    """Whether a build fits the part, and how that is known."""

    lacks: str
    """What it needs more of than the part has, such as ``"6,662 of 2,800 DSP"``; empty if that is nothing."""
    text: str
    source: str


def verdict(build: Build) -> Verdict:
    """Return whether a build fits: by the file, or if that does not have it by memories and multipliers."""
    spec, layout = build
    found = json.loads(FILE.read_text("utf-8")).get(spec.name)
    if found is not None and all(found[size] == getattr(layout, size) for size in SIZES):
        lacks, unless = _lacks(found), "fits"
        source = f"synthesised {found['date']} at {found['commit']}"
    else:
        dsp = modelled_dsp(spec, Family.XC7.target)(layout.pe_num)
        lacks, unless = (
            _lacks({"bram36": modelled_bram36(layout), "dsp": dsp}),
            "memories and multipliers fit",
        )
        source = "not synthesised"
    return Verdict(lacks, f"does not fit: {lacks}" if lacks else unless, source)


def _lacks(needs: Mapping[str, float]) -> str:
    part = PARTS[BOARD]
    both = [(needs[name], getattr(part, name), name.upper()) for name in RESOURCES if name in needs]
    return ", ".join(f"{need:,} of {has:,} {name}" for need, has, name in both if need > has)


def _measured(usage: Usage) -> dict[str, Any]:
    """Return what the file says of a build: what it takes, made by which tools, when, of which sources."""
    command = ["git", "-C", str(FILE.parent), "describe", "--always", "--dirty"]
    commit = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
    return {
        **{name: getattr(usage, name) for name in SIZES + RESOURCES},
        "tools": ", ".join(f"{tool} {version}" for tool, version in usage.tools.items()),
        "date": datetime.now(UTC).date().isoformat(),
        "commit": commit,
    }


def main() -> None:
    """Synthesise all builds, write each into the file once it is done, and print a table in Markdown."""
    known = json.loads(FILE.read_text("utf-8"))
    for name in track(TABLE_2, "synthesise", console=Console(stderr=True)):
        known[name] = _measured(synthesise(build(name)))
        replace_file(FILE, f"{json.dumps(known, indent=2)}\n".encode())
    rows = [
        (name, *(f"{known[name][key]:,}" for key in SIZES + RESOURCES), verdict(build(name)).text)
        for name in TABLE_2
    ]
    headings = "environment", "slots", "PEs", "word", "LUT", "FF", "BRAM36", "DSP", "on a VC707"
    print(MeasuredTable(headings, rows, text=(0, 8)).markdown())


if __name__ == "__main__":
    call(main)
