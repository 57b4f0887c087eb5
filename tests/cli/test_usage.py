"""Wrong command lines, each answered by one sentence with the value, what is possible, and the fix."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from pearl_marl.cli.common import DEVICES
from pearl_marl.cli.train import ALGORITHMS
from pearl_marl.training import run

Pearl = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("bench steps CartPole --quick", "bench steps has no option --quick; "),
        ("bench training CartPole Taxi", "bench training does not take 'Taxi', in: pearl bench training"),
        ("bench steps --json --markdown", "--json and --markdown are two forms of the same: leave one out"),
        ("run CartPole --n-agents abc", "--n-agents is 'abc'; it must be an integer"),
        ("run CartPole --seed 1.5", "--seed is '1.5'; it must be an integer"),
        ("train CartPole --goal high", "--goal is 'high'; it must be a number"),
        ("run CartPole --n-agents", "Option '--n-agents' requires an argument: see pearl run --help"),
        ("run CartPole --json=3", "Option '--json' does not take a value: see pearl run --help"),
        ("--version=3", "Option '--version' does not take a value: see pearl --help"),
        ("run CartPole --stepz 3", "run has no option --stepz; did you mean --steps?"),
        ("run CartPole --qqq", "run has no option --qqq; pearl run --help lists those"),
        ("tran CartPole", "there is no command 'tran'; did you mean 'train'?"),
        ("it's", 'there is no command "it\'s"; there are envs, doctor, '),
        ("--", "name a command: there are envs, doctor, "),
        ("--json envs", "pearl has no option --json; options stand after the command, and pearl envs --help"),
        ("frobnicate", "there is no command 'frobnicate'; there are envs, doctor, "),
        ("run", "run needs ENV: an environment of `pearl envs` (pearl run --help tells more)"),
        ("eval Taxi", "eval needs --policy: "),
        ("run Taxi Blackjack", "run does not take 'Blackjack', in: pearl run Taxi Blackjack"),
        (
            "verify Taxi --autoreset-mode x",
            "--autoreset-mode is 'x'; it must be one of 'same-step', 'next-step'",
        ),
        ("run CliffWalking-v7", "there is no environment 'CliffWalking-v7'; CliffWalking has the id"),
        ("run CliffWalkin-v0", "there is no environment 'CliffWalkin-v0'; did you mean 'CliffWalking'?"),
        ("run CartPole --device gpu", "there is no device 'gpu'; possible are"),
        ("run CartPole --device refernce", "there is no device 'refernce'; did you mean 'reference'?"),
        ("run CartPole --device Native", "there is no device 'Native'; did you mean 'native'?"),
        ("run CartPole --device xmda:3", "there is no device 'xmda:3'; did you mean 'xdma:3'?"),
        ("eval CartPole --policy radnom", "'radnom' names no policy; did you mean 'random'?"),
        # What is counted.
        ("run CartPole --steps 0", "--steps is 0; it must be at least 1"),
        ("run CartPole --steps 99999999999999999999", "--steps is 99999999999999999999; it must be at most"),
        ("run CartPole --seed -1", "--seed is -1; it must be at least 0"),
        ("verify CartPole --max-cycles -1", "--max-cycles is -1; it must be at least 0"),
        (
            "run CartPole --max-cycles 4294967296",
            "--max-cycles is 4294967296; it must be at most 4,294,967,295",
        ),
        ("verify CartPole --steps 7", "the number of steps is 7; 8 modes share them: take more"),
        ("run CartPole --n-agents 0", "--n-agents is 0; it must be at least 1"),
        (
            "run CartPole --n-agents 99999999999999",
            "the number of agents is 99,999,999,999,999; random draws can tell 4,294,967,296 apart: take no",
        ),
        (
            "eval CartPole --policy random --n-agents 8 --episodes 99999999999",
            "the number of episodes is 99,999,999,999; it must be at least 1, and this machine has memory",
        ),
        *(
            (
                f"bench steps CartPole --seconds {seconds}",
                f"--seconds is {seconds}; it must be a number from 0 to",
            )
            for seconds in ("inf", "nan", "-1.0")
        ),
        (
            "serve LevelBasedForaging --at lb --n-agents 3",
            "n_agents is 3, and a world of LevelBasedForaging has",
        ),
        ("serve CliffWalking --at b --n-agents 4000000000", "4,000,000,000 agents of CliffWalking take"),
        # What hardware there can be.
        *(
            (f"{command} CartPole --n-envs 99999999999", "n_envs is 99,999,999,999; random draws can tell")
            for command in ("synth", "plan", "board vc707 --out o")
        ),
        (
            "board vc707 Seaquest --out o --n-envs 43008",
            "43,008 slots of Seaquest need 2,257.0 BRAM36, and the Xilinx VC707 has 1,030: 18,432 slots fit",
        ),
        (
            "board ulx3s Seaquest --out o --n-envs 43008",
            "43,008 slots of Seaquest need 2,460.5 BRAM36, and the Radiona ULX3S 85F has 104: 1,536 slots",
        ),
        ("plan CartPole --clock 400", "the clock is 400 MHz; for xc7 it can be 1 to 317"),
        ("plan CartPole --clock -3", "the clock is -3 MHz; for xc7 it can be 1 to 317"),
        ("plan CartPole --link -1,2,3", "--link is '-1,2,3'; the microseconds a call must be at least 0"),
        ("plan CartPole --link 1,2,0", "--link is '1,2,0'; the microseconds a call must be at least 0"),
        # Where results go.
        *(
            (f"{command} --out=", "--out is empty; give it a value, or leave it out")
            for command in (
                "run CartPole",
                "train CartPole",
                "board vc707 CartPole",
                "new Box",
                "core CartPole",
            )
        ),
        ("serve CartPole --at=", "--at is empty; give it a value"),
        ("core CartPole --out a.svg --graph a.svg", "--out and --graph are both a.svg: give one of them"),
        ("core CartPole --graph x.png", "--graph is x.png; it must be a file that ends in .svg"),
        ("envs --json --markdown", "--json and --markdown are two forms of the same: leave one out"),
        (
            "run CliffWalking --option is_slippery=true --option is-slippery=false",
            "--option gives is_slippery twice",
        ),
        (
            "run CartPole --device serial:/dev/null",
            "/dev/null cannot be used as a serial port at 3 Mbaud: Inapp",
        ),
        ("run a:b:c", "'a:b:c' names no module before its colon"),
        (f"run CliffWalking --option is_slippery={'[' * 90_000}", "is_slippery is '[[["),
        ("core CartPole --out a.svg --graph x/../a.svg", "--out and --graph are both a.svg"),
        (
            "eval Taxi --policy random --device reference --lockstep",
            "--lockstep compares with 'reference', which",
        ),
        ("train CartPole --algo ppoo", "--algo is 'ppoo'; did you mean 'ppo'?"),
    ],
)
def test_one_sentence(pearl: Pearl, line: str, sentence: str) -> None:
    status, out, err = pearl(*line.split())
    assert (status, out) == (2, "")
    assert err.startswith(f"pearl: {sentence}")
    assert len(err.splitlines()) == 1


def test_an_empty_word_is_no_value(pearl: Pearl) -> None:
    status, _, err = pearl("run", "CartPole", "--out", "")
    assert (status, err) == (2, "pearl: --out is empty; give it a value, or leave it out\n")


@pytest.mark.parametrize("command", ["run", "bench steps", "verify", "eval --policy random"])
def test_an_empty_word_is_no_environment(pearl: Pearl, command: str) -> None:
    status, _, err = pearl(*command.split(), "")
    assert (status, err) == (2, "pearl: an argument is empty; give it a value, or leave it out\n")


def test_a_long_value_is_shortened(pearl: Pearl) -> None:
    status, _, err = pearl("run", "CliffWalking", "--option", f"is_slippery={'x' * 50_000}")
    assert status == 2
    assert len(err) < 1000


FOLDERS = {
    "run CartPole": "--out",
    "train CartPole": "--out",
    "eval CartPole --policy random": "--out",
    "bench steps CartPole": "--out",
    "synth CartPole": "--out",
    "plan CartPole": "--out",
    "verify CartPole": "--out",
    "board vc707 CartPole": "--out",
    "report": "--out",
    "new Box": "--out",
    "serve CartPole": "--at",
    "core CartPole --out y.sv": "--graph",
}
"""Commands by the option that says where their results go."""


@pytest.mark.parametrize(
    ("where", "why"),
    [
        ("file", "Not a directory"),
        ("file/inside", "Not a directory"),
        ("/proc/x", "No such file or directory"),  # which is refused to root, too
        ("link", "No such file or directory"),
    ],
)
@pytest.mark.parametrize("line", FOLDERS)
def test_where_nothing_can_be_written(
    line: str, where: str, why: str, pearl: Pearl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Refused before the work, and nothing is made."""
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    Path("link").symlink_to("nothing")
    option = FOLDERS[line]
    status, out, err = pearl(*line.split(), option, f"{where}/x.svg" if option == "--graph" else where)
    assert (status, out) == (2, "")
    assert err.startswith(f"pearl: {option} {where}")
    assert f"is no folder that can be written: {why}" in err
    assert sorted(os.listdir()) == ["file", "link"]


@pytest.mark.parametrize(
    ("line", "result"),
    [
        ("run CliffWalking", "run.json"),
        ("run CliffWalking", "heat_map.png"),
        ("eval CartPole --policy random", "evaluation.json"),
        ("eval CartPole --policy random", "evaluation.html"),
        ("match ConnectFour x.npy y.npy", "matches.json"),
        ("bench steps CartPole", "bench_CartPole_43008.json"),
        ("bench growth", "bench_growth.json"),
        ("bench steps --all", "bench_all_43008.json"),
        ("plan CartPole --n-envs 16", "plan_CartPole_16.json"),
        ("synth CartPole --n-envs 16 --pe-num 2 --data-wl 32", "synth_CartPole_xc7_2_32.json"),
        ("synth --all --n-envs 16", "synth_all_xc7_16.json"),
        ("verify CartPole", "divergence_CartPole_native.json"),
        ("board vc707 CliffWalking --n-envs 16", "build.tcl"),
        ("train CliffWalking --algo q-learning", "learning_curve.png"),
        ("train CliffWalking --algo q-learning", "metrics.csv"),
        ("train CliffWalking --algo q-learning", "policy.safetensors"),
    ],
)
def test_a_folder_where_a_result_is_to_be(line: str, result: str, pearl: Pearl, tmp_path: Path) -> None:
    """Refused before the work."""
    (there := tmp_path / result).mkdir()
    if line.startswith("train"):
        pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
    status, out, err = pearl(*line.split(), "--out", tmp_path)
    assert (status, out) == (2, "")
    assert f"{there} is a folder" in err
    assert len(err.strip().splitlines()) == 1
    assert os.listdir(tmp_path) == [result]


def test_what_cannot_be_written_leaves_nothing(pearl: Pearl, tmp_path: Path) -> None:
    with mock.patch("os.fsync", side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))):
        status, _, err = pearl("run", "CliffWalking", "--n-agents", 4, "--steps", 2, "--out", tmp_path)
    assert (status, os.listdir(tmp_path)) == (2, [])
    assert f"{tmp_path / 'run.json'} cannot be written: No space left on device; make room for it" in err


@pytest.mark.parametrize("name", ["/dev/null", "fifo"])
def test_a_device_is_no_file_to_write(
    name: str, pearl: Pearl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would be replaced by one."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("fifo")
    status, _, err = pearl("core", "CliffWalking", "--out", name)
    assert (status, err) == (
        2,
        f"pearl: {name} is no file of a disk, and a file is to be written there: choose another place\n",
    )
    assert not Path(name).is_file()


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("run CliffWalking --n-agents 4 --steps 2", "/run.json\n"),
        ("train CliffWalking --algo q-learning --n-agents 64 --iterations 1", ": policy.safetensors"),
    ],
)
def test_paths_are_printed_as_they_are(pearl: Pearl, line: str, what: str, tmp_path: Path) -> None:
    """Neither as the emoji of a name between colons nor as a style in brackets."""
    if line.startswith("train"):
        pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
    folder = tmp_path / "o:b:[red]x"
    status, out, err = pearl(*line.split(), "--out", folder)
    assert status == 0, err
    assert f"Wrote {folder}{what}" in out


def test_too_little_memory(pearl: Pearl) -> None:
    with mock.patch("pearl_marl.cli.run.parallel_env", side_effect=MemoryError):
        status, out, err = pearl("run", "CliffWalking", "--n-agents", 4)
    assert (status, out) == (2, "")
    assert err.startswith("pearl: there is not enough memory for that: take fewer agents")


def test_a_refused_call_leaves_no_folder(
    pearl: Pearl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for line in (
        "run CartPole --device gpu",
        "eval CartPole --policy x.npy",
        "board ulx3s Seaquest --n-envs 43008",
    ):
        assert pearl(*line.split(), "--out", "o")[0] == 2
    assert os.listdir() == []


def called(*arguments: str, **given: Any) -> subprocess.CompletedProcess[str]:
    program = "import sys; from pearl_marl.__main__ import main; sys.argv[0] = 'pearl'; main()"
    return subprocess.run(
        [sys.executable, "-c", program, *arguments], text=True, stderr=subprocess.PIPE, check=False, **given
    )


@pytest.mark.parametrize("line", ["envs", "envs --json"])
def test_output_that_cannot_be_written(line: str) -> None:
    with open("/dev/full", "w") as full:
        done = called(*line.split(), stdout=full)
    assert (done.returncode, done.stderr) == (
        1,
        "pearl: the output cannot be written: No space left on device\n",
    )


@pytest.mark.parametrize("closed", [1, 2])
def test_a_closed_stream(closed: int) -> None:
    done = called("envs", stdout=subprocess.PIPE, preexec_fn=lambda: os.close(closed))
    assert (done.returncode, done.stderr) == (0, "")
    assert ("CliffWalking" in done.stdout) == (closed == 2)


def test_streams_of_ascii(tmp_path: Path) -> None:
    ascii_ = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "COLUMNS": "0"}
    line = "eval", "Blackjack", "--policy", "random", "--n-agents", "40", "--out", str(tmp_path)
    done = called(*line, stdout=subprocess.PIPE, env=ascii_)
    compiling = "pearl: compiling Blackjack"  # where no test has done so before
    assert [line for line in done.stderr.splitlines() if not line.startswith(compiling)] == []
    assert done.returncode == 0
    assert "digest" in done.stdout
    assert "? 0." in done.stdout, "a mean and its confidence"
    assert "±" not in done.stdout
    pytest.importorskip("matplotlib")
    assert not (tmp_path / "evaluation.html").read_text("utf-8").isascii()


def test_a_current_folder_that_is_gone(tmp_path: Path) -> None:
    (gone := tmp_path / "gone").mkdir()
    program = "import os, sys; from pearl_marl.__main__ import main; os.rmdir(os.getcwd()); main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "envs"], cwd=gone, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (
        2,
        "pearl: the current folder is no more: change to one that there is\n",
    )


def test_a_folder_is_no_environment(pearl: Pearl, tmp_path: Path) -> None:
    status, _, err = pearl("verify", tmp_path)
    assert (status, f"{tmp_path} is a folder; name an environment" in err) == (2, True)


def test_an_id_is_a_name(pearl: Pearl) -> None:
    status, out, _ = pearl("run", "cliffwalking-v0", "--n-agents", 8, "--steps", 2)
    assert status == 0
    assert "CliffWalking-v0 on native" in out


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("run Cl", ["CliffWalking"]),
        ("run C", ["CartPole", "Catch", "CliffWalking", "CoinGame", "ConnectFour"]),
        ("run Taxi --device r", ["rtl", "reference"]),
        ("train Taxi --algo q-", ["q-learning"]),
        ("tr", ["train"]),
    ],
)
def test_a_shell_completes(line: str, words: list[str]) -> None:
    environment = {
        **os.environ,
        "_PEARL_COMPLETE": "complete_bash",
        "COMP_WORDS": f"pearl {line}",
        "COMP_CWORD": str(len(line.split())),
    }
    program = "import sys; from pearl_marl.__main__ import main; sys.argv[:] = ['pearl']; main()"
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == words, done.stderr


def test_what_is_completed_is_all_that_there_is(pearl: Pearl) -> None:
    """Both are listed twice: whoever completes a word cannot wait for PyTorch and Numba."""
    _, _, err = pearl("run", "Taxi", "--device", "gpu")
    possible = err.partition("possible are ")[2].partition(", 'xdma:N'")[0]
    assert {name.strip("'") for name in possible.split(", ")} == set(DEVICES)
    assert {*run.ALGORITHMS, *run.ALIASES} == set(ALGORITHMS)
