"""What `pearl eval` takes for a policy."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.policies.loading import load_policy, table_policy

CLIFF, CARDS, POLE = (get_spec(name) for name in ("CliffWalking", "Blackjack", "CartPole"))


def test_random_actions_are_those_of_the_seed() -> None:
    observations = np.zeros(100, np.int64)
    drawn = [load_policy("random", CLIFF, seed)(observations) for seed in (3, 3, 4)]
    assert set(drawn[0]) == {0, 1, 2, 3}
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert (drawn[0] != drawn[2]).any()


def test_random_actions_are_allowed_ones() -> None:
    masks = np.tile(np.array([[0, 1, 0, 0, 1, 0, 0], [0, 0, 0, 0, 0, 0, 0]], np.int8), (50, 1))
    policy = load_policy("random", get_spec("ConnectFour"), 3)
    actions = policy(np.zeros((100, 6, 7, 2), np.int8), masks)
    assert set(actions[::2]) == {1, 4}
    assert set(actions[1::2]) == {0}, "who is not on turn"


def test_a_table_is_followed_greedily() -> None:
    table = np.random.default_rng(0).random((48, 4))
    table[7] = 1.0  # equal: the first
    cells = np.array([7, 47, 0])
    assert table_policy(table, CLIFF)(cells).tolist() == [0, table[47].argmax(), table[0].argmax()]


def test_a_table_of_several_observations() -> None:
    table = np.random.default_rng(0).random((32, 11, 2, 2))
    hands = np.array([[12, 10, 0], [21, 1, 1]])
    expected = [table[12, 10, 0].argmax(), table[21, 1, 1].argmax()]
    assert table_policy(table, CARDS)(hands).tolist() == expected


@pytest.mark.parametrize("kind", ["npy", "npz"])
def test_files_of_tables(kind: str, tmp_path: Path) -> None:
    table = np.random.default_rng(0).random((48, 4), np.float32)
    path = tmp_path / f"table.{kind}"
    if kind == "npy":
        np.save(path, table)
    else:
        np.savez(path, q=table, curve=np.zeros(3))
    cells = np.arange(48)
    np.testing.assert_array_equal(load_policy(str(path), CLIFF)(cells), table.argmax(1))


@pytest.mark.parametrize(
    ("table", "spec", "says"),
    [
        (np.zeros((48, 3)), CLIFF, r"shape \(48, 3\) .* CliffWalking takes numbers of shape \(48, 4\)"),
        (np.zeros((48, 4), "U1"), CLIFF, "dtype <U1"),
        (np.full((48, 4), np.nan), CLIFF, r"the table has NaN, 192 times, first at \(0, 0\)"),
        (np.zeros((32, 11, 2)), CARDS, r"shape \(32, 11, 2, 2\)"),
        (np.zeros((48, 4)), POLE, "a table is for discrete observations and actions; CartPole has Box"),
    ],
)
def test_tables_that_do_not_fit(
    table: np.ndarray, spec: pearl_marl.EnvSpec, says: str, tmp_path: Path
) -> None:
    np.save(tmp_path / "table.npy", table)
    with pytest.raises(ArgumentError, match=rf"table\.npy: .*{says}"):
        load_policy(str(tmp_path / "table.npy"), spec)


def test_files_that_are_no_tables(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", curve=np.zeros(3))
    (tmp_path / "text.npy").write_text("no numbers")
    (tmp_path / "text.npz").write_text("no numbers")
    (tmp_path / "zip.npz").write_bytes(b"PK\x03\x04")
    with (tmp_path / "header.npy").open("wb") as file:
        header = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 10**6)}
        np.lib.format.write_array_header_1_0(file, header)
    for name, says in (
        ("other.npz", "no readable table: it has no array 'q'; its arrays are curve"),
        ("text.npy", "no readable table: it does not begin as one that NumPy writes"),
        ("text.npz", "no readable table: it does not begin as one that NumPy writes"),
        ("missing.npy", "there is no file"),
        ("zip.npz", "no readable table: it is a damaged archive"),
        ("header.npy", r"the table has shape \(1000000000000, 1000000\)"),
    ):
        with pytest.raises(ArgumentError, match=says):
            load_policy(str(tmp_path / name), CLIFF)


MODULE = "def lean(observations):\n    return (observations[:, 2] > 0).astype(int)\nnumber = 5\n"


def test_functions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "my_policies_of_this_test.py"
    path.write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    poles = np.array([[0, 0, 0.1, 0], [0, 0, -0.1, 0]])
    for name in (f"{path}:lean", "my_policies_of_this_test:lean"):
        assert load_policy(name, POLE)(poles).tolist() == [1, 0]
    for name, says in (
        (f"{path}:fall", "has no function or policy 'fall'"),
        (f"{path}:number", "has no function or policy 'number'"),
        (f"{tmp_path}/nowhere.py:lean", "cannot be imported: .*No such file"),
        ("no_such_module_anywhere:lean", "cannot be imported: No module named"),
    ):
        with pytest.raises(ArgumentError, match=says):
            load_policy(name, POLE)


REMEMBERS = """
import numpy as np
class Policy:
    notes = []
    def __call__(self, observations):
        return np.zeros(len(observations), int)
    def forget(self, *ended):
        self.notes.append([flags.tolist() for flags in ended])
        if len(self.notes) > 10:
            raise RuntimeError(str(self.notes))
policy = Policy()
"""


def test_a_policy_that_remembers_is_told_what_ended(
    tmp_path: Path, pearl: Callable[..., tuple[int, str, str]]
) -> None:
    path = tmp_path / "remembers.py"
    path.write_text(REMEMBERS)
    given = ("eval", "Catch", "--policy", f"{path}:policy", "--n-agents", 2, "--episodes", 4)
    status, _, err = pearl(*given)
    assert status == 2
    calls = [[], *[[[False, False]]] * 8, [[True, True]], [[False, False]]]
    assert f"{path}:policy failed: remembers.py, line 10: RuntimeError: {calls}" in err


@pytest.mark.parametrize("name", ["greedy", "", ":f", "module:", "a:b c", "q_table.weights"])
def test_names_of_nothing(name: str) -> None:
    with pytest.raises(ArgumentError, match=r"there is no policy .*; possible are 'random', a table"):
        load_policy(name, CLIFF)


@pytest.mark.parametrize("name", [3, None])
def test_what_is_no_name(name: Any) -> None:
    with pytest.raises(ArgumentError, match=f"policy is {name}; it must be its name"):
        load_policy(name, CLIFF)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("def act(:", "mine.py, line 1: invalid syntax"),
        ("import sys\nsys.exit(3)", "cannot be imported: mine.py, line 2: SystemExit: 3"),
        ("\n1 / 0", "cannot be imported: mine.py, line 2: ZeroDivisionError: division by zero"),
        ("act = lambda: 0", r"mine.py:act failed: TypeError: .*takes 0 positional arguments but 1 was given"),
        ("def act(seen):\n    return seen[99]", "mine.py:act failed: mine.py, line 2: IndexError: index 99"),
    ],
)
def test_functions_that_fail(text: str, says: str, tmp_path: Path) -> None:
    (path := tmp_path / "mine.py").write_text(text)
    with pytest.raises(ArgumentError, match=says):
        load_policy(f"{path}:act", CLIFF)(np.zeros(4, np.uint8))


@pytest.mark.parametrize(
    ("algorithm", "env_id"), [("PPO", "CartPole"), ("DQN", "Blackjack"), ("SAC", "Pendulum")]
)
def test_models_of_stable_baselines3(algorithm: str, env_id: str, tmp_path: Path) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    from pearl_marl.wrappers import sb3_vec_env

    env = sb3_vec_env(pearl_marl.parallel_env(env_id, n_agents=6))
    model = getattr(sb3, algorithm)("MlpPolicy", env, seed=0, device="cpu")
    path = tmp_path / "model.zip"
    model.save(path)
    observations = env.reset()
    expected = model.predict(observations, deterministic=True)[0]
    np.testing.assert_array_equal(load_policy(str(path), get_spec(env_id))(observations), expected)
    with pytest.raises(ArgumentError, match=r"was trained on observations in .*; here they are in Discrete"):
        load_policy(str(path), CLIFF)


def test_a_zip_that_is_no_model(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    (tmp_path / "model.zip").write_text("no zip")
    with zipfile.ZipFile(tmp_path / "empty.zip", "w") as archive:
        archive.writestr("data", "{}")
    for name, says in (("model.zip", ""), ("empty.zip", ": it does not say its policy$")):
        with pytest.raises(ArgumentError, match=rf"{name} is no model of stable-baselines3{says}"):
            load_policy(str(tmp_path / name), POLE)
