"""Policies of the trainers as files: the same bytes for the same weights, and damaged ones refused."""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.policies.loading import load_policy

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
trained = importlib.import_module("pearl_marl.policies.trained")
safetensors = importlib.import_module("safetensors.torch")

WRITE = """
import sys, torch
from pathlib import Path
from pearl_marl import get_spec
from pearl_marl.policies import trained
torch.manual_seed(0)
trained.NetworkPolicy(get_spec("CartPole"), "logits", 8).save(Path(sys.argv[1]))
"""


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    path = tmp_path / "policy.safetensors"
    trained.NetworkPolicy(get_spec("CartPole"), "logits", 8).save(path)
    return path


def test_equal_weights_are_equal_bytes(saved: Path, tmp_path: Path) -> None:
    """Of two processes with other hash seeds; the writer itself shuffles by chance, so of several here."""
    files = []
    for number in range(2):
        files.append(tmp_path / f"{number}.safetensors")
        environment = {**os.environ, "PYTHONHASHSEED": str(number + 1)}
        subprocess.run([sys.executable, "-c", WRITE, files[-1]], env=environment, check=True)
    policy = trained.load(saved)
    for number in range(8):
        files.append(tmp_path / f"again_{number}.safetensors")
        policy.save(files[-1])
    assert {file.read_bytes() for file in files} == {saved.read_bytes()}
    observations = np.random.default_rng(0).normal(size=(9, 4)).astype(np.float32)
    np.testing.assert_array_equal(trained.load(files[0]).choose(observations), policy.choose(observations))


def test_a_table_is_read_as_it_was_written(tmp_path: Path) -> None:
    table = trained.Table(get_spec("CliffWalking"), 3)
    table.values.normal_()
    table.save(tmp_path / "policy.safetensors")
    assert torch.equal(trained.load(tmp_path).values, table.values)


def rewritten(path: Path, about: Any = None, drop: str = "", **changes: Any) -> None:
    """Write the policy of a file again, with other tensors or metadata."""
    with trained.safe_open(path, "pt") as stored:
        header = stored.metadata()
        tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
    known = json.loads(header["policy"]) if about is None else about
    if isinstance(known, dict):
        known = {name: value for name, value in {**known, **changes}.items() if name != drop}
    header["policy"] = known if isinstance(known, str) else json.dumps(known)
    header.pop(drop, None)
    tensors.pop(drop, None)
    safetensors.save_file(tensors, path, header)


DAMAGED = {
    "no metadata of the policy": ({"drop": "policy"}, "says nothing of its policy"),
    "metadata that is no JSON": ({"about": "{"}, "says nothing of its policy"),
    "metadata of many brackets": ({"about": "[" * 100_000}, "says nothing of its policy"),
    "metadata that is no dict": ({"about": [1]}, "says nothing of its policy"),
    "no environment": ({"drop": "environment"}, "has no 'environment'"),
    "no options": ({"drop": "options"}, "has no 'options'"),
    "no kind": ({"drop": "kind"}, "has no 'kind'"),
    "no width": ({"drop": "width"}, "has no 'width'"),
    "another width": ({"width": 9}, "width 9"),
    "a width that nobody has": ({"width": 10**12}, "width 1000000000000"),
    "a word for a width": ({"width": "wide"}, "width 'wide'"),
    "another kind": ({"kind": "rule"}, "kind 'rule'"),
    "a list for a kind": ({"kind": []}, r"kind \[\]"),
    "a tensor too few": ({"drop": "network.output.bias"}, "network.output.bias"),
    "another environment's tensors": ({"environment": "Taxi", "options": {}}, "tensors"),
    "an environment that is not known": ({"environment": "Nowhere"}, "environment 'Nowhere'"),
    "a number for an environment": ({"environment": 3}, "3"),
    "an option that is not known": ({"options": {"wind": 1}}, "wind"),
    "options that are no dict": ({"options": [1]}, "options"),
}


@pytest.mark.parametrize(("changes", "says"), DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_policy_is_refused(changes: dict[str, Any], says: str, saved: Path) -> None:
    rewritten(saved, **changes)
    with pytest.raises(ArgumentError, match=rf"policy\.safetensors.*{says}") as caught:
        load_policy(str(saved), get_spec("CartPole"))
    assert "\n" not in str(caught.value)


def test_a_policy_that_diverged_is_refused(saved: Path) -> None:
    tensors = safetensors.load_file(saved)
    tensors["network.output.bias"][0] = np.nan
    with trained.safe_open(saved, "pt") as stored:
        header = stored.metadata()
    safetensors.save_file(tensors, saved, header)
    with pytest.raises(ArgumentError, match=r"network\.output\.bias has NaN among its numbers"):
        load_policy(str(saved), get_spec("CartPole"))


@pytest.mark.parametrize(
    "content",
    [b"", b"no", np.random.default_rng(0).bytes(500), b"\xff" * 500],
    ids=["empty", "short", "random", "ones"],
)
def test_what_is_no_policy_is_refused(content: bytes, saved: Path) -> None:
    saved.write_bytes(content)
    with pytest.raises(ArgumentError, match=re.escape("policy.safetensors cannot be read as a policy")):
        trained.load(saved.parent)
