"""Files of NumPy that others wrote: what is damaged is refused in a sentence, and takes no memory."""

from __future__ import annotations

import contextlib
import io
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl import wrappers
from pearl_marl.base.arrays import load_array
from pearl_marl.errors import ArgumentError, SavedStateError
from pearl_marl.policies.loading import load_policy

CLIFF = pearl_marl.get_spec("CliffWalking")
TABLE = np.random.default_rng(0).random((48, 4))


def saved(array: Any = TABLE) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def with_header(header: str, data: bytes = TABLE.tobytes(), version: bytes = b"\1\0") -> bytes:
    text = header.encode("latin1").ljust(117) + b"\n"
    return b"\x93NUMPY" + version + len(text).to_bytes(2 * version[0], "little") + text + data


def zipped(member: bytes, how: int = zipfile.ZIP_STORED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", how) as archive:
        archive.writestr("q.npy", member)
    return file.getvalue()


def anything(*_: Any) -> None:
    """Take any shape and dtype."""


def read(path: Path, content: bytes) -> Any:
    path.write_bytes(content)
    return load_array(path, "table", anything, "q")


@pytest.mark.parametrize(
    "array",
    [
        TABLE,
        np.asfortranarray(TABLE),
        TABLE[:, :, None],
        TABLE[0],
        np.float32(3),
        np.zeros((3, 0), np.int8),
        TABLE.astype(">f4"),
        TABLE > 0.5,
        np.array([["ab", "c"]]),
    ],
    ids=lambda array: f"{array.shape} {array.dtype}",
)
@pytest.mark.parametrize("kind", ["npy", "npz", "compressed"])
def test_what_numpy_writes_is_read(array: Any, kind: str, tmp_path: Path) -> None:
    path = tmp_path / "array.npy"
    if kind == "npy":
        np.save(path, array)
    else:
        with path.open("wb") as file:
            (np.savez if kind == "npz" else np.savez_compressed)(file, q=array, other=np.zeros(9))
    found = load_array(path, "table", anything, "q")
    np.testing.assert_array_equal(found, array)
    assert found.dtype == array.dtype


@pytest.mark.parametrize("rows", [0, 3, len(TABLE), 10**9])
@pytest.mark.parametrize("order", ["C", "F"])
def test_no_more_rows_are_read_than_are_needed(rows: int, order: Any, tmp_path: Path) -> None:
    path = tmp_path / "array.npy"
    np.save(path, np.asarray(TABLE, order=order))
    np.testing.assert_array_equal(load_array(path, "table", anything, rows=rows)[:rows], TABLE[:rows])
    if order == "C":
        assert len(load_array(path, "table", anything, rows=rows)) == min(rows, len(TABLE))


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (48L, 4L), }",  # of Python 2
        "{'descr':'<f8','fortran_order':False,'shape':(48,4)}",
        "{'shape': (48, 4), 'fortran_order': False, 'descr': '<f8'}",
    ],
)
@pytest.mark.parametrize("version", [b"\1\0", b"\2\0"])
def test_what_others_write_is_read(header: str, version: bytes, tmp_path: Path) -> None:
    np.testing.assert_array_equal(read(tmp_path / "a.npy", with_header(header, version=version)), TABLE)


HEADERS = {
    "nothing": "",
    "a brace": "{",
    "no end": "{'descr': '<f8', 'fortran_order': False, 'shape': (48, 4",
    "brackets": "(" * 9000,
    "a call": "{'descr': '<f8', 'fortran_order': False, 'shape': (__import__('os').getpid(), 4), }",
    "a key twice": "{'descr': '<f8', 'descr': '<f8', 'shape': (48, 4), }",
    "a key more": "{'descr': '<f8', 'fortran_order': False, 'shape': (48, 4), 'x': (1,), }",
    "a word for an order": "{'descr': '<f8', 'fortran_order': 'no', 'shape': (48, 4), }",
    "a shape for a dtype": "{'descr': (48, 4), 'fortran_order': False, 'shape': (48, 4), }",
    "objects": "{'descr': '|O', 'fortran_order': False, 'shape': (48, 4), }",
    "columns": "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (48, 4), }",
    "no dtype": "{'descr': '<f7', 'fortran_order': False, 'shape': (48, 4), }",
    "a dtype of dates": "{'descr': '<M8[s]', 'fortran_order': False, 'shape': (48, 4), }",
    "no bytes": "{'descr': '<U0', 'fortran_order': False, 'shape': (1000000000000, 4), }",
    "long words": "{'descr': '<U999999', 'fortran_order': False, 'shape': (48, 4), }",
    "commas": "{'descr': '<f8', 'fortran_order': False, 'shape': (,,), }",
    "blanks": "{'descr': '<f8', 'fortran_order': False, 'shape': (48 4), }",
    "minus": "{'descr': '<f8', 'fortran_order': False, 'shape': (-48, -4), }",
    "large": "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 1000000), }",
    "larger": "{'descr': '<f8', 'fortran_order': False, 'shape': (%s, 4), }" % ("9" * 5000),
    "large of nothing": "{'descr': '<f8', 'fortran_order': False, 'shape': (10000000, 0, 4), }",
    "larger of nothing": "{'descr': '<f8', 'fortran_order': False, 'shape': (%s, 0, 4), }" % ("9" * 40),
    "axes": "{'descr': '<f8', 'fortran_order': False, 'shape': (%s), }" % ("1, " * 99),
    "smaller": "{'descr': '<f8', 'fortran_order': False, 'shape': (40, 4), }",
    "no text": "\xff\xfe{'descr': '<f8', 'fortran_order': False, 'shape': (48, 4), }",
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
@pytest.mark.parametrize("kind", ["npy", "npz"])
def test_strange_headers(header: str, kind: str, tmp_path: Path) -> None:
    content = with_header(header)
    with pytest.raises(ArgumentError, match="no readable table") as caught:
        read(tmp_path / "table.npz", content if kind == "npy" else zipped(content))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["npy", "npz", "compressed"])
def test_every_flip_of_a_bit(kind: str, tmp_path: Path) -> None:
    """In the header of a .npy, and anywhere in a .npz, it is refused or changes nothing."""
    content = saved() if kind == "npy" else zipped(saved(), zipfile.ZIP_DEFLATED * (kind == "compressed"))
    path = tmp_path / "table.npy"
    bits = range(8 * 128) if kind == "npy" else np.random.default_rng(0).choice(8 * len(content), 1000)
    for at in bits:
        damaged = bytearray(content)
        damaged[at // 8] ^= 1 << at % 8
        refusal = ""
        try:
            found = read(path, bytes(damaged))
        except ArgumentError as error:
            refusal = str(error)
        if refusal:
            assert len(refusal.splitlines()) == 1, at
            continue
        if kind != "npy":
            np.testing.assert_array_equal(found, TABLE)
        else:  # of another dtype as wide, or in another order: no table for CliffWalking, or another one
            assert found.nbytes == TABLE.nbytes


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    """A hundred megabytes in a hundred kilobytes; of the right shape it cannot be."""
    path = tmp_path / "table.npz"
    np.savez_compressed(path, q=np.zeros((1 << 24, 4), np.uint8))
    lying = with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (48, 4), }", bytes(1 << 26))
    long_header = b"\x93NUMPY\2\0" + (1 << 26).to_bytes(4, "little") + b" " * (1 << 26)
    for content in (
        path.read_bytes(),
        zipped(lying, zipfile.ZIP_DEFLATED),
        zipped(long_header, zipfile.ZIP_DEFLATED),
        zipped(saved(), zipfile.ZIP_LZMA),
    ):
        path.write_bytes(content)
        tracemalloc.start()
        with pytest.raises(ArgumentError, match=r"table\.npz"):
            load_policy(str(path), CLIFF)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 4 << 20


WRAPPED = {
    "frame_stack_v2": ("CartPole", lambda env: wrappers.frame_stack_v2(env, 3)),
    "numbers": ("CliffWalking", lambda env: wrappers.frame_stack_v2(env, 3)),
    "normalize_obs": ("CartPole", wrappers.normalize_observation_v0),
    "normalize_reward": ("CartPole", wrappers.normalize_reward_v0),
    "sticky_actions": ("CartPole", lambda env: wrappers.sticky_actions_v0(env, 0.5)),
}


@pytest.mark.parametrize(("env_id", "wrap"), WRAPPED.values(), ids=WRAPPED)
def test_saved_states_of_wrappers(env_id: str, wrap: Any) -> None:
    env = wrap(pearl_marl.parallel_env(env_id, 5))
    env.reset_batch(seed=0)
    for _ in range(3):
        env.step_batch(np.zeros(5, np.int64))
    blob = env.save_state()
    env.load_state(blob)
    head, _, body = blob.partition(b"\0")
    with np.load(io.BytesIO(body)) as file:
        arrays = dict(file)

    def written(how: Any = np.savez, **changes: Any) -> bytes:
        file = io.BytesIO()
        how(file, **{name: array for name, array in {**arrays, **changes}.items() if array is not None})
        return head + b"\0" + file.getvalue()

    def refused(blob: bytes, words: str) -> None:
        before = env.save_state()
        with pytest.raises(SavedStateError, match=words) as caught:
            env.load_state(blob)
        assert "\n" not in str(caught.value)
        assert env.save_state() == before

    env.load_state(written())
    refused(written(np.savez_compressed), "its .* bytes are compressed")
    refused(written(inner=None), "it has the arrays")
    refused(written(more=np.zeros(3)), "it has the arrays")
    refused(written(inner=np.zeros((10**6, 0), np.uint8)), r"'inner' has shape \(1000000, 0\)")
    refused(written(place=np.full(3, 1 << 40, np.uint64)), "'place' has numbers that no step")
    refused(written(resetting=np.full(5, 2, np.uint8).view(np.bool_)), "'resetting' has numbers")
    for name in arrays.keys() - {"inner", "place", "resetting"}:
        kind = arrays[name].dtype.kind
        wrong = {"f": np.nan, "b": None, "i": 1 << 40, "u": None}[kind]
        if wrong is not None:
            refused(written(**{name: np.full_like(arrays[name], wrong)}), f"'{name}' has numbers that no")
        refused(written(**{name: arrays[name].astype(np.float16)}), f"'{name}' has shape .* float16")
    for at in np.random.default_rng(0).choice(8 * len(blob), 100):
        damaged = bytearray(blob)
        damaged[at // 8] ^= 1 << at % 8
        with contextlib.suppress(SavedStateError):
            env.load_state(bytes(damaged))
        assert env.save_state() == blob
