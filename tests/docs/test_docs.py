"""Every example and command of the documentation runs."""

import importlib.util
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from pearl_marl.hardware import toolchain

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("envs/*/README.md")])


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


INTEGRATIONS = ROOT / "docs" / "integrations.md"
SCRIPTS = re.findall(r"^## (.*?)\n+```python\n(.*?)^```", INTEGRATIONS.read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize(
    "page", [p for p in PAGES if p != INTEGRATIONS and blocks(p, "python")], ids=lambda p: p.name
)
def test_python_examples_run(page, tmp_path):
    """The examples of a page run in order, as one program."""
    program = tmp_path / "examples.py"
    program.write_text("\n".join(blocks(page, "python")))
    command = [sys.executable, program]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr
    # What a page says that is printed; errors name another file there than the one that all examples make.
    printed = re.sub(r"^\S+, line \d+: ", "", done.stdout, flags=re.MULTILINE).splitlines()
    for line in "".join(blocks(page, "text")).splitlines():
        assert re.sub(r"^\S+, line \d+: ", "", line) in printed


def walk(page: Path) -> list[tuple[str, str]]:
    """Return the files that a page shows (path and text) and its commands ("$" and the line), in order."""
    fence = r"^```(?:\w+ file=(\S+)|console)\n(.*?)^```"
    steps = []
    for file, text in re.findall(fence, page.read_text(), re.MULTILINE | re.DOTALL):
        steps += [(file, text)] if file else [("$", line[2:]) for line in text.splitlines()]
    return steps


WALKS = [page for page in PAGES if any(file != "$" for file, _ in walk(page))]
"""Pages to be followed from top to bottom: they show the files of a project, and work on it."""


@pytest.mark.slow
@pytest.mark.parametrize("page", WALKS, ids=lambda p: p.name)
def test_walks_lead_to_the_end(page, tmp_path):
    folder = tmp_path
    for file, text in walk(page):
        if file != "$":
            assert (folder / file).is_file(), f"{file} is there already, and is replaced"
            (folder / file).write_text(text)
            continue
        program, *arguments = shlex.split(text)
        if program == "cd":
            folder /= arguments[0]
        elif program == "pip":  # the folder on the path does as well
            assert arguments == ["install", "-e", ".[test]"]
        else:
            done = subprocess.run(
                [Path(sys.executable).with_name(program), *arguments],
                cwd=folder,
                env={**os.environ, "PYTHONPATH": str(folder)},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=1800,
            )
            assert done.returncode == 0, f"{text}\n{done.stdout}"
    for arguments in (["check"], ["format", "--check"]):
        done = subprocess.run(
            [Path(sys.executable).with_name("ruff"), *arguments, "--no-cache", folder],
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
    for core in folder.rglob("*.sv"):
        formatted = toolchain.run(["verible-verilog-format", "--column_limit=110", str(core)])
        assert formatted == core.read_text()


def test_every_script_has_a_heading():
    assert [script for _, script in SCRIPTS] == blocks(INTEGRATIONS, "python")


@pytest.mark.parametrize(
    ("library", "script"),
    [
        # The tests of that bridge learn the same.
        pytest.param(library, script, marks=pytest.mark.exhaustive if library == "BenchMARL" else ())
        for library, script in SCRIPTS
    ],
    ids=[library for library, _ in SCRIPTS],
)
def test_scripts_with_other_libraries_run(library, script, tmp_path):
    """Each on its own, where what it imports is installed."""
    for module in set(re.findall(r"^(?:import|from) (\w+)", script, re.MULTILINE)):
        if module == "ray":  # which may be installed without RLlib
            reason = "RLlib is not installed: make test-rllib runs this with it"
            pytest.importorskip("ray.rllib", reason=reason, exc_type=ImportError)
        elif importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed")
    program = tmp_path / "script.py"
    program.write_text(script)
    command = [sys.executable, program]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


SESSIONS = [
    (page, block)
    for page in PAGES
    for block in blocks(page, "console")
    if " &\n" in block or "pearl train" in block
]
"""Commands of which later ones use what an earlier one serves in the background, or has made."""

OF_SEVERAL_PROCESSES = (" &\n", "--shards")
"""What is in sessions whose commands are started as users start them. The others run in this process, which
has imported most of it already."""


@pytest.mark.parametrize(("page", "block"), SESSIONS, ids=[page.name for page, _ in SESSIONS])
def test_sessions_run(page, block, tmp_path, pearl, monkeypatch):
    monkeypatch.chdir(tmp_path)
    several = any(words in block for words in OF_SEVERAL_PROCESSES)
    background = []
    program_file = Path(sys.executable).with_name("pearl")
    try:
        for line in block.splitlines():
            program, *arguments = shlex.split(line.removeprefix("$ ").removesuffix(" &"))
            assert program == "pearl"
            if line.endswith(" &"):
                process = subprocess.Popen([program_file, *arguments], stdout=subprocess.PIPE, text=True)
                background.append(process)
                assert process.stdout.readline(), "it says that it is ready"
            elif several:
                done = subprocess.run(
                    [program_file, *arguments], capture_output=True, text=True, timeout=1800
                )
                assert done.returncode == 0, done.stderr
            else:
                status, _, stderr = pearl(*arguments)
                assert status == 0, stderr
    finally:
        for process in background:
            process.terminate()
            assert process.wait() == 0


LONG = (
    "pearl bench --all --n-agents 1024 --rounds 1 --seconds 0.01",  # each environment as one is, below
    "pearl bench LevelBasedForaging --training --quick",  # the benchmark's own tests do so
    "python -m pearl_marl.experiments.sb3_training CartPole --algo ppo --n-agents 256 --steps 20000 "
    "--every 8192 --source envpool",
)
"""Commands that repeat others; `make test-exhaustive` has them, too."""

COMMANDS = [
    pytest.param(page, command, output, marks=pytest.mark.exhaustive if command in LONG else (), id=command)
    for page in PAGES
    if page not in WALKS
    for block in blocks(page, "console")
    if (page, block) not in SESSIONS
    for command, output in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block, re.MULTILINE)
]


@pytest.mark.parametrize(("page", "command", "output"), COMMANDS)
def test_commands_run(page, command, output, tmp_path, pearl, monkeypatch):
    """A command succeeds; where the page shows its output, it prints that."""
    program, *arguments = shlex.split(command)
    if program == "python":
        whole = [sys.executable, *arguments]
        done = subprocess.run(whole, cwd=tmp_path, capture_output=True, text=True, timeout=1800)
        status, stderr = done.returncode, done.stderr
    else:
        assert program == "pearl"
        monkeypatch.chdir(tmp_path)
        status, _, stderr = pearl(*arguments)
    if output:
        assert status == 2
        assert " ".join(stderr.split()) == " ".join(output.split())
    else:
        assert status == 0, stderr


def test_long_commands_are_in_the_pages():
    commands = {
        command for page in PAGES for block in blocks(page, "console") for command in block.splitlines()
    }
    assert {f"$ {command}" for command in LONG} <= commands


def test_the_core_of_ones_own_is_the_one_that_is_tested():
    """On the bench of all cores, in simulated devices and in the latency model."""
    page, files = ROOT / "docs" / "own_core.md", ROOT / "tests" / "rtl" / "shift_add"
    assert blocks(page, "python") == [(files / "__init__.py").read_text()]
    assert blocks(page, "systemverilog") == [(files / "shift_add_pe.sv").read_text()]


def test_make_targets_exist():
    named = {page: re.findall(r"^make ([\w-]+)", page.read_text(), re.MULTILINE) for page in PAGES}
    assert named[ROOT / "README.md"] == ["demo", "test"]
    for target in set().union(*named.values()):
        subprocess.run(["make", "--dry-run", target], cwd=ROOT, check=True, capture_output=True)


def test_links_lead_somewhere():
    for page in PAGES:
        for target, heading in re.findall(r"\]\(([^)#]*)(?:#([^)]+))?\)", page.read_text()):
            if target.startswith("http"):
                continue
            there = page.parent / target if target else page
            assert there.exists(), f"{page.name} links to {target}"
            if heading:
                headings = re.findall(r"^#+ (.*)$", there.read_text(), re.MULTILINE)
                names = {re.sub(r"[^\w -]", "", name).lower().replace(" ", "-") for name in headings}
                assert heading in names, f"{page.name} links to {target}#{heading}"


def test_the_demo_learns(tmp_path):
    """The experiment of `make demo`, at a smaller size."""
    script = ROOT / "experiments" / "cliff_walking_q_learning.py"
    arguments = ["--n-agents", "2000", "--steps", "200", "--out", str(tmp_path)]
    done = subprocess.run([sys.executable, script, *arguments], capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Optimal return of -13" in done.stdout
    assert (tmp_path / "learning_curve.png").stat().st_size > 10_000
