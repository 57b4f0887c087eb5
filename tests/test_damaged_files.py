"""Damaged and crafted files of every kind that is read: each is refused in one sentence, or read right.

Memory is bounded, and nothing is imported: ``tests/damage`` has the kinds, and does a case again by
``python -m tests.damage FOLDER 1 KIND NUMBER``.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("count", [150, pytest.param(5000, marks=pytest.mark.exhaustive)])
def test_damaged_files(count: int, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.damage", tmp_path, str(count)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=3000, check=False)
    at = (tmp_path / "at").read_text() if (tmp_path / "at").exists() else "the beginning"
    assert done.returncode == 0, f"ended with {done.returncode} at {at}:\n{done.stderr[-4000:]}"
    found = json.loads(done.stdout.splitlines()[-1])
    assert not found["failures"], "\n".join(found["failures"])
    outcomes = found["outcomes"]
    assert sum(sum(each.values()) for each in outcomes.values()) > 0.95 * count
    assert all(each.get("refused", 0) for name, each in outcomes.items() if name != "Locks"), outcomes
