"""``pearl new --from``: packages after somebody else's environment; and ``pearl verify --against``."""

from __future__ import annotations

import importlib
import json
import linecache
import re
import runpy
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any
from unittest import mock

import gymnasium
import numpy as np
import pytest

import pearl_marl
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference
from pearl_marl.porting import Original, against, attributes, finite, first_wrong_transition

from . import test_new

pearl, registry = test_new.pearl, test_new.registry

HERE = "tests.cli.originals"

pytestmark = pytest.mark.usefixtures("registry")


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attributes, "EPISODES", 8)
    monkeypatch.setattr(against, "EPISODES", 5)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # a change within a second would not be seen


def made(pearl: Any, monkeypatch: pytest.MonkeyPatch, name: str, original: str, *more: str) -> Path:
    """Write a package, and put it where it can be imported."""
    status, _, err = pearl("new", name, "--from", original, *more)
    assert status == 0, err
    folder = Path(name.lower()).absolute()
    monkeypatch.syspath_prepend(folder)
    return folder


FINITE = {
    "FrozenLake-v1": (),
    "CliffWalking-v1": (),
    "Taxi-v4": (),
    "Taxi-v4 in the rain": ("--option", "is_rainy=true"),
    f"{HERE}:Corridor": (),
}


@pytest.mark.parametrize("original", FINITE)
def test_of_a_finite_one_every_transition_is_made(
    pearl: Any, monkeypatch: pytest.MonkeyPatch, original: str
) -> None:
    source, options = original.partition(" ")[0], FINITE[original]
    made(pearl, monkeypatch, "Found", source, *options)
    spec = pearl_marl.get_spec("found:Found")
    other = Original(source, **({"is_rainy": True} if options else {}))
    assert first_wrong_transition(spec, other) is None
    if original != f"{HERE}:Corridor":  # a compilation takes seconds
        return
    env = pearl_marl.make_vec("found:Found", 50)
    obs, _ = env.reset(seed=0)
    for _ in range(5):
        assert all(spec.observation_space.contains(row) for row in obs)
        obs = env.step(np.arange(50) % int(spec.action_space.n))[0]  # type: ignore[union-attr, arg-type]
    env.close()


def test_tables_do_what_p_says(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Said a second time, for FrozenLake: a draw of each third gives one of the three outcomes."""
    made(pearl, monkeypatch, "Found", "FrozenLake-v1")
    spec = pearl_marl.get_spec("found:Found")
    assert spec.rewards is not None
    table = gymnasium.make("FrozenLake-v1").unwrapped.P  # type: ignore[attr-defined]
    draws = np.array([0, 2**32 // 3 - 1, 2**32 // 3, 2**33 // 3, 2**33 // 3 + 1, 2**32 - 1], np.uint32)
    for state in range(16):
        for action in range(4):
            after, category, ends = call_reference(spec.positional.step, (state, action, draws))
            rewards = np.take(spec.rewards, category)
            found = sorted(zip(after.tolist(), rewards.tolist(), map(bool, ends), strict=True))
            listed = [tuple(outcome[1:]) for outcome in table[state][action]]
            assert found[:: 2 if len(listed) == 3 else 6] == sorted(listed)


def test_what_was_made_is_told(pearl: Any, tmp_path: Path) -> None:
    status, out, _ = pearl("new", "Ice", "--from", "FrozenLake-v1")
    assert status == 0
    assert "All 16 states of FrozenLake-v1 with their transitions are in tables, with 3 outcomes" in out
    assert "pearl verify ice:Ice --against FrozenLake-v1" in out
    files = {
        str(path.relative_to(tmp_path / "ice")) for path in (tmp_path / "ice").rglob("*") if path.is_file()
    }
    modules = {f"ice/{name}.py" for name in ("__init__", "spec", "step", "tables")}
    assert files == modules | {"README.md", "pyproject.toml", "tests/test_ice.py"}
    status, out, _ = pearl("new", "Wet", "--from", "Taxi-v4", "--option", "is_rainy=true", "--json")
    told = json.loads(out)
    assert (status, told["whole"], told["why"]) == (0, True, None)
    assert "wet/tables.npz" in told["files"]
    against = "pearl verify wet:Wet --against Taxi-v4 --original-option is_rainy=True\n"
    assert against in (tmp_path / "wet" / "README.md").read_text()
    assert '"wet" = ["tables.npz"]' in (tmp_path / "wet" / "pyproject.toml").read_text()


def test_a_wrong_table_is_seen(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = made(pearl, monkeypatch, "Found", "FrozenLake-v1")
    path = folder / "found" / "tables.py"
    path.write_text(path.read_text().replace("    0, 0, 4, 0, 4, 1,", "    0, 0, 4, 0, 5, 1,", 1))
    wrong = first_wrong_transition(pearl_marl.get_spec("found:Found"), Original("FrozenLake-v1"))
    assert wrong is not None
    assert wrong.startswith(
        "state 0, action 1: to 4 and 0.0 and False has probability 0, the original's is 0.33"
    )


def test_a_p_that_the_step_does_not_follow_is_refused() -> None:
    with pytest.raises(finite.NotFiniteError, match="which its P does not list"):
        finite.finite(Original("Taxi-v4", fickle_passenger=True, fickle_probability=1.0))


@pytest.mark.parametrize(
    ("original", "words"),
    [
        ("NoSuch-v1", "Gymnasium has no environment 'NoSuch-v1'"),
        ("no_such_module:Env", "there is no module 'no_such_module' for 'no_such_module:Env'; install"),
        (f"{HERE}:Corr", "has no class 'Corr'; there are Ball, Broken, Corridor, "),
        (f"{HERE}:Named", "cannot be made without title: give --option title=VALUE"),
        (f"{HERE}:Broken", "cannot be made: RuntimeError: no display"),
        (f"{HERE}:Dicts", "the observation space is Dict('cell': Discrete(7)); a Dict is not taken, as"),
        (f"{HERE}:Many", "the action space is MultiDiscrete([2 2], start=[1 1]); taken are Discrete, Multi"),
        (f"{HERE}:np", "has no class 'np'"),
        ("json:dumps", "json:dumps cannot be made without obj"),
        ("collections:Counter", "makes a Counter; it must be an environment of Gymnasium"),
        (":X", "is neither 'package.module:Class' nor an id"),
    ],
)
def test_refused_originals(pearl: Any, tmp_path: Path, original: str, words: str) -> None:
    status, out, err = pearl("new", "Found", "--from", original)
    assert (status, out, list(tmp_path.iterdir())) == (2, "", [])
    assert words in err
    assert err.count("\n") == 1


def test_refused_options(pearl: Any) -> None:
    assert "it has length" in pearl("new", "Found", "--from", f"{HERE}:Corridor", "--option", "size=3")[2]
    assert "give one" in pearl("new", "Found", "--rules")[2]
    assert "--agents is for" in pearl("new", "Found", "--from", "FrozenLake-v1", "--agents", "2")[2]
    assert "--against compares" in pearl("verify", "CliffWalking", "--against", "X-v1", "--device", "rtl")[2]
    assert "they must be the same" in pearl("verify", "CliffWalking", "--against", "FrozenLake-v1")[2]


def test_too_many_states_make_a_skeleton(pearl: Any, tmp_path: Path) -> None:
    with mock.patch.object(finite, "MOST_STATES", 50):
        status, out, _ = pearl("new", "Found", "--from", f"{HERE}:Endless")
    assert status == 0
    assert (
        "it has too many states for tables: 50 were found before giving up; the skeleton was written" in out
    )
    page = (tmp_path / "found" / "PORTING.md").read_text()
    assert "it has too many states for tables: 50 were found before giving up." in page
    assert "| `total` | `total: Range[0, " in page


# ---- What is filled in ----

GARDEN = {
    "initial()": "return State(bed=draws.below(3), beds=[0, 0, 0])",
    "step()": """rains = draws.chance(0.25)
    beds = [min(bed + rains, 9) for bed in state.beds]
    place = state.bed
    if action == 2:
        beds[place] = 0
    else:
        place = (place + action + 1) % 3
    wild = max(beds) >= 9
    return State(place, beds), 2 if wild else action == 2, wild""",
    "observe()": "return (*state.beds, state.bed)",
}

MEETING = {
    "initial()": "return State(places=[0, 9])",
    "step()": """left, right = state.places[0] + actions[0], state.places[1] - actions[1]
    met = left >= right
    return State([min(left, 9), max(right, 0)]), [2 if met else action for action in actions], [met, met]""",
    "observe()": "return state.places[agent]",
}


CHECKS = ("wrong_state", "wrong_pose", "wrong_start", "wrong_observation", "wrong_step")

BALL = {
    "initial()": "return State(place=draws.uniform(-1, 1), speed=0.0)",
    "step()": """speed = 0.9 * state.speed + 0.1 * (action - 1)
    place = state.place + speed
    return State(place, speed), 0, abs(place) > 4""",
    "observe()": "return View([state.place, state.speed])",
}

HILL = {
    "initial()": "return State([draws.uniform(-0.6, -0.4), 0.0])",
    "step()": """position, velocity = state.state
    velocity += min(max(action, -1.0), 1.0) * 0.0015 - 0.0025 * np.cos(3 * position)
    velocity = min(max(velocity, -0.07), 0.07)
    position = min(max(position + velocity, -1.2), 0.6)
    if position == -1.2 and velocity < 0:
        velocity = 0.0
    arrived = position >= 0.45 and velocity >= 0
    return State([position, velocity]), (100.0 if arrived else 0.0) - action**2 * 0.1, arrived""",
    "observe()": "return View(state.state)",
}

LAMPS = {
    "initial()": "return State([draws.bits(1) for _ in range(4)])",
    "step()": """lamp, lights = action
    state.lit[lamp] = lights
    return state, 0, all(state.lit)""",
    "observe()": "return tuple(state.lit)",
}


def fill(folder: Path, functions: dict[str, str]) -> None:
    path = folder / folder.name / "step.py"
    lines = path.read_text().splitlines()
    for name, body in functions.items():
        (k,) = (k for k, line in enumerate(lines) if f'NotImplementedError("{name}' in line)
        lines[k] = f"    {body}"
    path.write_text("\n".join(lines) + "\n")


def parts(folder: Path) -> Any:
    """Return what the package's own tests call."""
    linecache.clearcache()
    for name in [name for name in sys.modules if name.partition(".")[0] == folder.name]:
        del sys.modules[name]
    with warnings.catch_warnings(action="ignore"):
        return runpy.run_path(str(folder / "tests" / f"test_{folder.name}.py"))["PORT"]


def wrong(folder: Path, check: str) -> str | None:
    """Return what a check says of a package as it is now; that of steps takes the spec."""
    port = parts(folder)
    if check == "wrong_step":
        return port.wrong_step(importlib.import_module(f"{folder.name}.spec").SPEC)  # type: ignore[no-any-return]
    return getattr(port, check)()  # type: ignore[no-any-return]


def test_a_skeleton_says_what_is_to_be_written(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = made(pearl, monkeypatch, "Plot", f"{HERE}:Garden")
    with pytest.warns(UserWarning, match=r"Plot is not registered yet: .*initial\(\) is still to be written"):
        __import__("plot")
    port = parts(folder)
    assert port.wrong_state() is None
    assert port.wrong_pose() is None
    for part in (port.wrong_start, port.wrong_observation):
        with pytest.raises(NotImplementedError, match=r"is still to be written: see PORTING.md, part"):
            part()
    with pytest.raises(ArgumentError, match=r"is still to be written: see PORTING.md, part"):
        wrong(folder, "wrong_step")
    text = (folder / "plot" / "step.py").read_text()
    assert "    beds: Array[Range[0, 9], 3]  # seen 0 to 9\n" in text
    assert "    # weather: one of 'dry', 'wet'\n" in text
    written = [path.read_text() for path in folder.rglob("*") if path.suffix in (".py", ".md")]
    assert re.findall(r"@\w+@", "".join(written)) == []


BREAKS = {
    "wrong_start": ("draws.below(3)", "draws.below(2)", "episodes begin in (bed "),
    "wrong_observation": (
        "*state.beds, state",
        "*state.beds[:2], 0, state",
        "element 2 of the observation is 0, the",
    ),
    "wrong_step": ("beds[place] = 0", "beds[0] = 0", " has a share of "),
    "wrong_step of no draws": (
        "draws.chance(0.25)",
        "0",
        "the original comes to different states at random, and step() draws nothing",
    ),
    "wrong_state": (
        "beds: Array[Range[0, 9], 3]",
        "beds: Array[Bits[2], 3]",
        " is 4, and its field holds 0 to 3",
    ),
}


def test_a_filled_skeleton(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = made(pearl, monkeypatch, "Plot", f"{HERE}:Garden")
    fill(folder, GARDEN)
    assert [wrong(folder, check) for check in CHECKS] == [None] * 5
    status, out, err = pearl("verify", "plot:Plot", "--against", f"{HERE}:Garden", "--steps", 40)
    assert status == 0, err
    assert "Equal in 40 steps." in out
    assert "Returns of a random policy: " in out
    path = folder / "plot" / "step.py"
    right = path.read_text().replace("import Array, Range", "import Array, Bits, Range")
    for check, (old, new, words) in BREAKS.items():
        assert right.count(old) == 1
        path.write_text(right.replace(old, new))
        told = wrong(folder, check.split()[0])
        assert told is not None
        assert words in told, told
    path.write_text(right)


def test_an_attribute_that_is_missing_is_seen(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = made(pearl, monkeypatch, "Plot", f"{HERE}:Garden")
    for name, line in (
        ("step", "    bed: "),
        ("original", "        bed="),
        ("original", "    env.gar"),
    ):
        path = folder / "plot" / f"{name}.py"
        kept = [text for text in path.read_text().splitlines() if not text.startswith(line)]
        path.write_text("\n".join(kept) + "\n")
    told = wrong(folder, "wrong_pose")
    assert told is not None
    assert "posed, the original goes on otherwise after actions" in told


def test_a_world_of_several_agents(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = made(pearl, monkeypatch, "Pair", f"{HERE}:Meeting")
    fill(folder, MEETING)
    checks = [check for check in CHECKS if check != "wrong_pose"]
    assert [wrong(folder, check) for check in checks] == [None] * 4
    status, out, err = pearl("verify", "pair:Pair", "--against", f"{HERE}:Meeting", "--steps", 50)
    assert (status, "Equal in 50 steps." in out) == (0, True), out + err


def test_reals(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = made(pearl, monkeypatch, "Ball", f"{HERE}:Ball")
    path = folder / "ball" / "step.py"
    text = path.read_text()
    assert "    place: Real[-5, 5]  # real, seen -" in text
    assert "    speed: Real[-1, 1]  # real, seen -" in text
    assert "    elements: Array[Real[-50, 50], 2]\n" in text
    fill(folder, BALL)
    assert [wrong(folder, check) for check in CHECKS] == [None] * 5
    status, out, err = pearl("verify", "ball:Ball", "--against", f"{HERE}:Ball", "--steps", 100, "--json")
    assert status == 0, err
    errors = {(error["name"], error["states"]): error for error in json.loads(out)["errors"]}
    for states in ("reached", "random"):
        assert errors["reward", states]["most"] == 0
        for name in ("elements_0", "elements_1"):
            assert 0 < errors[name, states]["mean"] <= errors[name, states]["most"] < 4e-6  # float32
    right = path.read_text()
    path.write_text(right.replace("place: Real[-5, 5]", "place: Real[-2, 2]"))
    told = wrong(folder, "wrong_state")
    assert told is not None
    assert "and its field holds -2 to 2" in told
    path.write_text(right.replace("0.9 *", "0.8999 *"))
    told = wrong(folder, "wrong_step")
    assert told is not None
    assert "is " in told
    assert ", the original's " in told


def test_an_action_in_a_box_and_a_real_reward(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = made(pearl, monkeypatch, "Hill", "MountainCarContinuous-v0")
    fill(folder, HILL)
    path = folder / "hill" / "step.py"
    text = path.read_text().replace("from typing", "import numpy as np\nfrom typing")
    path.write_text(text.replace("state: Array[Real[-1, 1]", "state: Array[Real[-2, 2]"))
    path = folder / "hill" / "spec.py"
    path.write_text(re.sub(r"reward=Real\[.*\]", "reward=Real[-0.1, 100]", path.read_text()))
    assert [wrong(folder, check) for check in CHECKS] == [None] * 5
    assert pearl_marl.get_spec("hill:Hill").reward.high == 100
    arguments = ("--against", "MountainCarContinuous-v0", "--steps", 60, "--json")
    status, out, err = pearl("verify", "hill:Hill", *arguments)
    assert status == 0, err
    assert all(error["most"] < 1e-6 for error in json.loads(out)["errors"])


def test_an_action_of_several_fields(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = made(pearl, monkeypatch, "Lamps", f"{HERE}:Lamps")
    assert "It is a tuple of 2 integers. " in (folder / "PORTING.md").read_text()
    fill(folder, LAMPS)
    assert [wrong(folder, check) for check in CHECKS] == [None] * 5
    status, out, err = pearl("verify", "lamps:Lamps", "--against", f"{HERE}:Lamps", "--steps", 60)
    assert (status, "Equal in 60 steps." in out) == (0, True), out + err
    path = folder / "lamps" / "step.py"
    path.write_text(path.read_text().replace("[lamp] = lights", "[0] = lights"))
    told = wrong(folder, "wrong_step")
    assert told is not None
    assert "lit_" in told


@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        ((), 0, "Equal in 300 steps."),
        (("--original-option", "is_slippery=true"), 1, "It differs. from row=3, column=0 after "),
        (("--option", "is_slippery=true", "--original-option", "is_slippery=false"), 1, "has a share of "),
        (("--option", "is_slippery=true", "--steps", 20), 0, "Equal in 20 steps."),
    ],
)
def test_against_an_original(pearl: Any, options: tuple[Any, ...], status: int, words: str) -> None:
    result = pearl("verify", "CliffWalking", "--against", "CliffWalking-v1", *options)
    assert (result[0], words in result[1]) == (status, True), result


def test_what_is_written_is_formatted(pearl: Any, tmp_path: Path) -> None:
    """As ruff has it: the code is the user's to go on with."""
    for name, original in (
        ("Ice", "FrozenLake-v1"),
        ("Hall", f"{HERE}:Corridor"),
        ("Pole", "CartPole-v1"),
        ("Swing", "Pendulum-v1"),
        ("Jack", "Acrobot-v1"),
        ("Hill", "MountainCarContinuous-v0"),
        ("Lamps", f"{HERE}:Lamps"),
        ("Pair", f"{HERE}:Meeting"),
    ):
        assert pearl("new", name, "--from", original)[0] == 0
    for command in (("check", "--no-cache"), ("format", "--diff", "--no-cache")):
        done = subprocess.run(
            [str(Path(sys.executable).with_name("ruff")), *command, "."],
            capture_output=True,
            text=True,
            cwd=tmp_path,
        )
        assert done.returncode == 0, done.stdout


@pytest.mark.exhaustive  # tests/rtl/test_cores.py has cores of all kinds of functions
def test_made_of_an_original_hardware_is_exact(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made(pearl, monkeypatch, "Ice", "FrozenLake-v1")
    status, out, err = pearl("verify", "ice:Ice", "--device", "rtl", "--steps", 20, "--n-agents", 70)
    assert status == 0, err
    assert "rtl is bit-exact with reference over 1,400 agent-steps" in out
