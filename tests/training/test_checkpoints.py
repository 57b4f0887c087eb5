"""Checkpoints: no code of strangers, none lost to a kill, and a sentence for each that is damaged."""

from __future__ import annotations

import csv
import importlib
import json
import os
import pickle
import re
import zipfile
from pathlib import Path
from typing import Any

import pytest

from pearl_marl import files
from pearl_marl.errors import ArgumentError, DeviceError

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
training = importlib.import_module("pearl_marl.training.run")
run_folder = importlib.import_module("pearl_marl.training.run_folder")
rollout = importlib.import_module("pearl_marl.training.rollout")

GIVEN = {"n_agents": 64, "iterations": 6}


def run(folder: Path) -> Any:
    settings = training.settings_for("q-learning", "CliffWalking", GIVEN)
    return training.train(
        "CliffWalking",
        {},
        "q-learning",
        settings,
        "native",
        folder,
        evaluate_every=2,
        checkpoint_seconds=0.0,
        evaluated=10,
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Of a run that is done, with its last two checkpoints."""
    run(tmp_path)
    return tmp_path


def refused(folder: Path, words: str) -> None:
    before = {path: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(ArgumentError, match=words) as caught:
        run(folder)
    assert "\n" not in str(caught.value)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


class Malicious:
    """Whose pickle makes a file when it is read."""

    def __init__(self, trap: Path) -> None:
        self.trap = trap

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.trap),)


@pytest.mark.parametrize("kind", ["of torch", "of pickle"])
def test_nobody_elses_code_is_run(kind: str, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    trap = tmp_path_factory.mktemp("trap") / "sprung"
    file = folder / "checkpoint.pt"
    content = {"format": run_folder.FORMAT, "rows": [], "trainer": Malicious(trap), "seconds": 0, "best": 0}
    if kind == "of torch":
        torch.save(content, file)
    else:
        file.write_bytes(pickle.dumps(content))
    refused(folder, r"checkpoint\.pt is damaged.*checkpoint\.previous\.pt")
    assert not trap.exists()


def truncated(content: bytes) -> bytes:
    return content[: len(content) // 2]


def flipped(content: bytes) -> bytes:
    """One bit of the largest tensor: whether it is noticed is up to the checksums."""
    at = content.index(b"PEARLST")
    return content[: at + 40] + bytes([content[at + 40] ^ 1]) + content[at + 41 :]


DAMAGES = {
    "empty": lambda content: b"",
    "truncated": truncated,
    "cut by a byte": lambda content: content[:-1],
    "random": lambda content: b"\x80\x02" + bytes(range(256)) * 20,
    "text": lambda content: b"no checkpoint\n",
    "a bit": flipped,
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_checkpoint_is_refused_and_the_one_before_gone_on_from(damage: Any, folder: Path) -> None:
    whole = [{**row, "seconds": 0} for row in run(folder)]
    file = folder / "checkpoint.pt"
    policy = (folder / "policy.safetensors").read_bytes()
    file.write_bytes(damage(file.read_bytes()))
    refused(folder, r"checkpoint\.pt is damaged.*: delete it.*go on from .*checkpoint\.previous\.pt")
    file.unlink()
    rows = [{**row, "seconds": 0} for row in run(folder)]
    assert rows == whole
    with (folder / "metrics.csv").open() as metrics:
        assert [int(row["agent_steps"]) for row in csv.DictReader(metrics)] == [128, 256, 384]
    assert (folder / "policy.safetensors").read_bytes() == policy
    assert file.exists()


def test_a_damaged_checkpoint_that_is_the_only_one(folder: Path) -> None:
    (folder / "checkpoint.previous.pt").unlink()
    (folder / "checkpoint.pt").write_bytes(b"")
    refused(folder, r"checkpoint\.pt is damaged.*: delete it.*to start over")


@pytest.mark.parametrize(
    "content",
    [
        [],
        3,
        {},
        {"rows": 3},
        {"trainer": []},
        {"trainer": {}},
        {"trainer": {"done": "two"}},
        {"seconds": "long"},
        {"rows": [{"agent_steps": "a"}, 3]},
    ],
    ids=repr,
)
def test_a_checkpoint_of_other_content_is_refused(content: Any, folder: Path) -> None:
    file = folder / "checkpoint.pt"
    if isinstance(content, dict) and content:
        content = {**torch.load(file, weights_only=True), **content}
    elif content == {}:
        content = {"format": run_folder.FORMAT}
    torch.save(content, file)
    refused(folder, r"checkpoint\.pt is damaged|checkpoint\.pt is of another version")


def test_a_state_of_other_agents_is_refused(folder: Path) -> None:
    file = folder / "checkpoint.pt"
    checkpoint = torch.load(file, weights_only=True)
    checkpoint["trainer"]["agents"] = checkpoint["trainer"]["agents"][:-1].clone()
    torch.save(checkpoint, file)
    refused(folder, r"checkpoint\.pt is damaged.*checksum")


def test_a_device_that_fails_is_not_the_checkpoints_fault(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> None:
        raise DeviceError("the board is away")

    monkeypatch.setattr(rollout.Agents, "load", fails)
    with pytest.raises(DeviceError, match="the board is away"):
        run(folder)


@pytest.mark.parametrize(
    ("error", "raised", "words"),
    [
        (
            PermissionError(13, "Permission denied"),
            ArgumentError,
            r"checkpoint\.pt cannot be read",
        ),
        (MemoryError(), MemoryError, None),
    ],
    ids=["permission", "memory"],
)
def test_a_checkpoint_that_cannot_be_read_is_not_damaged(
    error: Exception,
    raised: type[Exception],
    words: str | None,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(torch, "load", fails)
    with pytest.raises(raised, match=words):
        run(folder)


def test_metrics_are_those_of_the_checkpoint_gone_on_from(folder: Path) -> None:
    metrics = folder / "metrics.csv"
    whole = metrics.read_bytes()
    metrics.write_bytes(whole.splitlines(keepends=True)[0])
    run(folder)
    assert metrics.read_bytes() == whole


def test_a_checkpoint_is_plain_data_of_checked_archives(folder: Path) -> None:
    assert set(torch.load(folder / "checkpoint.pt", weights_only=True)) >= {"trainer", "rows", "format"}
    assert zipfile.ZipFile(folder / "checkpoint.pt").testzip() is None


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[]",
        b"3",
        b"{}",
        b'{"settings": 3}',
        b"\xff\xfe\x00\x01",
        bytes(range(256)),
        b"[" * 100_000,
    ],
    ids=["empty", "brace", "list", "number", "no settings", "other settings", "utf-16", "random", "deep"],
)
def test_a_damaged_config_is_refused(content: bytes, folder: Path) -> None:
    (folder / "config.json").write_bytes(content)
    refused(folder, r"config\.json is damaged.*: choose another --out")


def test_a_file_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    fsync, replace, scratch = os.fsync, os.replace, r"^\.pearl-[0-9a-f]{8}\.tmp$"

    def synced(descriptor: int) -> None:
        name = Path(os.readlink(f"/proc/self/fd/{descriptor}")).name
        done.append(f"sync {re.sub(scratch, 'scratch', name)}")
        fsync(descriptor)

    def replaced(old: Path, new: Path) -> None:
        done.append(f"{re.sub(scratch, 'scratch', old.name)} -> {new.name}")
        replace(old, new)

    monkeypatch.setattr(files.os, "fsync", synced)
    monkeypatch.setattr(files.os, "replace", replaced)
    folder = run_folder.RunFolder(tmp_path, {})
    for number in range(3):
        done.clear()
        folder.checkpoint({"number": number})
    assert done[:4] == [
        "sync scratch",
        "checkpoint.pt -> checkpoint.previous.pt",
        "scratch -> checkpoint.pt",
        f"sync {tmp_path.name}",
    ]
    numbers = [
        torch.load(tmp_path / name, weights_only=True)["number"]
        for name in ("checkpoint.previous.pt", "checkpoint.pt")
    ]
    assert numbers == [1, 2]


@pytest.mark.parametrize("step", range(1, 6))
def test_a_kill_at_any_step_of_writing_loses_no_more_than_that(
    step: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = run_folder.RunFolder(tmp_path, {})
    for number in range(2):
        folder.checkpoint({"number": number})
    calls = 0

    def killing(function: Any) -> Any:
        def call(*arguments: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == step:
                raise KeyboardInterrupt
            return function(*arguments)

        return call

    with monkeypatch.context() as patch:
        for name in ("fsync", "replace"):
            patch.setattr(files.os, name, killing(getattr(os, name)))
        with pytest.raises(KeyboardInterrupt):
            folder.checkpoint({"number": 2})
    again = run_folder.RunFolder(tmp_path, {}).resume()
    assert again["number"] in (1, 2)


def test_a_folder_that_cannot_be_written(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(
        ArgumentError, match=re.escape("checkpoint.pt cannot be written: No space left on dev")
    ):
        run_folder.RunFolder(folder, json.loads((folder / "config.json").read_text())["settings"]).checkpoint(
            {}
        )


def test_a_folder_is_of_one_process(folder: Path) -> None:
    settings = json.loads((folder / "config.json").read_text())["settings"]
    with run_folder.RunFolder(folder, settings).claimed(), pytest.raises(ArgumentError, match="another proc"):
        run(folder)
    run(folder)
