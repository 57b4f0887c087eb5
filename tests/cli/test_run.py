"""``pearl run --actions``: the shapes that it takes, and those that it refuses."""

from __future__ import annotations

import importlib
import io
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pearl_marl.cli.common import on_device
from pearl_marl.envs import get_spec
from pearl_marl.policies import integer_file
from pearl_marl.policies.integer_network import table_network

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


def pickled() -> bytes:
    file = io.BytesIO()
    np.save(file, np.array([None]), allow_pickle=True)
    return file.getvalue()


def zipped() -> bytes:
    file = io.BytesIO()
    np.savez(file, a=np.zeros(3), b=np.zeros(3))
    return file.getvalue()


FILES = b"", b"no", b"PK\x03\x04", b"\x93NUMPY" + bytes(50), pickled(), zipped()


@pytest.mark.parametrize("content", FILES)
def test_files_that_hold_no_array_are_refused(pearl: Pearl, content: bytes, tmp_path: Path) -> None:
    (tmp_path / "actions.npy").write_bytes(content)
    status, _, err = pearl("run", "CliffWalking", "--n-agents", 5, "--actions", tmp_path / "actions.npy")
    assert status == 2
    assert len(err.splitlines()) == 1
    assert "pickle" not in err
    assert "no readable .npy file" in err


@pytest.mark.parametrize("line", ["run CliffWalking --actions fifo.npy", "verify fifo.json"])
def test_nobody_waits_for_a_fifo(
    pearl: Pearl, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo(line.split()[-1])
    status, _, err = pearl(*line.split())
    assert status == 2
    assert "it is a folder, or no file of a disk" in err


class TestWorlds:
    def test_whole_ones_by_default(self, pearl: Pearl) -> None:
        arguments = ("--option", "players=5", "--steps", 2, "--json")
        status, out, err = pearl("run", "LevelBasedForaging", *arguments)
        assert status == 0, err
        assert json.loads(out)["n_agents"] == 43005

    @pytest.mark.parametrize("command", ["run", "verify", "eval"])
    def test_parts_of_them_are_refused(self, pearl: Pearl, command: str) -> None:
        also = ("--policy", "random") if command == "eval" else ()
        status, out, err = pearl(command, "ConnectFour", *also, "--n-agents", 7)
        assert (status, out) == (2, "")
        assert err == "pearl: n_agents is 7, and a world of ConnectFour has 2 agents; 6 and 8 fit\n"

    def test_random_actions_are_allowed_ones(self, pearl: Pearl) -> None:
        """Connect Four refuses all others, and columns fill up."""
        status, out, err = pearl("run", "ConnectFour", "--n-agents", 400, "--steps", 60, "--json")
        assert status == 0, err
        result = json.loads(out)
        assert result["return_min"] == -1
        assert result["return_mean"] == 0

    def test_evaluation(self, pearl: Pearl) -> None:
        arguments = ("--policy", "random", "--n-agents", 60, "--json")
        status, out, err = pearl("eval", "LevelBasedForaging", *arguments)
        assert status == 0, err
        result = json.loads(out)
        assert (result["n_agents"], result["episodes"]) == (60, 60)

    def test_verification(self, pearl: Pearl) -> None:
        status, _, err = pearl("verify", "ConnectFour", "--n-agents", 20, "--steps", 40)
        assert status == 0, err

    @pytest.mark.parametrize("algorithm", ["dqn", "iql", "q-learning"])
    def test_training_where_it_is_not_possible(self, algorithm: str, pearl: Pearl, tmp_path: Path) -> None:
        pytest.importorskip("torch")
        status, _, err = pearl("train", "ConnectFour", "--algo", algorithm, "--out", tmp_path / "run")
        assert status == 2
        assert err.strip() == (
            f"pearl: {algorithm.replace('iql', 'dqn')} learns from every step, and in ConnectFour agents "
            "take turns: use self-play"
        )

    def test_training(self, pearl: Pearl, tmp_path: Path) -> None:
        pytest.importorskip("torch")
        arguments = ("--option", "players=3", "--iterations", 1, "--out", tmp_path / "run", "--json")
        status, out, err = pearl("train", "LevelBasedForaging", *arguments)
        assert status == 0, err
        assert json.loads(out)["last"]["agent_steps"] == 16 * 510


class TestVideo:
    @pytest.mark.parametrize(
        ("env", "n", "size"),
        [("ConnectFour", 20, (608, 530)), ("LevelBasedForaging", 8, (404, 404)), ("Taxi", 2, (404, 170))],
    )
    def test_a_grid_of_worlds(
        self, pearl: Pearl, env: str, n: int, size: tuple[int, int], tmp_path: Path
    ) -> None:
        images = pytest.importorskip("PIL.Image")
        path = tmp_path / "new" / "film.gif"
        status, out, err = pearl("run", env, "--n-agents", n, "--steps", 12, "--video", path)
        assert status == 0, err
        assert f"Wrote{path}" in "".join(out.split())  # a long path is broken where lines end
        with images.open(path) as film:
            assert film.format == "GIF"
            assert 5 < film.n_frames <= 12
            assert film.size == size

    @pytest.mark.parametrize(("action", "moves"), [(3, False), (0, True)])
    def test_a_film_where_nothing_moves_is_reported(
        self, pearl: Pearl, action: int, moves: bool, tmp_path: Path
    ) -> None:
        pytest.importorskip("PIL")
        pytest.importorskip("pygame")
        np.save(tmp_path / "actions.npy", np.full((3, 2), action))
        status, _, err = pearl(
            *("run", "CliffWalking", "--n-agents", 2, "--steps", 3),
            *("--actions", tmp_path / "actions.npy", "--video", tmp_path / "film.gif"),
        )
        assert status == 0
        assert ("its3picturesarethesame" in "".join(err.split())) != moves

    @pytest.mark.parametrize(
        ("env", "name", "words"),
        [
            ("Taxi", "film.mp4", "it must be a file that ends in .gif"),
            ("Ladder", "film.gif", "render_mode is 'rgb_array'; Ladder has none"),
            ("Taxi", "file/film.gif", "is no folder that can be written"),
            ("Taxi", "folder.gif", "folder.gif is a folder, and a file is to be written there"),
        ],
    )
    @pytest.mark.usefixtures("toys")
    def test_refusals(self, pearl: Pearl, env: str, name: str, words: str, tmp_path: Path) -> None:
        (tmp_path / "file").write_text("")
        (tmp_path / "folder.gif").mkdir()
        status, out, err = pearl("run", env, "--steps", 1, "--video", tmp_path / name)
        assert (status, out) == (2, "")
        assert words in err
        assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("device", "simulated"),
    [("rtl", True), ("xdma:/dev/shm/board", True), ("xdma:1", False), ("xdma", False), ("native", False)],
)
def test_figures_of_simulated_hardware_are_labelled(device: str, simulated: bool) -> None:
    title = on_device("Taxi-v0", device)
    assert title.startswith(f"Taxi-v0 on {device}")
    assert title.endswith("simulated: times are the simulator's") == simulated


def test_a_policy_by_its_name(pearl: Pearl, tmp_path: Path) -> None:
    """A golden function acts in a rollout, a function of arrays step by step."""
    path = tmp_path / "mine.py"
    path.write_text(
        "from pearl_marl import get_spec\n"
        "from pearl_marl.policies.golden_policy import GoldenPolicy\n"
        "def act(place, draws):\n"
        "    return 1\n"
        "right = GoldenPolicy(get_spec('CliffWalking'), act)\n"
        "def also_right(places):\n"
        "    return [1] * len(places)\n"
    )
    given = "--n-agents", 3, "--steps", 9, "--max-cycles", 3, "--json"
    status, out, err = pearl("run", "CliffWalking", "--policy", f"{path}:right", *given)
    assert status == 0, err
    rolled_out = json.loads(out)
    assert rolled_out["return_mean"] == -300
    status, out, err = pearl("run", "CliffWalking", "--policy", f"{path}:also_right", *given)
    assert status == 0, err
    stepped = json.loads(out)
    assert stepped["policy"] == f"{path}:also_right"
    for figure in ("episodes", "truncated", "return_mean", "length_mean"):
        assert stepped[figure] == rolled_out[figure]
    status, _, err = pearl("verify", "CliffWalking", "--policy", f"{path}:also_right")
    assert status == 2
    assert "also_right is a function of arrays, which cannot run beside the environments" in " ".join(
        err.split()
    )


def test_a_policy_forgets_what_was_before_an_episode(pearl: Pearl, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(
        "import numpy as np\n"
        "class Patient:\n"
        "    age = np.zeros(3, int)\n"
        "    def __call__(self, places):\n"
        "        self.age += 1\n"
        "        return np.where(self.age > 3, 1, 0)\n"  # into the cliff, but no episode is that long
        "    def forget(self, ended):\n"
        "        self.age[ended] = 0\n"
        "patient = Patient()\n"
    )
    given = "--n-agents", 3, "--steps", 9, "--max-cycles", 3, "--json"
    status, out, err = pearl("run", "CliffWalking", "--policy", f"{path}:patient", *given)
    assert status == 0, err
    result = json.loads(out)
    assert (result["episodes"], result["return_mean"]) == (9, -3)


@pytest.mark.parametrize("memory", [False, True])
def test_a_policy_that_was_trained(pearl: Pearl, tmp_path: Path, memory: bool) -> None:
    """It does what it does in `pearl eval`."""
    torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
    trained = importlib.import_module("pearl_marl.policies.trained")
    torch.manual_seed(3)
    policy = trained.NetworkPolicy(get_spec("MemoryChain"), "logits", 8, memory="gru" if memory else "none")
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter += torch.randn(parameter.shape)
    policy.save(tmp_path / "policy.safetensors")
    given = "--policy", tmp_path, "--n-agents", 500, "--json"
    status, out, err = pearl("run", "MemoryChain", *given, "--steps", 200)
    assert status == 0, err
    result = json.loads(out)
    status, out, err = pearl("eval", "MemoryChain", *given, "--episodes", result["episodes"])
    assert status == 0, err
    evaluated = json.loads(out)["return"]
    assert abs(result["return_mean"] - evaluated["mean"]) < 0.1


def test_a_policy_in_integers(pearl: Pearl, tmp_path: Path) -> None:
    spec = get_spec("CliffWalking")
    up, right = [1, 0, 0, 0], [0, 1, 0, 0]
    integer_file.save(
        table_network(spec, np.array([right] * 36 + [up] + [right] * 11)), tmp_path / "p.safetensors"
    )
    given = "--policy", tmp_path / "p.safetensors", "--n-agents", 3
    status, out, err = pearl("run", "CliffWalking", *given, "--steps", 30, "--max-cycles", 10, "--json")
    assert status == 0, err
    result = json.loads(out)
    assert (result["episodes"], result["truncated"], result["agent_steps"]) == (9, 9, 90)
    assert (result["return_mean"], result["return_std"], result["length_mean"]) == (-10, 0, 10)
    status, out, err = pearl("run", "CliffWalking", *given, "--steps", 5)
    assert status == 0, err
    assert "one rollout, the policy included" in out
    film = tmp_path / "film.gif"
    status, out, err = pearl(
        "run", "CliffWalking", *given, "--steps", 30, "--max-cycles", 10, "--json", "--video", film
    )
    assert status == 0, err
    assert film.stat().st_size > 1000
    stepped = json.loads(out)
    assert all(stepped[figure] == result[figure] for figure in ("episodes", "return_mean", "length_mean"))
    status, _, err = pearl("run", "CliffWalking", *given, "--actions", tmp_path / "actions.npy")
    assert status == 2
    assert "--policy and --actions both say what agents do" in err
