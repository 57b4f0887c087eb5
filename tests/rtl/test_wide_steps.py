"""Wide and signed words, tables and divisions: cores and their netlists do what golden functions do.

A netlist is what Yosys makes of a core's text by the rules of the language, down to gates; only multipliers
stay whole. Verilator alone cannot tell: it gives bits that the language leaves unknown the values that happen
to be right.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from cases import random_cases
from gates import Netlist, netlists
from harness import Design, Variant, run_variants
from linters import slang
from test_cores import TARGETS as EVERY
from wide_steps import FIXED, wide_spec

from pearl_marl.compiler.cores import generated_core
from pearl_marl.compiler.targets import Target

TARGETS = [Target("xc7", 187.5), *EVERY]


def cores(numbers: range, folder: Path) -> list[Variant]:
    """Return the core of each environment."""
    variants = []
    for number in numbers:
        target = TARGETS[number % len(TARGETS)]
        found = generated_core(wide_spec(number), target, f"wide_{number}")
        path = folder / f"wide_{number}_pe.sv"
        path.write_text(found.text)
        slang(path.stem, [path])
        case = {"env": "Wide", "options": {"number": number}, "latency": found.latency, "ii": 1, "limit": 150}
        variants.append(Variant(f"{number} for {target}", Design(path.stem, (path,)), case))
    return variants


@pytest.mark.exhaustive  # Yosys is WebAssembly, which takes a minute to compile before it first runs
@pytest.mark.parametrize(
    "numbers",
    [
        range(len(FIXED) + 4),
        *(range(k, k + 64) for k in range(16, 720, 64)),
    ],
    ids=str,
)
def test_cores_and_netlists(numbers: range, tmp_path: Path) -> None:
    variants, wrong = cores(numbers, tmp_path), []
    found = netlists([variant.design.sources[0] for variant in variants], tmp_path)
    for number, variant, path in zip(numbers, variants, found, strict=True):
        inputs, due = random_cases(wide_spec(number), 400)
        hold = inputs["hold_i"]
        count, ready = (
            len(hold),
            {"valid_i": [1] * len(hold), "rst_ni": [1] * len(hold), "clk_i": [0] * len(hold)},
        )
        result = Netlist(path).run({**inputs, **ready}, variant.arguments["latency"])
        # The backbone masks reward and end of a slot that is held.
        for port, row in due.items():
            seen = [port in ("state_o", "obs_o") or not held for held in hold]
            if any(result[port][i] != row[i] for i in range(count) if seen[i]):
                wrong.append(f"{port} of {variant.name}")
    assert not wrong
    logs = run_variants(variants, "bench_core", tmp_path)
    assert not [v.name for v, log in zip(variants, logs, strict=True) if log], max(logs, key=len)
