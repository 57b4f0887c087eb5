"""Policies of the trainers as files: the same bytes for the same weights, and damaged ones refused."""

from __future__ import annotations

import importlib
import json
import os
import re
import resource
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
policy_file = importlib.import_module("pearl_marl.policies.policy_file")
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
    table = trained.TabularPolicy(get_spec("CliffWalking"), 3)
    table.values.normal_()
    table.save(tmp_path / "policy.safetensors")
    assert torch.equal(trained.load(tmp_path).values, table.values)


def written(path: Path, header: dict[str, str], tensors: dict[str, Any]) -> None:
    """Write a file with these metadata and the right checksum."""
    path.write_bytes(policy_file.sealed(safetensors.save(tensors, header)))


def parts(path: Path) -> tuple[dict[str, str], dict[str, Any]]:
    content = path.read_bytes()
    metadata = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])["__metadata__"]
    return metadata, safetensors.load(content)


def rewritten(path: Path, about: Any = None, drop: str = "", **changes: Any) -> None:
    """Write the policy of a file again, with other tensors or metadata."""
    header, tensors = parts(path)
    known = json.loads(header["policy"]) if about is None else about
    if isinstance(known, dict):
        known = {name: value for name, value in {**known, **changes}.items() if name != drop}
    header["policy"] = known if isinstance(known, str) else json.dumps(known)
    header.pop(drop, None)
    tensors.pop(drop, None)
    written(path, header, tensors)


DAMAGED = {
    "no metadata of the policy": ({"drop": "policy"}, "say nothing of its policy"),
    "metadata that is no JSON": ({"about": "{"}, "say nothing of its policy"),
    "metadata of many brackets": ({"about": "[" * 100_000}, "say nothing of its policy"),
    "metadata that is no dict": ({"about": [1]}, "say nothing of its policy"),
    "no environment": ({"drop": "environment"}, "has no 'environment'"),
    "no options": ({"drop": "options"}, "has no 'options'"),
    "no kind": ({"drop": "kind"}, "has no 'kind'"),
    "no width": ({"drop": "width"}, "has no 'width'"),
    "another width": ({"width": 9}, "width 9"),
    "a width that nobody has": ({"width": 10**12}, "width 1000000000000"),
    "a word for a width": ({"width": "wide"}, "width 'wide'"),
    "another kind": ({"kind": "rule"}, "kind 'rule'"),
    "a temperature below 0": ({"temperature": -1}, "temperature -1; it must be a number from 0"),
    "a temperature that no float holds": ({"temperature": 10**400}, "it must be a number from 0"),
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


def refused(path: Path, says: str) -> None:
    with pytest.raises(ArgumentError, match=says) as caught:
        load_policy(str(path), get_spec("CartPole"))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 800


def filled(name: str, value: float) -> Any:
    return lambda tensors: tensors[name].view(-1)[:1].fill_(value)


def replaced(name: str, tensor: Any) -> Any:
    return lambda tensors: tensors.__setitem__(name, tensor)


OUTPUT = "network.output.bias"
TENSORS = {
    "NaN": (filled(OUTPUT, np.nan), "output.bias has NaN or an infinity among its numbers"),
    "infinity": (filled(OUTPUT, -np.inf), "output.bias has NaN or an infinity among its numbers"),
    "a mean": (filled("network.encoder.mean", np.inf), "mean has NaN or an infinity"),
    "a variance": (filled("network.encoder.variance", -1), "variance has a number below 0"),
    "a count": (filled("network.encoder.count", -1), "count has a number below 0"),
    "a bound": (filled("bound", 2), "bound has other numbers than CartPole has"),
    "float64": (replaced(OUTPUT, torch.zeros(2, dtype=torch.float64)), "bias' is torch.float64 of shape"),
    "int32": (replaced(OUTPUT, torch.zeros(2, dtype=torch.int32)), "not torch.float32 of shape"),
    "bool": (replaced(OUTPUT, torch.zeros(2, dtype=torch.bool)), "not torch.float32 of shape"),
    "a shape": (replaced(OUTPUT, torch.zeros(10**6, 0, 4)), r"of shape \(1000000, 0, 4\), not"),
    "a hidden scalar": (replaced("network.hidden.weight", torch.zeros(())), r"width 8, and layers of \(\)"),
    "a tensor more": (replaced("more", torch.zeros(2)), "'more' is torch.float32 .* not nothing"),
    "a long name": (replaced("n" * 9999, torch.zeros(2)), "not nothing"),
}


@pytest.mark.parametrize(("change", "says"), TENSORS.values(), ids=TENSORS)
def test_tensors_that_no_training_leaves(change: Any, says: str, saved: Path) -> None:
    header, tensors = parts(saved)
    change(tensors)
    written(saved, header, tensors)
    refused(saved, says)


@pytest.mark.parametrize("shape", [(10**7, 0, 4), (10**9, 0), (0,), (0, 48, 4), (), (2**40, 2**20, 0)])
def test_a_table_of_any_shape_takes_no_memory(shape: tuple[int, ...], tmp_path: Path) -> None:
    """7.5 GiB, it was, for a shape that has no numbers."""
    path = tmp_path / "policy.safetensors"
    trained.TabularPolicy(get_spec("CliffWalking")).save(path)
    header, _ = parts(path)
    one = {"dtype": "F32", "shape": shape, "data_offsets": [0, 0 if 0 in shape else 4]}
    text = json.dumps({"__metadata__": header, "values": one}).encode()
    data = b"" if 0 in shape else bytes(4)
    path.write_bytes(policy_file.sealed(len(text).to_bytes(8, "little") + text + data))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ArgumentError, match="its tensors are not") as caught:
        load_policy(str(path), get_spec("CliffWalking"))
    assert "\n" not in str(caught.value)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


def test_every_flip_of_a_bit_is_noticed(saved: Path) -> None:
    content = saved.read_bytes()
    for at in np.random.default_rng(0).choice(8 * len(content), 300, replace=False):
        damaged = bytearray(content)
        damaged[at // 8] ^= 1 << at % 8
        saved.write_bytes(damaged)
        refused(saved, r"policy\.safetensors (is|cannot be read as|was written by)")


@pytest.mark.exhaustive
def test_every_bit_of_all(saved: Path) -> None:
    content = saved.read_bytes()
    for at in range(8 * len(content)):
        damaged = bytearray(content)
        damaged[at // 8] ^= 1 << at % 8
        saved.write_bytes(damaged)
        refused(saved, r"policy\.safetensors (is|cannot be read as|was written by)")


def test_a_policy_of_an_older_version_has_no_checksum(saved: Path) -> None:
    header, tensors = parts(saved)
    saved.write_bytes(safetensors.save(tensors, {"format": "pearl-policy-1", "policy": header["policy"]}))
    refused(saved, "written by an older version of this package, whose policies have no checksum: train it")
    saved.write_bytes(safetensors.save(tensors, {"format": "pearl-policy-2", "policy": header["policy"]}))
    refused(saved, "its checksum is wrong")


@pytest.mark.parametrize(
    "content",
    [b"", b"no", np.random.default_rng(0).bytes(500), b"\xff" * 500],
    ids=["empty", "short", "random", "ones"],
)
def test_what_is_no_policy_is_refused(content: bytes, saved: Path) -> None:
    saved.write_bytes(content)
    with pytest.raises(ArgumentError, match=re.escape("policy.safetensors cannot be read as a policy")):
        trained.load(saved.parent)


def test_headers_that_are_deep_or_long(saved: Path) -> None:
    for policy in ("[" * depth + "]" * depth for depth in range(960, 1000)):
        text = f'{{"__metadata__":{{"format":"pearl-policy-2","policy":{policy}}}}}'.encode()
        saved.write_bytes(len(text).to_bytes(8, "little") + text)
        with pytest.raises(ArgumentError, match=re.escape("policy.safetensors")):
            trained.load(saved.parent)
    saved.write_bytes(safetensors.save({}, {"format": "x" * 100_000}))
    with pytest.raises(ArgumentError, match="its format is") as caught:
        trained.load(saved.parent)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("name", ["temperature", "chance"])
def test_a_temperature_may_be_any_number(name: str, saved: Path) -> None:
    rewritten(saved, **{name: 2**64})
    actions = load_policy(str(saved), get_spec("CartPole"))(np.zeros((9, 4), np.float32))
    assert set(actions.tolist()) <= {0, 1}


@pytest.mark.parametrize(("kind", "name"), [("logits", "temperature"), ("values", "epsilon")])
def test_older_files_have_one_name_for_both(kind: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    trained.NetworkPolicy(get_spec("CartPole"), kind, 8, **{name: 0.25}).save(path)
    new = trained.load(path)
    rewritten(path, drop=name, chance=0.25)
    old = trained.load(path)
    assert getattr(old, name) == getattr(new, name) == 0.25
    assert old.about == new.about
