"""`pearl bench rollouts`: what it counts, and who takes part."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from pearl_marl import get_spec
from pearl_marl.benchmark import rollouts
from pearl_marl.policies import integer_file
from pearl_marl.policies.integer_network import table_network, unchanging_network

Pearl = Callable[..., tuple[int, str, str]]


def test_rollouts_beside_loops(pearl: Pearl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status, _, err = pearl(
        *("train", "CliffWalking", "--algo", "q-learning", "--n-agents", 8, "--iterations", 2),
        *("--out", tmp_path),
    )
    assert status == 0, err
    network = table_network(get_spec("CliffWalking"), np.tile([0, 1, 0, 0], (48, 1)))
    integer_file.save(network, tmp_path / integer_file.NAME)
    monkeypatch.setattr(rollouts, "STEPS", 5)
    monkeypatch.setattr(rollouts, "EVALUATED", 3)
    status, out, err = pearl(
        "bench", "rollouts", tmp_path, "--n-agents", 8, "--rounds", 1, "--seconds", 0, "--json"
    )
    assert status == 0, err
    rows = {row["name"]: row for row in json.loads(out)["contenders"]}
    counted = {name: row["n"] for name, row in rows.items() if not name.startswith("rollout,")}
    ours = {"rollout": 40, "policy, then step": 8, "pearl eval": 24}
    assert counted == ours | {"EnvPool, torch": 8, "gymnax, JAX": 40}
    assert all(row.get("steps_per_second", 1) > 0 for row in rows.values())
    assert all(row.get("steps_per_core_second", 1) > 0 for row in rows.values())


def test_a_loop_in_jax(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("gymnax")  # which `make test-peers` has
    monkeypatch.setattr(rollouts, "STEPS", 3)
    step = rollouts.gymnax_rollout(unchanging_network(get_spec("CartPole")), 4)
    step()
    step()
