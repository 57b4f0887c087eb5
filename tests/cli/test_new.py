"""``pearl new``, and environments that live in a package of their own."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from copy import copy
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

import pearl_marl
from pearl_marl import cli
from pearl_marl.devices import BatchConfig, Lockstep
from pearl_marl.devices.replay import checksum
from pearl_marl.envs import _specs
from pearl_marl.errors import ArgumentError, LockstepError
from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.testing import trajectory

from ..devices.broken import Flips

ROOT = Path(__file__).parents[2]
LONG = "AutonomousWarehouseRobot"
FILES = ["README.md", "pyproject.toml", "{0}/__init__.py", "{0}/spec.py", "{0}/step.py"]


@pytest.fixture
def pearl(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., tuple[int, str, str]]:
    """Call the command line in this process, in an empty folder; return status and both outputs."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: Any) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["pearl", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit_:
            cli.main()
        captured = capsys.readouterr()
        return int(exit_.value.code or 0), captured.out, captured.err

    return call


@pytest.fixture
def registry(tmp_path: Path) -> Iterator[None]:
    """Forget what a test registers and imports from its folder."""
    with mock.patch.dict(_specs):
        yield
    forget(tmp_path)


def forget(folder: Path) -> None:
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None)).startswith(str(folder)):
            del sys.modules[name]


def test_files(pearl: Any, tmp_path: Path) -> None:
    status, out, _ = pearl("new", "TwoRooms", "--out", "some/where")
    assert status == 0
    folder = tmp_path / "some" / "where" / "two_rooms"
    expected = {*(name.format("two_rooms") for name in FILES), "tests/test_two_rooms.py"}
    found = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert found == expected
    for name in expected:
        assert name in out
        text = (folder / name).read_text()
        assert "my_environment" not in text.lower().replace("-", "_")
        assert "myenvironment" not in text.lower()
    assert 'name = "two-rooms"' in (folder / "pyproject.toml").read_text()


def test_files_of_a_world(pearl: Any, tmp_path: Path) -> None:
    """The same, with a step of several agents."""
    assert pearl("new", "TwoRooms", "--agents", 12)[0] == 0
    folder = tmp_path / "two_rooms"
    found = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert found == {*(name.format("two_rooms") for name in FILES), "tests/test_two_rooms.py"}
    assert "AGENTS = 12\n" in (folder / "two_rooms" / "step.py").read_text()
    for name in found:
        text = (folder / name).read_text()
        assert "my_environment" not in text.lower().replace("-", "_")
        assert "myenvironment" not in text.lower()


@pytest.mark.parametrize("agents", [0, 64])
def test_so_many_agents_share_no_world(pearl: Any, agents: int) -> None:
    status, _, err = pearl("new", "TwoRooms", "--agents", agents)
    assert (status, err) == (2, f"pearl: --agents is {agents}; it must be an integer from 1 to 63\n")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("R" + 64 * "o", "has 65 letters; take 64 at most"),
        ("two_rooms", "'two_rooms': it takes letters and digits, a capital letter first"),
        ("twoRooms", "a capital letter first"),
        ("Two Rooms", "letters and digits"),
        ("../Rooms", "letters and digits"),
        ("CliffWalking", "there is an environment 'CliffWalking' already"),
        ("Cliffwalking", "there is an environment 'CliffWalking' already"),
        ("Queue", "'queue', which Python has a meaning for already"),
        ("Lambda", "'lambda', which Python has a meaning for already"),
        ("Tests", "the folder 'tests' holds the package's tests"),
        ("Numpy", "'numpy', which Python has a meaning for already"),
        ("Pearl", "the backbone has a module of its core's name, pearl_pe"),
        ("Taken", "taken exists already"),
        ("Gone", "gone exists already"),
    ],
)
def test_refused_names(pearl: Any, tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "gone").symlink_to("nothing")
    status, out, err = pearl("new", name)
    assert (status, out) == (2, "")
    assert words in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["gone", "taken"]


def test_half_a_package_does_not_stay(pearl: Any, tmp_path: Path) -> None:
    write = Path.write_bytes

    def until_full(path: Path, data: bytes) -> int:
        if path.name == "README.md":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, data)

    with mock.patch.object(Path, "write_bytes", until_full):
        status, _, err = pearl("new", "TwoRooms")
    assert (status, list(tmp_path.iterdir())) == (2, [])
    assert err.startswith("pearl: two_rooms cannot be written: No space left on device; make room for it, or")


def test_an_out_that_is_a_file_is_refused(pearl: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    status, _, err = pearl("new", "TwoRooms", "--out", "file")
    assert (status, "--out file is no folder" in err) == (2, True)


@pytest.mark.usefixtures("registry")
def test_a_name_with_its_module(pearl: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pearl("new", "TwoRooms")
    monkeypatch.syspath_prepend(tmp_path / "two_rooms")
    with pytest.raises(ArgumentError, match="there is no environment 'TwoRooms'"):
        pearl_marl.get_spec("TwoRooms")
    for name in ("two_rooms:TwoRooms", "two_rooms:two_rooms", "two_rooms.spec:TwoRooms", "TwoRooms"):
        assert pearl_marl.get_spec(name).id == "TwoRooms-v0"
    assert "TwoRooms" in pearl_marl.list_envs()
    assert len(pearl_marl.make_vec("two_rooms:TwoRooms", 3).reset(seed=0)[0]) == 3
    assert pearl("run", "two_rooms:TwoRooms", "--n-agents", 5, "--steps", 5)[0] == 0


@pytest.mark.usefixtures("registry")
def test_a_replay_is_given_the_environments_package(
    pearl: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And imports none that it names itself."""
    pearl("new", "TwoRooms")
    monkeypatch.syspath_prepend(tmp_path / "two_rooms")
    spec = pearl_marl.get_spec("two_rooms:TwoRooms")
    broken = Flips("rewards", tick=2, slot=3)
    lockstep = Lockstep(broken, "reference").open(BatchConfig(spec=spec, n_envs=5))
    lockstep.reset(seed=0)
    with pytest.raises(LockstepError) as caught:
        trajectory(lockstep, np.zeros((3, 5), np.uint8))
    file = tmp_path / "divergence.json"
    caught.value.replay.write(file)
    forget(tmp_path)
    _specs.pop("tworooms")
    value = {**json.loads(file.read_text()), "module": "two_rooms.spec"}
    file.write_text(json.dumps({**value, "checksum": checksum(value)}))
    for arguments in ((), ("--env", "CliffWalking")):
        status, out, err = pearl("verify", file, "--device", "native", *arguments)
        assert (status, out) == (2, "")
        assert "divergence.json: there is no environment 'TwoRooms'" in err
        assert "--env" in err
    assert "two_rooms" not in sys.modules
    status, out, err = pearl("verify", file, "--env", "two_rooms:TwoRooms")
    assert (status, "The divergence is gone" in out) == (2, False), out + err  # of the device, there is none
    status, out, err = pearl("verify", file, "--env", "CliffWalking", "--device", "native")
    assert (status, out) == (2, "")
    assert "--env is CliffWalking, and" in err
    status, out, err = pearl("verify", file, "--env", "two_rooms:TwoRooms", "--device", "native")
    assert status == 0, err
    assert "The divergence is gone" in out


@pytest.mark.usefixtures("registry")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no_such_module:Env", "there is no module 'no_such_module' for 'no_such_module:Env'; install"),
        ("json.no_such:Env", "there is no module 'json.no_such'"),
        ("json:CliffWaking", "module 'json' registers no environment 'CliffWaking'; did you mean"),
        ("json:Xyz", "module 'json' registers no environment 'Xyz'; there are "),
        (":CliffWalking", "':CliffWalking' names no module before its colon"),
        ("a b:CliffWalking", "names no module before its colon"),
        ("..json:CliffWalking", "names no module before its colon"),
        ("json:", "module 'json' registers no environment ''"),
    ],
)
def test_names_that_lead_nowhere(name: str, words: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        pearl_marl.get_spec(name)
    assert words in str(caught.value)


@pytest.mark.usefixtures("registry")
def test_a_module_that_fails_speaks_for_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "fails.py").write_text("import no_such_module\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        pearl_marl.get_spec("fails:Env")


@pytest.mark.usefixtures("registry")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1\ny = (", "line 2: SyntaxError: '(' was never closed"),
        ("import no_such_module", "line 1: ModuleNotFoundError: No module named 'no_such_module'"),
        ("import json\njson.loads('{')", "line 2: JSONDecodeError: Expecting property name"),
        (
            "from pearl_marl.spec import EnvSpec\n\nEnvSpec(max_steps=3)",
            "line 3: TypeError: EnvSpec.__init__() got an unexpected keyword argument 'max_steps'",
        ),
    ],
)
def test_a_module_that_fails_is_told_by_the_command_in_one_line(
    pearl: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, words: str
) -> None:
    (tmp_path / "fails.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    status, out, err = pearl("run", "fails:Env")
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert err.startswith(f"pearl: {tmp_path.name}/fails.py, {words}")


@pytest.mark.usefixtures("registry")
@pytest.mark.parametrize("inside", ["", "rooms"])
def test_a_package_at_hand_is_told_of(
    pearl: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, inside: str
) -> None:
    (tmp_path / "rooms").mkdir()
    (tmp_path / "rooms" / "__init__.py").write_text("")
    monkeypatch.chdir(tmp_path / inside)
    status, _, err = pearl("run", "rooms:Rooms")
    assert status == 2
    assert err.endswith(f"install the package (pip install -e .), or add {tmp_path} to PYTHONPATH\n")


@pytest.mark.usefixtures("registry")
def test_a_module_that_ends_python(pearl: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ends.py").write_text("import sys\nsys.exit(0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    status, out, err = pearl("run", "ends:Env")
    assert (status, out, err) == (2, "", "pearl: the module 'ends' ends Python when it is imported\n")


@pytest.mark.usefixtures("registry")
@pytest.mark.parametrize(
    ("name", "agents"),
    [
        ("Ab", 1),
        (LONG, 3),
        *(pytest.param(*both, marks=pytest.mark.exhaustive) for both in (("Ab", 3), (LONG, 1))),
    ],
)
def test_what_is_written_is_clean(
    pearl: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, agents: int
) -> None:
    """Whatever the length of the name."""
    pearl("new", name, "--agents", agents)
    (folder,) = tmp_path.iterdir()
    for arguments in (["check"], ["format", "--check"]):
        done = subprocess.run(
            [Path(sys.executable).with_name("ruff"), *arguments, "--no-cache", folder],
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
    monkeypatch.syspath_prepend(folder)
    for options in ({}, {"slip": 0}, {"slip": 7}):
        spec = pearl_marl.get_spec(f"{folder.name}:{name}").with_options(**options)
        assert spec.agents == agents
        for size in ((70, 4, 32), (1, 1, 32)):
            parameters = elaboration.top_parameters(Build.of(spec, *size))
            toolchain.run(
                [
                    *("verilator", "--lint-only", "-Wall", "--top-module", "pearl_top"),
                    *(f"-G{key}={value}" for key, value in parameters.items()),
                    *map(str, elaboration.sources(spec)),
                ]
            )


class Installed:
    """A virtual environment with this package's wheel, and the new environment's folder."""

    def __init__(self, folder: Path) -> None:
        self.python = folder / "venv" / "bin" / "python"
        self.project = folder / "two_rooms"
        tree = folder / "tree"
        listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
        for name in listed.stdout.split():
            if os.path.lexists(ROOT / name):
                (tree / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / name, tree / name, follow_symlinks=False)
        pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
        offline = ["--no-deps", "--no-index"]
        self._call(*pip, "wheel", *offline, "--no-build-isolation", "-w", folder, tree)
        self._call(sys.executable, "-m", "venv", "--without-pip", folder / "venv")
        (wheel,) = folder.glob("*.whl")
        self._call(*pip, "--python", self.python, "install", *offline, wheel)
        # What the package depends on is where NumPy is, but not its own sources.
        site = next((folder / "venv").glob("lib/python*/site-packages"))
        (site / "others.pth").write_text(f"{Path(np.__file__).parents[1]}\n")
        self._call(self.python.with_name("pearl"), "new", "TwoRooms", cwd=folder)

    def _call(self, *command: Any, **arguments: Any) -> None:
        subprocess.run(list(map(str, command)), check=True, **arguments)

    def run(self, *command: str, on_path: bool = True) -> tuple[int, str]:
        """Run a program of the virtual environment in the new folder; return its status and output."""
        unwanted = "PYTHONPATH", "PYTEST_ADDOPTS"
        environment = {name: value for name, value in os.environ.items() if name not in unwanted}
        if on_path:
            environment["PYTHONPATH"] = str(self.project)
        done = subprocess.run(
            [self.python.with_name(command[0]), *command[1:]],
            cwd=self.project,
            env={**environment, "COLUMNS": "200"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        return done.returncode, done.stdout

    def pytest(self, *arguments: str) -> tuple[int, str]:
        return self.run("python", "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments, on_path=False)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    return Installed(tmp_path_factory.mktemp("installed"))


@pytest.mark.exhaustive  # the walk of docs/new_environment.md does so from a source tree
def test_the_new_package_passes_the_contract(installed: Installed) -> None:
    status, out = installed.run("python", "-c", "import pearl_marl; print(pearl_marl.__file__)")
    assert str(installed.python.parents[1]) in out, "it is the wheel that is tested"
    status, out = installed.pytest("-k", "not rtl")  # the world below is stepped there
    assert status == 0, out
    assert "test_two_rooms.py" not in out, "nothing failed, and nothing warned"
    status, out = installed.run(
        *("pearl", "verify", "two_rooms:TwoRooms", "--device", "rtl", "--n-agents", "70", "--steps", "80")
    )
    assert status == 0, out
    assert "rtl is bit-exact with reference over 5,600 agent-steps" in out


@pytest.mark.exhaustive  # the walk of docs/new_environment.md does so with an environment of one agent
def test_a_new_world_passes_the_contract_and_types_are_right(installed: Installed) -> None:
    folder = installed.project.parent / "worlds"
    status, out = installed.run("pearl", "new", "TwoHalls", "--agents", "3", "--out", str(folder))
    assert status == 0, out
    world = copy(installed)
    world.project = folder / "two_halls"
    status, out = world.pytest("-k", "native")  # docs/new_environment.md has all of it
    assert status == 0, out
    # The types of both packages at once, but not of libraries that an environment has nothing to do with:
    # those would take most of the time.
    settings, others = folder / "mypy.ini", "torch.*,scipy.*,matplotlib.*,PIL.*,rich.*,typer.*,optuna.*"
    settings.write_text(f"[mypy]\nstrict = True\n[mypy-{others}]\nfollow_imports = skip\n")
    command = ["python", "-m", "mypy", "--config-file", str(settings), ".", str(world.project)]
    status, out = installed.run(*command, on_path=False)
    assert status == 0, out


BREAKS = {
    # A word that does not fit its field, and a category that the table of rewards does not have.
    "width": (
        "min(max(state.cell + move, PIT), GOAL)",
        "state.cell + move",
        "step() returns -1 to 16 for cell",
    ),
    "reward": ("REACHED, FELL = 0, 1, 2", "REACHED, FELL = 0, 1, 3", "step() returns 0 to 3 for reward"),
    # A rule that is not the one that the tests tell.
    "rule": ("move = 1 if", "move = 2 if", "test_every_state_action_and_draw"),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", BREAKS)
def test_mistakes_are_caught(installed: Installed, what: str) -> None:
    right, wrong, words = BREAKS[what]
    path = installed.project / "two_rooms" / "step.py"
    text = path.read_text()
    assert text.count(right) == 1
    path.write_text(text.replace(right, wrong))
    try:
        status, out = installed.pytest("-k", "every_state")
    finally:
        path.write_text(text)
    assert status != 0
    assert words in out
