"""What a policy engine adds to a build: it, the sums of a rollout, and what starts the steps.

``python experiments/engine_sizes.py`` prints the figures of docs/hardware.md ("Rollouts"): builds with an
engine less the same ones without, as Yosys synthesises them for the 7 series. It takes minutes.
"""

from __future__ import annotations

from pearl_marl.envs import get_spec
from pearl_marl.experiments.calling import call
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.synthesis import synthesise
from pearl_marl.memory_map import Engine

SLOTS = 1024
ENGINES = (
    ("CartPole", 4, Engine("network", products=8, side=16, rounds=4, hidden=32, layers=3)),
    ("CartPole", 4, Engine("network", products=8, side=32, rounds=4, hidden=32, layers=3)),
    ("CliffWalking", 64, Engine("table", table_rows=64, logit_bits=8)),
)
"""Environments, processing elements and engines."""


def main() -> None:
    """Print the table in Markdown, a row as soon as it is known."""
    columns = "lut", "ff", "bram36", "dsp"
    print("| environment | processing elements | engine | LUT | FF | BRAM36 | DSP |")
    print("| --- | --: | --- | --: | --: | --: | --: |")
    for name, pe_num, engine in ENGINES:
        without, whole = (
            synthesise(Build.of(get_spec(name), SLOTS, pe_num, 1024, used)) for used in (None, engine)
        )
        size = (
            f"{engine.products * engine.side} products"
            if engine.kind == "network"
            else f"{engine.table_rows} rows"
        )
        added = " | ".join(f"{getattr(whole, column) - getattr(without, column):,g}" for column in columns)
        print(f"| {name} | {pe_num} | {engine.kind}, {size} | {added} |", flush=True)


if __name__ == "__main__":
    call(main)
