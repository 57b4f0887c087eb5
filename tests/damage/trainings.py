"""Folders of training runs: a checkpoint or a config.json is damaged, and the run gone on with."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from pearl_marl.errors import PearlError
from pearl_marl.training import run as training

from .damages import INSANE, as_json, damaged, mutated
from .kind import Kind, Rng, expect


class Training(Kind):
    """A run's folder: one of its files is damaged, and the run gone on with."""

    weight = 5
    name = "checkpoint.pt"
    algorithm, env_id = "q-learning", "CliffWalking"
    given: ClassVar[dict[str, Any]] = {"n_agents": 8, "iterations": 3}

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.rows = self.train()
        self.file = folder / self.name
        self.sample = self.file.read_bytes()
        self.files = self.found()

    def train(self) -> Any:
        settings = training.settings_for(self.algorithm, self.env_id, self.given)
        plan = training.Training(self.env_id, self.algorithm, settings, evaluate_every=1)
        run = training.TrainingRun(plan, self.folder, evaluated=4, checkpoint_seconds=0.0)
        with run.claimed():
            while not run.finished:
                run.iterate()
        return run.rows

    def found(self) -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in self.folder.rglob("*") if path.is_file()}

    def crafted(self, rng: Rng) -> bytes:
        if not rng.integers(4):
            return self.repacked(rng)
        checkpoint = torch.load(io.BytesIO(self.sample), weights_only=True)
        _put(checkpoint, rng)
        file = io.BytesIO()
        torch.save(checkpoint, file)
        return file.getvalue()

    def repacked(self, rng: Rng) -> bytes:
        """Return the archive with other members, or packed in another way."""
        file = io.BytesIO()
        how = [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA][int(rng.integers(3))]
        with zipfile.ZipFile(io.BytesIO(self.sample)) as old, zipfile.ZipFile(file, "w", how) as new:
            names = old.namelist()
            chosen = names[int(rng.integers(len(names)))]
            for name in names:
                content = old.read(name)
                if name == chosen:
                    content = [bytes(1 << 24), b"", damaged(content, [content], rng)][int(rng.integers(3))]
                new.writestr(name, content)
        return file.getvalue()

    def read(self, content: bytes, sealed: bool) -> None:
        self.file.write_bytes(content)
        try:
            rows = self.train()
        except PearlError:
            self.file.write_bytes(self.sample)
            expect(self.found() == self.files, "a refused run has changed its folder")
            raise
        finally:
            for path, now in self.found().items():
                before = self.files.get(path)
                if before is None:
                    path.unlink()
                elif now != before:
                    path.write_bytes(before)
        expect(sealed or _alike(rows, self.rows), f"other metrics: {rows}")


def _put(checkpoint: Any, rng: Rng) -> None:
    """Put something insane into a tree of tensors and plain data."""
    places: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        for key in list(value) if isinstance(value, dict) else range(len(value)):
            places.append((value, key))
            if isinstance(value[key], (dict, list)):
                walk(value[key])

    walk(checkpoint)
    holder, key = places[int(rng.integers(len(places)))]
    value = holder[key]
    insane = INSANE[int(rng.integers(len(INSANE)))]
    if isinstance(value, torch.Tensor) and rng.integers(4):
        match int(rng.integers(6)):
            case 0:
                insane = value.reshape(-1)[:1].expand(10**7)
            case 1:
                insane = value.double()
            case 2:
                insane = torch.zeros(0)
            case 3:
                insane = value * 0 - 3
            case 4:
                insane = value.float() * float("nan")
            case _:
                insane = value.clone()
                if insane.numel():
                    flat = insane.reshape(-1).numpy().view(np.uint8)
                    flat[int(rng.integers(flat.size))] ^= 1 << int(rng.integers(8))
    if rng.integers(6):
        holder[key] = insane
    elif isinstance(holder, dict):
        del holder[key]
    else:
        holder.append(insane)


def _alike(rows: Any, others: Any) -> bool:
    """Return whether metrics are the same, but for how long it took."""
    return bool([{**row, "seconds": 0} for row in rows] == [{**row, "seconds": 0} for row in others])


class Leagues(Training):
    """A run of self-play, whose league is kept."""

    weight = 2
    algorithm, env_id = "self-play", "ConnectFour"
    given: ClassVar[dict[str, Any]] = {
        "n_agents": 4,
        "iterations": 2,
        "width": 8,
        "minibatch": 8,
        "rollout_length": 8,
    }


class Memories(Training):
    """A run of DQN, whose memory compiled loops read."""

    weight = 3
    algorithm = "dqn"
    given: ClassVar[dict[str, Any]] = {
        "n_agents": 4,
        "iterations": 2,
        "width": 8,
        "memory": 8,
        "minibatch": 8,
        "warm_up": 0,
    }


class Configs(Training):
    """The ``config.json`` of a run."""

    weight = 8
    name = "config.json"

    def crafted(self, rng: Rng) -> bytes:
        return as_json(mutated(json.loads(self.sample), rng))
