"""Checkpoints: no code of strangers, none lost to a kill, and a sentence for each that is damaged."""

from __future__ import annotations

import csv
import importlib
import io
import json
import os
import pickle
import re
import resource
import shutil
import threading
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pearl_marl.base import files
from pearl_marl.errors import ArgumentError, DeviceError

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
training = importlib.import_module("pearl_marl.training.run")
run_folder = importlib.import_module("pearl_marl.training.run_folder")
agents = importlib.import_module("pearl_marl.training.agents")

GIVEN = {"n_agents": 64, "iterations": 6}


def run(folder: Path, **given: Any) -> Any:
    settings = training.settings_for("q-learning", "CliffWalking", {**GIVEN, **given})
    plan = training.Training("CliffWalking", "q-learning", settings, evaluate_every=2)
    run = training.TrainingRun(plan, folder, evaluated=10, checkpoint_seconds=0.0)
    with run.claimed():
        while not run.finished:
            run.iterate()
    return run.rows


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    run(folder)
    return folder


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    """Of a run that is done, with its last two checkpoints."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    return tmp_path


def refused(folder: Path, words: str, **given: Any) -> None:
    before = {path: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(ArgumentError, match=words) as caught:
        run(folder, **given)
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


def test_a_run_whose_settings_have_earlier_names_goes_on(folder: Path) -> None:
    whole = [{**row, "seconds": 0} for row in run(folder)]
    policy = (folder / "policy.safetensors").read_bytes()
    (folder / "checkpoint.pt").unlink()  # so that something is left to do
    file, config = folder / "checkpoint.previous.pt", folder / "config.json"
    checkpoint, about = torch.load(file, weights_only=True), json.loads(config.read_text())
    settings = json.loads(checkpoint["settings"])
    for of in (settings["settings"], about["settings"]["settings"]):
        of["rate"], of["fading"] = of.pop("learning_rate"), of.pop("learning_rate_decay")
    torch.save({**checkpoint, "settings": json.dumps(settings)}, file)
    config.write_text(json.dumps(about))
    refused(folder, r"holds a run with learning_rate 0\.5, not 0\.25", learning_rate=0.25)
    assert [{**row, "seconds": 0} for row in run(folder)] == whole
    assert (folder / "policy.safetensors").read_bytes() == policy


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
    checkpoint["trainer"]["agents"] = torch.zeros(1, dtype=torch.uint8).expand(10**12)
    torch.save(checkpoint, file)
    refused(folder, r"checkpoint\.pt is damaged.*no row of bytes")


def test_a_device_that_fails_is_not_the_checkpoints_fault(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> None:
        raise DeviceError("the board is away")

    monkeypatch.setattr(agents.Agents, "load", fails)
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


def test_a_folder_is_claimed_before_anything_is_written_there(tmp_path: Path) -> None:
    """The one who comes second leaves no config.json behind."""
    settings = {"seed": 1}
    with run_folder.RunFolder(tmp_path, settings).claimed():
        refused(tmp_path, "another process trains in")
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("round_", range(3))
def test_of_several_the_one_who_trains_has_its_settings_there(round_: int, tmp_path: Path) -> None:
    started, winners, refusals = threading.Barrier(6), [], []

    def one(seed: int) -> None:
        folder = run_folder.RunFolder(tmp_path / "run", {"seed": seed})
        started.wait()
        try:
            with folder.claimed():
                folder.write_config()
                winners.append(seed)
                ended.wait(10)
        except ArgumentError as error:
            refusals.append(str(error))
        if len(refusals) == 5:
            ended.set()

    ended = threading.Event()
    threads = [threading.Thread(target=one, args=(seed,)) for seed in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(winners) == 1
    assert all("another process trains in" in refusal for refusal in refusals)
    assert json.loads((tmp_path / "run" / "config.json").read_text())["settings"]["seed"] == winners[0]


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"seed": 1}, r"checkpoint\.pt is of a run with seed 0, not 1: give the same settings"),
        (
            {"learning_rate": 0.25},
            r"checkpoint\.pt is of a run with learning_rate .*, not 0\.25: give the same settings",
        ),
    ],
)
@pytest.mark.parametrize("config", ["none", "its own"])
def test_a_checkpoint_of_another_run_is_refused(
    given: dict[str, Any], says: str, config: str, folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    other = tmp_path_factory.mktemp("other")
    if config == "its own":
        run(other, **given)
    else:
        (other / "checkpoint.previous.pt").write_bytes((folder / "checkpoint.pt").read_bytes())
        refused(other, says.replace("checkpoint", "checkpoint.previous"), **given)
        return
    (other / "checkpoint.pt").write_bytes((folder / "checkpoint.pt").read_bytes())
    refused(other, says, **given)


def test_a_run_from_before_a_setting_was_there_has_its_default(tmp_path: Path) -> None:
    def begun(**given: Any) -> Any:
        small = {"n_agents": 8, "rollout_length": 4, "iterations": 4, **given}
        settings = training.settings_for("ppo", "FrozenLake", small)
        return training.TrainingRun(training.Training("FrozenLake", "ppo", settings), tmp_path, evaluated=8)

    first = begun(chunk_length=16)
    with first.claimed():
        first.iterate()
        first.keep()
    config, checkpoint = tmp_path / "config.json", tmp_path / "checkpoint.pt"
    about, state = json.loads(config.read_text()), torch.load(checkpoint, weights_only=True)
    kept = json.loads(state["settings"])
    for settings in (about["settings"], kept):
        for name in ("memory", "chunk_length"):
            del settings["settings"][name]
    config.write_text(json.dumps(about))
    torch.save({**state, "settings": json.dumps(kept)}, checkpoint)
    for given, says in (
        ({"chunk_length": 8}, "a run with chunk_length 16, not 8"),
        ({"chunk_length": 16, "seed": 1}, "a run with seed 0, not 1"),
    ):
        with pytest.raises(ArgumentError, match=says), begun(**given).claimed():
            pass
    again = begun(chunk_length=16)
    with again.claimed():
        assert again.done == 1
        again.iterate()


def repacked(content: bytes, how: int, replace: dict[str, bytes] | None = None) -> bytes:
    """Return an archive with its members compressed, and some of other content, and right checksums."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(file, "w", how) as new:
        for name in old.namelist():
            new.writestr(name, (replace or {}).get(name.partition("/")[2], old.read(name)))
    return file.getvalue()


def test_a_checkpoint_is_refused_before_it_is_unpacked(folder: Path) -> None:
    """64 MiB in 64 KiB, and a pickle that says how long an array of bytes is to be."""
    file = folder / "checkpoint.pt"
    content = file.read_bytes()
    reduced = b"\x80\x02cbuiltins\nbytearray\nJ\x00\x00\x00\x40\x85R."  # 1 GiB
    for damaged in (
        repacked(content, zipfile.ZIP_DEFLATED, {"data/0": bytes(1 << 26)}),
        repacked(content, zipfile.ZIP_BZIP2),
        repacked(content, zipfile.ZIP_STORED, {"data.pkl": reduced}),
        repacked(
            content, zipfile.ZIP_STORED, {"data.pkl": b"\x80\x04\x8c\x08builtins\x8c\x09bytearray\x93."}
        ),
    ):
        file.write_bytes(damaged)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        refused(folder, r"checkpoint\.pt is damaged.*holds more than tensors and plain data")
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB


def changed(*path: Any, to: Any) -> Any:
    def change(checkpoint: Any) -> None:
        for key in path[:-1]:
            checkpoint = checkpoint[key]
        checkpoint[path[-1]] = to(checkpoint[path[-1]]) if callable(to) else to

    return change


CHANGES = {
    "one number for a table": changed("trainer", "values", to=torch.zeros(1)),
    "a table of doubles": changed("trainer", "values", to=lambda table: table.double()),
    "NaN": changed("trainer", "values", to=lambda table: table * np.nan),
    "updates below 0": changed("trainer", "updates", to=lambda updates: updates - 1),
    "iterations": changed("trainer", "done", to=-1),
    "more iterations": changed("trainer", "done", to=10**30),
    "a flag for iterations": changed("trainer", "done", to=True),
    "seconds": changed("seconds", to=float("nan")),
    "a best return": changed("best", to=float("nan")),
    "settings": changed("settings", to="["),
    "no settings": changed("settings", to=None),
    "a list of settings": changed("settings", to="[]"),
    "a name of a metric": changed("rows", 0, to=lambda row: {**row, 3: 1}),
    "a line of a metric": changed("rows", 0, to=lambda row: {**row, "a\nb": 1}),
    "a word for a metric": changed("rows", 0, "eval_return", to="high"),
    "no rows at the end": changed("rows", to=[]),
    "no return": changed("rows", 0, to={"agent_steps": 3}),
    "random numbers": changed("trainer", "random", to=lambda state: state * 0),
    "few random numbers": changed("trainer", "random", to=lambda state: state[:9]),
    "sums of episodes": changed("trainer", "episodes", to=(torch.zeros(1), torch.zeros(1))),
    "one sum of episodes": changed("trainer", "episodes", to=lambda sums: sums[:1]),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_what_no_training_keeps_is_refused(change: Any, folder: Path) -> None:
    file = folder / "checkpoint.pt"
    checkpoint = torch.load(file, weights_only=True)
    change(checkpoint)
    torch.save(checkpoint, file)
    refused(folder, r"checkpoint\.pt is (damaged|of a run with)")


OTHERS: dict[tuple[str, str], dict[str, dict[str, Any]]] = {
    ("dqn", "CliffWalking"): {
        "memory of actions": {"memory": {"actions": lambda rows: rows + 4}},
        "memory of observations": {"memory": {"obs": lambda rows: rows + 200}},
        "memory of flags": {"memory": {"over": lambda rows: rows[:, :1]}},
        "offsets": {"policy": {"network.encoder.offsets": lambda rows: rows + 10**9}},
        "weights": {"target": {"network.output.bias": lambda bias: bias / 0}},
        "steps": {"optimiser": {"steps": lambda steps: -1}},
        "squares": {"optimiser": {"square": lambda squares: squares - 1}},
    },
    ("self-play", "ConnectFour"): {
        "no model": {"model": lambda model: {}},
        "no league": {"league": lambda league: {}},
        "a path for a number": {"league": lambda league: {**league, "../x": league[0]}},
        "a member to come": {"league": lambda league: {**league, 99: league[0]}},
        "no first member": {"league": lambda league: {2: league[0]}},
        "another member": {"league": lambda league: {0: {}}},
    },
}


@pytest.mark.parametrize(("algorithm", "env_id"), OTHERS)
def test_what_no_trainer_keeps_is_refused(algorithm: str, env_id: str, tmp_path: Path) -> None:
    """Compiled loops would read beside their tables, and a policy be written beside its folder."""
    small = {"n_agents": 4, "iterations": 2, "width": 16, "seed": 0, "minibatch": 8}
    small |= {"memory": 8, "warm_up": 0} if algorithm == "dqn" else {"rollout_length": 8}
    settings = training.settings_for(algorithm, env_id, small)

    def train() -> None:
        plan = training.Training(env_id, algorithm, settings, evaluate_every=1)
        training.train(plan, tmp_path, evaluated=2)

    train()
    file = tmp_path / "checkpoint.pt"
    checkpoint = torch.load(file, weights_only=True)
    before = sorted(tmp_path.rglob("*"))

    def applied(value: Any, change: Any) -> Any:
        if callable(change):
            return change(value)
        return {**value, **{name: applied(value[name], part) for name, part in change.items()}}

    for name, change in OTHERS[algorithm, env_id].items():
        torch.save({**checkpoint, "trainer": applied(checkpoint["trainer"], change)}, file)
        says = r"checkpoint\.pt is damaged.*cannot be gone on from"
        with pytest.raises(ArgumentError, match=says) as caught:
            train()
        assert len(str(caught.value).splitlines()) == 1, name
        assert sorted(tmp_path.rglob("*")) == before, name
    torch.save(checkpoint, file)
    train()
