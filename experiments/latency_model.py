"""The latency model beside the simulated hardware: clock cycles of a step, and of a step over AXI.

``python experiments/latency_model.py`` prints the table of docs/latency.md. It compiles a model for each
row, which takes some five minutes the first time.
"""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.progress import track

from pearl_marl.batch.actions import random_actions
from pearl_marl.benchmark.tables import MeasuredTable
from pearl_marl.devices import BatchConfig, Rtl
from pearl_marl.envs import get_spec
from pearl_marl.experiments.calling import call
from pearl_marl.hardware.build import Build
from pearl_marl.latency import axi_cycles, draws_wait, step_cycles

CONFIGURATIONS = (
    ("CliffWalking", 70, 3, 32),
    ("CliffWalking", 70, 4, 32),
    ("CliffWalking", 1000, 16, 64),
    ("CliffWalking", 1024, 16, 128),
    ("CliffWalking", 2000, 24, 64),
    ("CliffWalking", 4096, 8, 32),
    ("CliffWalking", 4096, 32, 256),
    ("CliffWalking", 4096, 32, 512),
    ("FrozenLake", 1024, 8, 64),
    ("Blackjack", 70, 3, 32),
    ("Blackjack", 512, 16, 128),
    ("CartPole", 70, 3, 512),
    ("CartPole", 128, 2, 32),
    ("CartPole", 256, 4, 128),
)
"""Environment, slots, processing elements, bits of a word."""

SERIAL = (
    ("CliffWalking", 70, 1, 32),
    ("CliffWalking", 70, 4, 32),
    ("Blackjack", 70, 1, 32),
    ("CartPole", 70, 1, 32),
)
"""The same of builds without pipeline."""

BUILDS = [(*size, True) for size in CONFIGURATIONS] + [(*size, False) for size in SERIAL]
"""All of them, and whether there is a pipeline."""

STEPS = 10


def main() -> None:
    """Measure every configuration, and print a table in Markdown."""
    rows = []
    worst = 0.0
    for env_id, n, pe_num, data_wl, pipelined in track(BUILDS, "measure", console=Console(stderr=True)):
        build = Build.of(get_spec(env_id), n, pe_num, data_wl)
        cycles, whole = measure(build, pipelined)
        predicted = axi_cycles(*build, pipelined)
        error = predicted / whole - 1
        worst = max(worst, abs(error))
        step = step_cycles(*build, pipelined) + draws_wait(*build)
        figures = (n, pe_num, data_wl, cycles, step, whole, predicted)
        form = "" if pipelined else ", serial"
        rows.append((f"{env_id}{form}", *(f"{figure:,}" for figure in figures), f"{error:+.1%}"))
    headings = "environment", "slots", "PEs", "word", "a step", "model", "over AXI", "model", "off by"
    print(MeasuredTable(headings, rows).markdown())
    print(f"\nThe largest error is {worst:.1%}.")


def measure(build: Build, pipelined: bool = True) -> tuple[int, int]:
    """Return the clock cycles of a step by the hardware's own count, and those of the whole step over AXI."""
    (spec, layout), rng = build, np.random.default_rng(0)
    n = layout.n_envs
    device = Rtl(layout.pe_num, layout.data_wl, path="axi", pipelined=pipelined)
    device.open(BatchConfig(spec=spec, n_envs=n))
    device.reset(seed=0)
    device.step(random_actions(spec, rng, n))  # which also writes the settings
    began = device.clock
    for _ in range(STEPS):
        device.step(random_actions(spec, rng, n))
    whole, rest = divmod(device.clock - began, STEPS)
    assert not rest, "every step takes as long"
    device.close()
    return device.cycles, whole


if __name__ == "__main__":
    call(main)
