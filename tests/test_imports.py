"""What ``import pearl_marl`` brings along, and what it does not."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

HEAVY = (
    "torch",
    "matplotlib",
    "pygame",
    "supersuit",
    "stable_baselines3",
    "tensorboard",
    "envpool",
    "numba.cuda",
    "ray",
    "torchrl",
    "tensordict",
    "benchmarl",
)

SCRIPT = """
import json, sys
from numba.core import event
with event.install_recorder("numba:compile") as compiled:
    import pearl_marl
print(json.dumps({"modules": list(sys.modules), "compiled": len(compiled.buffer), "envs": pearl_marl.envs()}))
"""


@pytest.fixture(scope="module")
def imported() -> Any:
    """What a fresh process sees after the import, from a folder that is not the project's."""
    output = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, cwd="/"
    )
    return json.loads(output.stdout)


@pytest.mark.parametrize("name", HEAVY)
def test_nothing_heavy(imported: Any, name: str) -> None:
    assert name not in imported["modules"]


def test_nothing_is_compiled(imported: Any) -> None:
    assert imported["compiled"] == 0


def test_environments_are_found(imported: Any) -> None:
    assert "CliffWalking" in imported["envs"]


def test_public_names() -> None:
    import pearl_marl

    for name in pearl_marl.__all__:
        assert hasattr(pearl_marl, name)
