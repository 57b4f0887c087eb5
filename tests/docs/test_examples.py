"""Every script of `examples/` runs, and every notebook prints what it shows."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from .notebooks import output, run

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_scripts_run(script: Path, tmp_path: Path) -> None:
    if "torch" in script.read_text():
        pytest.importorskip("torch")
    done = subprocess.run(
        [sys.executable, script], cwd=tmp_path, capture_output=True, text=True, timeout=1800
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert not list(tmp_path.iterdir()), "nothing is left behind"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_notebooks_print_what_they_show(path: Path, tmp_path: Path) -> None:
    """In a process of its own: notebooks register environments, and build hardware."""
    copy = tmp_path / path.name
    copy.write_bytes(path.read_bytes())
    runner = Path(__file__).with_name("notebooks.py")
    done = subprocess.run(
        [sys.executable, runner, copy], cwd=tmp_path, capture_output=True, text=True, timeout=1800
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(copy.read_text()) == json.loads(path.read_text()), f"python {runner} {path}"
    assert path.stat().st_size < 20_000


def test_a_notebook_is_run_cell_by_cell() -> None:
    cells: list[Any] = [
        {"cell_type": "code", "source": ["a = 1\n", "print(a)"]},
        {"cell_type": "markdown", "source": ["not Python"]},
        {"cell_type": "code", "source": ["a += 1"]},
        {"cell_type": "code", "source": ["print(a)"]},
    ]
    texts = [text for _, text in run({"cells": cells})]
    assert texts == ["1\n", "", "2\n"]
    assert [bool(output(text)) for text in texts] == [True, False, True]


def test_the_folder_lists_all_of_them() -> None:
    listed = re.findall(r"\]\(([^)/]+\.(?:py|ipynb))\)", (EXAMPLES / "README.md").read_text())
    assert sorted(listed) == [path.name for path in sorted([*SCRIPTS, *NOTEBOOKS])]
    assert os.path.getsize(EXAMPLES / "README.md") < 4000
