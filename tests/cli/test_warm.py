"""Kernels compiled ahead."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Pearl = Callable[..., tuple[int, str, str]]

ENTRY = "import sys; from pearl_marl.__main__ import main; sys.argv[0] = 'pearl'; main()"

STEPS = """
import json, sys
from numba.core import event
import pearl_marl
from pearl_marl.policies.integer_network import unchanging_network
with event.install_recorder("numba:compile") as compiled:
    for name in sys.argv[1:]:
        for form in ("whole", "packed") if name == "ConnectFour" else ("whole",):
            env = pearl_marl.parallel_env(name, observations=form)
            env.reset(seed=0)
            env.step({agent: 0 for agent in env.agents})
        if form == "whole":
            env.unwrapped.rollout(unchanging_network(pearl_marl.get_spec(name)), 1)
kernels = {moment.data["dispatcher"].__module__ for _, moment in compiled.buffer}
print(json.dumps([name for name in kernels if name.startswith("pearl_marl_kernel_")]))
"""


def python(cache: Path, script: str, *arguments: str) -> Any:
    """Run a script with a cache folder; return what it prints, which is JSON."""
    environment = {**os.environ, "PEARL_CACHE_DIR": str(cache)}
    call = [sys.executable, "-c", script, *arguments]
    return json.loads(
        subprocess.run(call, capture_output=True, text=True, check=True, env=environment).stdout
    )


@pytest.mark.exhaustive
def test_what_is_warm_is_not_compiled_again(tmp_path: Path) -> None:
    """Neither by a second call, nor by the first steps of an environment."""
    given = "CliffWalking", "ConnectFour"
    # The kernels of each form, and the loop and the policy of all rollouts.
    assert len(python(tmp_path, STEPS, *given)) == 3 + 2
    cache = tmp_path / "warm"
    first = python(cache, ENTRY, "warm", *given, "--json")
    assert first["cache"] == str(cache / "kernels")
    assert {row["environment"] for row in first["warmed"]} == {"CliffWalking-v0", "ConnectFour-v0"}
    assert all(row["compiled"] for row in first["warmed"])
    again = python(cache, ENTRY, "warm", *given, "--json")
    assert [row["compiled"] for row in again["warmed"]] == [0, 0]
    assert python(cache, STEPS, *given) == []


def test_a_line_for_each(pearl: Pearl) -> None:
    status, out, _ = pearl("warm", "CliffWalking", "--option", "is_slippery=true")
    assert status == 0
    assert out.startswith("CliffWalking-v0 ")
    assert "Kernels are kept in" in out


def test_what_would_not_be_kept_is_not_compiled(tmp_path: Path) -> None:
    (cache := tmp_path / "file").write_text("")
    environment = {**os.environ, "PEARL_CACHE_DIR": str(cache)}
    call = [sys.executable, "-c", ENTRY, "warm", "CliffWalking"]
    done = subprocess.run(call, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("pearl: the cache folder cannot be written, so no kernel would be kept: ")


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core compiles in this process")
def test_ctrl_c_is_not_for_the_processes_that_compile() -> None:
    """A terminal sends it to all of them, and what has hardly begun would print a traceback."""
    call = [sys.executable, "-c", ENTRY, "warm", "CliffWalking", "FrozenLake"]
    process = subprocess.Popen(call, stderr=subprocess.PIPE, text=True, start_new_session=True)
    children: list[str] = []
    while len(children) < 3:  # and one that keeps track of what they share
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    for child in children:
        status = Path(f"/proc/{child}/status").read_text()
        # The one that keeps track ignores it, and then no longer blocks it.
        masks = re.findall(r"Sig(?:Blk|Ign):\s*(\w+)", status)
        assert any(int(mask, 16) >> signal.SIGINT - 1 & 1 for mask in masks)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate()
    assert (process.returncode, err) == (130, "pearl: interrupted\n")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["NoSuch"], "there is no environment 'NoSuch'"),
        (["CliffWalking", "--option", "nothing=1"], "nothing"),
        (["--option", "is_slippery=true"], "name the environment"),
    ],
)
def test_refused(pearl: Pearl, arguments: list[str], words: str) -> None:
    status, out, err = pearl("warm", *arguments)
    assert (status, out) == (2, "")
    assert words in err
