"""The whole design over AXI, at small sizes."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench import spec_of
from harness import checked, run, whole

from pearl_marl.hardware.build import Build


@pytest.mark.parametrize(
    ("env", "options", "size", "idle", "steps"),
    [
        # Ratios of row to word: a whole number of rows to a word, of words to a row, neither; a last
        # group that is full, and one that is not; one group only; one slot only.
        pytest.param("CliffWalking", {}, (1, 1, 32), 0.0, 4, marks=pytest.mark.exhaustive),
        pytest.param("CliffWalking", {}, (7, 4, 32), 0.2, 8, marks=pytest.mark.exhaustive),
        pytest.param(
            "CliffWalking", {"is_slippery": True}, (60, 7, 32), 0.0, 6, marks=pytest.mark.exhaustive
        ),
        pytest.param(
            "CliffWalking", {"is_slippery": True}, (1024, 16, 128), 0.0, 3, marks=pytest.mark.exhaustive
        ),
        pytest.param("CliffWalking", {}, (193, 24, 32), 0.2, 4, marks=pytest.mark.exhaustive),
        pytest.param("CliffWalking", {}, (40, 16, 1024), 0.0, 4, marks=pytest.mark.exhaustive),
        pytest.param("ShiftAdd", {}, (23, 5, 64), 0.0, 3, marks=pytest.mark.exhaustive),
        pytest.param("ShiftAdd", {}, (90, 4, 32), 0.1, 4, marks=pytest.mark.exhaustive),
        ("Meadow", {}, (23, 5, 64), 0.1, 4),
    ],
    ids=lambda value: "-".join(map(str, value)) if isinstance(value, tuple) else None,
)
def test_top_equals_the_model(env, options, size, idle, steps, tmp_path: Path) -> None:
    spec = spec_of(env, options)
    design = checked(whole(Build.of(spec, *size)))
    run(design, "bench_top", tmp_path, env=env, options=options, size=size, idle=idle, steps=steps)
