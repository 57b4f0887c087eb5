"""How often registers of the simulated hardware change in a step: an activity, and no measure of power.

Counted are the bits of all registers (flip-flops) of the design that change at a clock edge: pipeline,
packers, counters, the AXI port and the output registers of the memories. Not counted are the clock, the
reset, the cells of memories, and everything combinational. So figures compare builds of this design with
each other, and nothing else: what a toggle costs depends on the wires behind it.

A step is all of its clock cycles over the AXI port: the write of its random actions, itself, and the read of
its results. Cycles in which a board waits for its host are not in it.

``python experiments/activity.py`` prints the table of docs/simulation.md. It compiles a model for each row.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from pearl_marl.batch.actions import random_actions
from pearl_marl.benchmark.tables import MeasuredTable
from pearl_marl.devices import BatchConfig, Rtl
from pearl_marl.envs import get_spec
from pearl_marl.experiments.calling import call

CONFIGURATIONS = (
    ("CliffWalking", 64, 4, 32),
    ("CliffWalking", 256, 4, 32),
    ("CliffWalking", 1024, 4, 32),
    ("FrozenLake", 64, 4, 32),
    ("Blackjack", 64, 4, 32),
    ("CartPole", 64, 2, 32),
)
"""Environment, slots, processing elements, bits of a word."""

STEPS, WARM_UP = 10, 3

# simulation.cpp writes what an edge changed at this time, in the waveform's units.
_PERIOD, _FIRST = 10, 10


@dataclass(frozen=True, slots=True)
class Activity:
    """What was counted of a build, as means of :data:`STEPS` steps."""

    environment: str
    n_envs: int
    pe_num: int
    data_wl: int
    registers: int
    """Bits of registers in the simulated design; some of them never change."""
    cycles: float
    """Clock cycles of a step over AXI."""
    toggles: float
    """Changes of these bits in a step of all slots."""

    @property
    def toggles_per_slot(self) -> float:
        """Of a step of one slot."""
        return self.toggles / self.n_envs


def measure(env_id: str, n_envs: int, pe_num: int, data_wl: int) -> Activity:
    """Simulate a build and count: with random actions of one seed, so the figures are the same every time."""
    spec, rng = get_spec(env_id), np.random.default_rng(0)
    with tempfile.TemporaryDirectory(prefix="pearl_activity_") as folder:
        waves = Path(folder) / "waves.vcd"
        device = Rtl(pe_num, data_wl, path="axi", trace=waves).open(BatchConfig(spec=spec, n_envs=n_envs))
        device.reset(seed=0)
        began = 0
        for step in range(WARM_UP + STEPS):
            if step == WARM_UP:
                began = device.clock
            device.step(random_actions(spec, rng, n_envs))
        cycles = device.clock - began
        device.close()
        registers, toggles = _count(waves, _FIRST + _PERIOD * began)
    return Activity(env_id, n_envs, pe_num, data_wl, registers, cycles / STEPS, toggles / STEPS)


def _count(waves: Path, after: int) -> tuple[int, int]:
    """Return the bits of all registers in a waveform file, and their changes after a time.

    A register is what is named ``_q``, in a generated core with a stage's number after it.
    """
    with waves.open() as file:
        widths = dict(_registers(file))
        now = dict.fromkeys(widths, 0)
        time = toggles = 0
        for line in file:
            if line[0] == "#":
                time = int(line[1:])
                continue
            bits, _, code = line[1:-1].partition(" ") if line[0] == "b" else (line[0], "", line[1:-1])
            if code in now:
                value = int(bits, 2)
                if time > after:
                    toggles += (value ^ now[code]).bit_count()
                now[code] = value
    return sum(widths.values()), toggles


def _registers(header: Iterator[str]) -> Iterator[tuple[str, int]]:
    """Yield code and width of every register that the header of a waveform file declares."""
    for line in header:
        match line.split():
            case ["$var", _, width, code, name, *_]:
                if re.fullmatch(r"\w+_q\d*(_\d+)?", name.partition("[")[0]):
                    yield code, int(width)
            case ["$enddefinitions", *_]:
                return


def main() -> None:
    """Count every configuration, and print a table in Markdown."""
    rows = []
    for size in track(CONFIGURATIONS, "count", console=Console(stderr=True)):
        found = measure(*size)
        counts = f"{found.registers:,}", f"{found.cycles:,.0f}", f"{found.toggles:,.0f}"
        build = found.environment, f"{found.n_envs:,}", f"{found.pe_num}", f"{found.data_wl}"
        rows.append((*build, *counts, f"{found.toggles_per_slot:,.1f}"))
    build, counts = ("environment", "slots", "PEs", "word"), ("register bits", "cycles", "toggles a step")
    print(MeasuredTable((*build, *counts, "a slot"), rows).markdown())


if __name__ == "__main__":
    call(main)
