"""Wrong command lines, each answered by one sentence with the value, what is possible, and the fix."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import pytest

from pearl_marl.cli.common import DEVICES
from pearl_marl.cli.train import ALGORITHMS
from pearl_marl.training import run

Pearl = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("bench CartPole --quick", "--quick works only with --training: add that, or leave --quick out"),
        ("bench --training --growth", "--training has settings of its own: leave out --all, --growth,"),
        ("run CartPole --n-agents abc", "--n-agents is 'abc'; it must be an integer"),
        ("run CartPole --seed 1.5", "--seed is '1.5'; it must be an integer"),
        ("train CartPole --goal high", "--goal is 'high'; it must be a number"),
        ("run CartPole --n-agents", "Option '--n-agents' requires an argument: see pearl --help"),
        ("run CartPole --json=3", "Option '--json' does not take a value: see pearl --help"),
        ("run CartPole --stepz 3", "pearl run has no option --stepz; did you mean --steps?"),
        ("run CartPole --qqq", "pearl run has no option --qqq; pearl run --help lists those"),
        ("tran CartPole", "there is no command 'tran'; did you mean 'train'?"),
        ("frobnicate", "there is no command 'frobnicate'; there are envs, doctor, "),
        ("run", "pearl run needs ENV: an environment of `pearl envs` (pearl run --help tells more)"),
        ("eval Taxi", "pearl eval needs --policy: "),
        ("run Taxi Blackjack", "pearl run does not take 'Blackjack', in: pearl run Taxi Blackjack"),
        (
            "verify Taxi --autoreset-mode x",
            "--autoreset-mode is 'x'; it must be one of 'same-step', 'next-step'",
        ),
        ("run CliffWalking-v7", "there is no environment 'CliffWalking-v7'; CliffWalking has the id"),
        ("run CliffWalkin-v0", "there is no environment 'CliffWalkin-v0'; did you mean 'CliffWalking'?"),
        ("run CartPole --device rtx", "there is no device 'rtx'; possible are"),
    ],
)
def test_one_sentence(pearl: Pearl, line: str, sentence: str) -> None:
    status, out, err = pearl(*line.split())
    assert (status, out) == (2, "")
    assert err.startswith(f"pearl: {sentence}")
    assert len(err.splitlines()) == 1


def test_an_id_is_a_name(pearl: Pearl) -> None:
    status, out, _ = pearl("run", "cliffwalking-v0", "--n-agents", 8, "--steps", 2)
    assert status == 0
    assert "CliffWalking-v0 on native" in out


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("run Cl", ["CliffWalking"]),
        ("run C", ["CartPole", "CliffWalking", "CoinGame", "ConnectFour"]),
        ("run Taxi --device r", ["rtl", "reference"]),
        ("train Taxi --algo q", ["q-learning"]),
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
    program = "import sys; from pearl_marl_entry import main; sys.argv[:] = ['pearl']; main()"
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == words, done.stderr


def test_what_is_completed_is_all_that_there_is(pearl: Pearl) -> None:
    """Both are listed twice: whoever completes a word cannot wait for PyTorch and Numba."""
    _, _, err = pearl("run", "Taxi", "--device", "nowhere")
    possible = err.partition("possible are ")[2].partition(", 'xdma:N'")[0]
    assert {name.strip("'") for name in possible.split(", ")} == set(DEVICES)
    assert {*run.ALGORITHMS, *run.ALIASES} == set(ALGORITHMS)
