"""``pearl run --actions``: the shapes that it takes, and those that it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Pearl = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize(
    ("env", "actions"),
    [
        ("CliffWalking", np.zeros((3, 5), np.uint8)),
        ("CliffWalking", np.zeros((4, 5), np.int64)),
        ("Pendulum", np.full((3, 5, 1), 0.5, np.float32)),
    ],
)
def test_given_actions(pearl: Pearl, env: str, actions: Any, tmp_path: Path) -> None:
    np.save(tmp_path / "actions.npy", actions)
    arguments = ("--n-agents", 5, "--steps", 3, "--actions", tmp_path / "actions.npy", "--json")
    status, out, err = pearl("run", env, *arguments)
    assert status == 0, err
    assert json.loads(out)["agent_steps"] == 15


@pytest.mark.parametrize(
    ("env", "shape", "needed"),
    [
        ("CliffWalking", (3, 5, 1), "(3, 5)"),
        ("CliffWalking", (2, 5), "(3, 5)"),
        ("CliffWalking", (5,), "(3, 5)"),
        ("CliffWalking", (), "(3, 5)"),
        ("Pendulum", (3, 5), "(3, 5, 1)"),
        ("Pendulum", (3, 5, 2), "(3, 5, 1)"),
        ("Pendulum", (3, 4, 1), "(3, 5, 1)"),
    ],
)
def test_other_shapes_are_refused(
    pearl: Pearl, env: str, shape: tuple[int, ...], needed: str, tmp_path: Path
) -> None:
    np.save(tmp_path / "actions.npy", np.zeros(shape, np.float32 if env == "Pendulum" else np.uint8))
    arguments = ("--n-agents", 5, "--steps", 3, "--actions", tmp_path / "actions.npy")
    status, out, err = pearl("run", env, *arguments)
    assert (status, out) == (2, "")
    assert f"has the shape {shape}; 3 steps of 5 agents need {needed}" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("content", [b"", b"no", b"\x93NUMPY" + bytes(50)])
def test_files_that_hold_no_array_are_refused(pearl: Pearl, content: bytes, tmp_path: Path) -> None:
    (tmp_path / "actions.npy").write_bytes(content)
    status, _, err = pearl("run", "CliffWalking", "--n-agents", 5, "--actions", tmp_path / "actions.npy")
    assert status == 2
    assert len(err.splitlines()) == 1
    assert "no readable .npy file" in err
