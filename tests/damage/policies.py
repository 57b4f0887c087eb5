"""Policies: networks and tables of trainers, and tables of action values in NumPy's files."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

import pearl_marl
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.policies import policy_file, trained
from pearl_marl.policies.loading import load_policy

from .damages import TRAP, as_json, mutated
from .kind import Kind, Rng, expect


class Policies(Kind):
    """A network of ``pearl train``."""

    weight = 16
    env_id = "CartPole"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        torch.manual_seed(0)
        self.spec = pearl_marl.get_spec(self.env_id)
        self.file = folder / "policy.safetensors"
        self.policy().save(self.file)
        self.sample = self.file.read_bytes()
        self.obs = Native().open(BatchConfig(spec=self.spec, n_envs=16)).reset(0)
        self.actions = load_policy(str(self.file), self.spec)(self.obs)

    def policy(self) -> Any:
        return trained.NetworkPolicy(self.spec, "logits", 8)

    def crafted(self, rng: Rng) -> bytes:
        size = int.from_bytes(self.sample[:8], "little")
        header, body = json.loads(self.sample[8 : 8 + size]), bytearray(self.sample[8 + size :])
        metadata = header["__metadata__"]
        match int(rng.integers(4)):
            case 0:
                metadata["policy"] = as_json(mutated(json.loads(metadata["policy"]), rng)).decode()
            case 1:
                header = {**mutated(header, rng), "__metadata__": metadata}
            case 2:
                name = str(rng.choice([name for name in header if name != "__metadata__"]))
                shape = [int(n) for n in rng.choice([0, 1, 2, 8, 10**7, 2**40], int(rng.integers(1, 4)))]
                header[name] = {**header[name], "shape": shape}
                if 0 in shape:
                    header[name]["data_offsets"][1] = header[name]["data_offsets"][0]
            case _:
                for at in rng.integers(len(body) // 4, size=3).tolist():
                    word = float(rng.choice([np.nan, np.inf, -np.inf, 1e38, -1.0, 0.0, 1e-45]))
                    struct.pack_into("<f", body, 4 * at, word)
        text = json.dumps(header).encode()
        return policy_file.sealed(len(text).to_bytes(8, "little") + text + bytes(body))

    def read(self, content: bytes, sealed: bool) -> None:
        self.file.write_bytes(content)
        actions = load_policy(str(self.file), self.spec)(self.obs)
        if sealed:
            within = [self.spec.action_space.contains(action) for action in actions]
            expect(all(within), f"actions {actions}")
        else:
            expect(np.array_equal(actions, self.actions), "another policy")


class Tables(Policies):
    """A table of ``pearl train --algo q-learning``."""

    env_id = "CliffWalking"
    weight = 8

    def policy(self) -> Any:
        table = trained.TabularPolicy(self.spec)
        table.values.normal_()
        return table


class NumberPolicies(Policies):
    """A network for observations that are numbers, which choose rows of a table."""

    env_id = "Blackjack"
    weight = 8

    def policy(self) -> Any:
        return trained.NetworkPolicy(self.spec, "values", 8)


class Arrays(Kind):
    """Tables of action values in ``.npy``."""

    weight = 12
    suffix = ".npy"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.spec = pearl_marl.get_spec("CliffWalking")
        self.table = np.random.default_rng(0).random((48, 4))
        self.file = folder / f"table{self.suffix}"
        self.write()
        self.sample = self.file.read_bytes()

    def write(self) -> None:
        np.save(self.file, self.table)

    def crafted(self, rng: Rng) -> bytes:
        shape = rng.choice([0, 1, 4, 48, 10**7, 2**40], int(rng.integers(5))).tolist()
        descr = str(
            rng.choice(["<f8", ">f8", "<f4", "|O", "<U9", "|V8", "<M8[s]", "<f7", "|b1", "<c16", "<i8"])
        )
        header = str({"descr": descr, "fortran_order": bool(rng.integers(2)), "shape": tuple(shape)})
        if not rng.integers(3):
            at = int(rng.integers(len(header)))
            header = (
                header[:at] + str(rng.choice([*"(){}[]'\\,0L\n\0", f"__import__('{TRAP}')"])) + header[at:]
            )
        text = header.encode("latin1").ljust(117) + b"\n"
        version = bytes([int(rng.choice([1, 1, 1, 2, 3, 9])), 0])
        length = len(text).to_bytes(2 if version[0] == 1 else 4, "little")
        return b"\x93NUMPY" + version + length + text + self.table.tobytes()

    def read(self, content: bytes, sealed: bool) -> None:
        self.file.write_bytes(content)
        actions = load_policy(str(self.file), self.spec)(np.arange(48))
        expect(actions.shape == (48,) and actions.max() < 4, f"actions {actions}")
        if self.suffix == ".npz" and not sealed:
            expect(np.array_equal(actions, self.table.argmax(1)), "another table")


class Archives(Arrays):
    """Tables of action values in ``.npz``."""

    suffix = ".npz"

    def write(self) -> None:
        np.savez_compressed(self.file, q=self.table, curve=np.zeros(9))

    def crafted(self, rng: Rng) -> bytes:
        member = super().crafted(rng)
        if not rng.integers(4):
            member += bytes(1 << 24)
        how = [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w", how[int(rng.integers(4))]) as archive:
            archive.writestr(str(rng.choice(["q.npy", "q.npy", "q", "x.npy", "../q.npy", "q\n.npy"])), member)
        return file.getvalue()
