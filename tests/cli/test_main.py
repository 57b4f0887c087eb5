"""What all commands share: short options, the version, and Ctrl-C without a traceback."""

from __future__ import annotations

import importlib
import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pearl_marl.base.version import __version__
from pearl_marl.cli import COMMANDS

Pearl = Callable[..., tuple[int, str, str]]

ENTRY = "import sys; from pearl_marl.__main__ import main; sys.argv[0] = 'pearl'; main()"
ROOT = Path(__file__).parents[2]
DEADLINE = 300


def test_version(pearl: Pearl) -> None:
    assert pearl("--version") == (0, f"pearl {__version__}\n", "")


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_h_is_help(pearl: Pearl, command: str) -> None:
    arguments = [command] if command else []
    status, short, _ = pearl(*arguments, "-h")
    assert status == 0
    assert (0, short, "") == pearl(*arguments, "--help")
    assert "-h" in short


@pytest.mark.parametrize("command", COMMANDS)
def test_the_list_says_what_a_commands_own_help_does(command: str) -> None:
    own = importlib.import_module(f"pearl_marl.cli.{command}").command.__doc__
    assert COMMANDS[command] == " ".join(own.strip().split("\n\n")[0].split())


def test_every_command_is_listed(pearl: Pearl) -> None:
    _, listed, _ = pearl("--help")
    assert [line.split()[1] for line in listed.splitlines() if line.startswith("│ ")][-len(COMMANDS) :] == [
        *COMMANDS
    ]


def started(hook: str, *arguments: Any, **options: Any) -> subprocess.Popen[str]:
    """Start the command line in a process of its own, with some code before it."""
    return subprocess.Popen(
        [sys.executable, "-c", f"{hook}\n{ENTRY}", *map(str, arguments)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def interrupted(
    process: subprocess.Popen[str], reached: Callable[[], bool], times: int = 1
) -> tuple[int, str]:
    """Interrupt a process once it has reached something; return its exit status, and what it said."""
    end = time.monotonic() + DEADLINE
    while not reached():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)
    for _ in range(times):
        process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=DEADLINE)
    return process.returncode, err


WAIT_FOR = """
import builtins, pathlib, sys, time
real = builtins.__import__
def importing(name, *rest, **others):
    if name == {name!r} and not pathlib.Path({mark!r}).exists():
        pathlib.Path({mark!r}).touch()
        while True:
            time.sleep(0.01)
    return real(name, *rest, **others)
builtins.__import__ = importing
"""
"""Waits for ever where a module is imported, and says so by a file."""

GO_ON = "the same command again"


def sentences(err: str) -> list[str]:
    """Return what a command said, but that it compiles a kernel, as it does the first time ever."""
    lines = err.strip().splitlines()
    return [line for line in lines if line and not line.startswith("pearl: compiling")]


@pytest.mark.parametrize("module", ["numba", "typer", "torch", "tensorboard"])
def test_ctrl_c_while_python_loads(module: str, tmp_path: Path) -> None:
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed")
    mark, out = tmp_path / "reached", tmp_path / "run"
    hook = WAIT_FOR.format(name=module, mark=str(mark))
    process = started(hook, "train", "CartPole", "--out", out)
    status, err = interrupted(process, mark.exists)
    assert status == 130, err
    assert "Traceback" not in err
    assert len(sentences(err)) == 1, err
    assert sentences(err)[0].startswith("pearl: interrupted")
    if module in ("torch", "tensorboard"):
        assert GO_ON in err
        assert str(out) in err


SLOW = """
import pathlib, time
def slowly(module, name):
    real = getattr(module, name)
    def call(*arguments, **options):
        pathlib.Path({mark!r}).touch()
        try:
            while True:
                time.sleep(0.01)
        except KeyboardInterrupt:
            {then}
    setattr(module, name, call)
"""


@pytest.mark.parametrize("then", ["raise", "raise ImportError('half of it') from None"])
def test_ctrl_c_at_work(then: str, tmp_path: Path) -> None:
    """While kernels compile; libraries may make another exception of it."""
    pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
    mark, out = tmp_path / "reached", tmp_path / "run"
    hook = SLOW.format(mark=str(mark), then=then)
    hook += "\nfrom pearl_marl.training import agents\nslowly(agents, 'make_device')\n"
    process = started(hook, "train", "CartPole", "--n-agents", 32, "--out", out)
    status, err = interrupted(process, mark.exists)
    assert status == 130, err
    assert "Traceback" not in err
    assert len(sentences(err)) == 1, err
    assert "pearl: interrupted" in err
    assert GO_ON in err
    assert str(out) in err


def test_ctrl_c_under_way(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
    out = tmp_path / "run"
    arguments = ["train", "CliffWalking", "--algo", "q-learning", "--n-agents", 64, "--evaluate-every", 5]
    arguments += ["--out", out, "--iterations"]
    process = started("", *arguments, 1_000_000)
    status, err = interrupted(process, (out / "policy.safetensors").exists)
    assert status == 130, err
    assert "Traceback" not in err
    keeping, last = sentences(err)
    assert keeping == "pearl: keeping the run after this iteration; Ctrl-C again ends it now"
    assert f"with the same --out {out}" in last
    for name in ("checkpoint.pt", "metrics.csv", "learning_curve.png"):
        assert (out / name).exists(), "of seconds after the start: none is due yet"


def test_ctrl_c_in_another_command(tmp_path: Path) -> None:
    mark = tmp_path / "reached"
    hook = WAIT_FOR.format(name="pearl_marl.cli.nothing", mark=str(mark))
    hook += "\nimport pearl_marl.cli.run\n"
    hook += "pearl_marl.cli.run.random_policy = lambda *_: importing('pearl_marl.cli.nothing')\n"
    status, err = interrupted(started(hook, "run", "CliffWalking", "--n-agents", 8), mark.exists)
    assert (status, sentences(err)) == (130, ["pearl: interrupted"])


def test_a_bug_keeps_its_traceback() -> None:
    hook = "import pearl_marl.cli.run\npearl_marl.cli.run.random_policy = None\n"
    process = started(hook, "run", "CliffWalking", "--n-agents", 8, env={**os.environ, "NO_COLOR": "1"})
    _, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == 1
    assert "Traceback" in err
    assert "TypeError" in err
