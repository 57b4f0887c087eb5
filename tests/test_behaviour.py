"""What tells golden functions apart, for hardware and saved states: what they do, and nothing else."""

from __future__ import annotations

import inspect
import json
import os
import pickle
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from gymnasium.spaces import Discrete

from pearl_marl.batch.saved_state import SavedState
from pearl_marl.devices import BatchConfig, Native, Rtl, Xdma
from pearl_marl.devices.simulator.model_build import library
from pearl_marl.envs import get_spec, names
from pearl_marl.errors import DeviceError, SavedStateError
from pearl_marl.experiments.environment_figures import facts, keep_fact, ours
from pearl_marl.golden import Draws, i16, u8, u32
from pearl_marl.golden.tracing.records import RULES
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.elaboration import env_hash
from pearl_marl.layout import Bits
from pearl_marl.spec import EnvSpec, Field, Golden

from . import sampling
from .devices.boards import served
from .rtl.programs import defined
from .toy_world import MEADOW, NIM

TABLE, ROWS, SCALE = (5, 6, 7, 8), ((1, 2), (3, 4)), 3


class State(NamedTuple):
    x: Bits[4]


def initial(draws: Draws) -> State:
    return State(draws.bits(4))


def step(state: State, action: Any, draws: Draws) -> Any:
    moved, draw = (state.x + action) & 15, draws.bits()
    flag = moved > 12 or TABLE[action] == 6
    seen = ROWS[moved & 1][action >> 1] + u8(draw) - i16(draw)
    return State(moved if flag else min(moved, 9)), (seen * SCALE) & 15, moved == 15


def observe(state: State) -> Any:
    return state.x


def masks(state: State) -> Any:
    return 1, 1, state.x < 8, 1


def shift(step: Any = step, **parts: Any) -> EnvSpec:
    golden = {"initial": initial, "observe": observe, "masks": masks}
    golden |= {name: parts.pop(name) for name in golden if name in parts}
    whole = {
        "name": "Shift",
        "version": 0,
        "summary": "A counter",
        "observation": (Field("x", 4),),
        "reward": Field("reward", 4),
        "rewards": None,
        "observation_space": Discrete(16),
        "action_space": Discrete(4),
        "golden": Golden(State, step=step, **golden),
    }
    return EnvSpec(**{**whole, **parts})


TEXT = inspect.getsource(step)


def written(old: str, new: str) -> Callable[..., Any]:
    """Return the step above with some of its text replaced."""
    assert old in TEXT
    text = TEXT.replace(old, new)
    scope: dict[str, Any] = {"State": State, "Draws": Draws, "Any": Any, "u8": u8, "u32": u32, "i16": i16}
    scope |= {"TABLE": TABLE, "ROWS": ROWS, "SCALE": SCALE}
    found: Callable[..., Any] = defined(text, scope, f"<a step with {new}>")["step"]
    return found


SAME = {
    "as it is written": ("moved", "moved"),
    "names of variables": ("moved", "where_it_goes"),
    "names of arguments": ("draws", "dice"),
    "a comment": ("    flag =", "    # whether it is over\n    flag ="),
    "another way to write it": ("moved > 12", "12 < moved"),
    "an expression of flags": ("moved > 12 or TABLE[action] == 6", "(moved > 12) | (TABLE[action] == 6)"),
    "terms in another order": ("state.x + action", "action + state.x"),
    "a branch": (
        "    return State(moved if flag else min(moved, 9)),",
        "    if not flag:\n        x = min(moved, 9)\n    else:\n        x = moved\n    return State(x),",
    ),
    "a helper": ("(state.x + action) & 15", "(lambda a, b: (a + b) & 15)(state.x, action)"),
}
OTHER = {
    "a factor": ("state.x + action", "state.x + 2 * action"),
    "a sign": ("state.x + action", "state.x - action"),
    "terms of a difference": ("u8(draw) - i16(draw)", "i16(draw) - u8(draw)"),
    "a constant": ("moved > 12", "moved > 11"),
    "a comparison": ("moved > 12", "moved >= 12"),
    "its sides": ("moved > 12", "12 > moved"),
    "an equality": ("moved == 15", "moved != 15"),
    "a table": ("TABLE[action]", "(lambda t: t)(TABLE)[3 - action]"),
    "an operation": (" or ", " and "),
    "a choice": ("moved if flag", "draw >> 28 if flag"),
    "a minimum": ("min(", "max("),
    "both ends": ("min(moved, 9)", "min(max(moved, 1), 9)"),
    "a width": ("u8(draw)", "u32(draw)"),
    "a shift": ("action >> 1", "1 - (action >> 1)"),
    "one draw": ("u8(draw)", "u8(draw >> 1)"),
}
PARTS: dict[str, dict[str, Any]] = {
    "the start": {"initial": lambda draws: State(draws.bits(3))},
    "a constant start": {"initial": lambda draws: State(3)},
    "a draw that is not needed": {"initial": lambda draws: State(draws.bits() & 0 | 3)},
    "what is seen": {"observe": lambda state: 15 - state.x},
    "a mask": {"masks": lambda state: (1, 1, state.x < 9, 1)},
    "no masks": {"masks": None},
    "a wider observation": {"observation": (Field("x", 5),)},
    "a wider reward": {"reward": Field("reward", 5)},
    "a reward's scale": {"reward": Field("reward", 4, fraction=1)},
    "a table of rewards": {"rewards": tuple(float(k) for k in range(16))},
    "a draw more": {"initial": lambda draws: State(max(draws.bits(4), 0 * draws.bits()))},
}


@pytest.mark.parametrize("change", SAME)
def test_what_changes_nothing_is_the_same(change: str) -> None:
    assert shift(written(*SAME[change])).behaviour == shift().behaviour


def test_what_does_something_else_is_another() -> None:
    found = {"as it is": shift().behaviour}
    found |= {change: shift(written(*OTHER[change])).behaviour for change in OTHER}
    found |= {change: shift(**PARTS[change]).behaviour for change in PARTS}
    for name, value in {"TABLE": (5, 6, 7, 9), "ROWS": ((1, 2), (3, 5)), "SCALE": 4}.items():
        changed = written("moved", "moved")
        changed.__globals__[name] = value
        found[name] = shift(changed).behaviour
    rewards = [float(k) for k in range(15)]
    found["a reward"] = shift(rewards=(*rewards, 15.5)).behaviour
    assert len(set(found.values())) == len(found), found


def test_options_are_in_it_by_what_they_do() -> None:
    cliff = get_spec("CliffWalking")
    assert cliff.with_options(is_slippery=True).behaviour != cliff.behaviour
    assert replace(cliff, options={"told": object()}).behaviour == cliff.behaviour


@pytest.mark.parametrize("spec", [MEADOW, NIM], ids=["Meadow", "Nim"])
def test_each_agent_of_a_world_counts(spec: EnvSpec) -> None:
    observe, last = spec.golden.observe, spec.agents - 1

    def other(state: Any, agent: int) -> Any:
        first, *rest = observe(state, agent)
        return (1 - (first & 1), *rest) if agent == last else (first, *rest)

    changed = replace(spec, golden=spec.golden._replace(observe=other))
    assert changed.behaviour != spec.behaviour


KNOWN = {name: facts(name)["behaviour"] for name in ours()}
"""As of all environments under the compiler's rules of now: boards are built with these. ``python -m
tests.test_behaviour`` writes them anew. Where the functions are what they were, the compiler has changed:
then count ``pearl_marl.golden.tracing.records.RULES`` up, so that saved states load all the same."""


def behaviours(of: Iterable[str]) -> dict[str, str]:
    return {name: get_spec(name).behaviour for name in of}


def test_those_of_known_environments_stay() -> None:
    assert {name: get_spec(name).behaviour for name in KNOWN} == KNOWN
    assert KNOWN.keys() >= set(names()) - {"Meadow", "Nim"}


@pytest.mark.parametrize("seed", ["0", pytest.param("12345", marks=pytest.mark.exhaustive)])
def test_they_are_the_same_in_every_process(seed: str) -> None:
    few = names() if sampling.exhaustive else sampling.KINDS
    program = f"from tests.test_behaviour import behaviours; print(behaviours({few}))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONHASHSEED": seed},
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=True,
    )
    assert eval(done.stdout) == {name: KNOWN[name] for name in few}


def test_an_environment_is_made_without_it() -> None:
    spec = replace(get_spec("Taxi"))
    Native().open(BatchConfig(spec=spec, n_envs=2)).close()
    assert "behaviour" not in vars(spec)


def test_it_is_not_pickled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pickled field by field, a spec takes its functions by name, and these may have changed meanwhile."""
    spec = shift()
    before = spec.behaviour
    content = pickle.dumps(spec)
    changed = written("moved > 12", "moved > 11")
    changed.__module__ = __name__
    monkeypatch.setattr(sys.modules[__name__], "step", changed)
    assert pickle.loads(content).behaviour == shift(changed).behaviour != before


OLD, NEW, N = shift(), shift(written("state.x + action", "state.x + 2 * action")), 7
REFUSED = (
    rf"has env_hash {env_hash(OLD):#x}, this batch needs {env_hash(NEW):#x}: it is built for another "
    r"environment, or one with other options or golden functions, not for Shift-v0: .* build it anew"
)


def test_a_board_with_old_golden_functions_is_refused(tmp_path: Path) -> None:
    with served(tmp_path, OLD, N, 4, 32):
        with pytest.raises(DeviceError, match=REFUSED):
            Xdma(tmp_path).open(BatchConfig(spec=NEW, n_envs=N))
        Xdma(tmp_path).open(BatchConfig(spec=OLD, n_envs=N)).close()


def test_a_simulated_device_with_old_golden_functions_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    built = library(Build.of(OLD, N, 4, 32))
    monkeypatch.setattr("pearl_marl.devices.rtl.library", lambda *_, **__: built)
    with pytest.raises(DeviceError, match=REFUSED):
        Rtl(4, 32).open(BatchConfig(spec=NEW, n_envs=N))
    Rtl(4, 32).open(BatchConfig(spec=OLD, n_envs=N)).close()


def test_a_known_environment_with_other_functions_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    cliff = get_spec("CliffWalking")
    step = cliff.golden.step

    def other(state: Any, action: Any, draws: Draws) -> Any:
        after, reward, terminated = step(state, action, draws)
        return after, reward, terminated and after.row < 3

    built = library(Build.of(cliff, 7, 4, 32))
    monkeypatch.setattr("pearl_marl.devices.rtl.library", lambda *_, **__: built)
    changed = replace(cliff, golden=cliff.golden._replace(step=other))
    with pytest.raises(DeviceError, match=r"for CliffWalking-v0 with other golden functions, not for CliffW"):
        Rtl(4, 32).open(BatchConfig(spec=changed, n_envs=7))


def snapshot(spec: EnvSpec) -> tuple[BatchConfig, bytes]:
    device = Native().open(config := BatchConfig(spec=spec, n_envs=N))
    device.reset(seed=0)
    saved = device.snapshot().to_bytes()
    device.close()
    return config, saved


def test_a_saved_state_is_of_what_the_functions_did() -> None:
    (_, saved), (changed, _) = snapshot(OLD), snapshot(NEW)
    with pytest.raises(
        SavedStateError, match=r"golden_functions = '\d+:[0-9a-f]{16}'; this environment has '"
    ):
        SavedState.from_bytes(saved, changed)
    renamed, _ = snapshot(shift(written("moved", "there")))
    assert SavedState.from_bytes(saved, renamed).to_bytes() == saved


def told(saved: bytes, *golden_functions: str) -> bytes:
    """Return a saved state that tells something else of its golden functions, or nothing."""
    length = struct.unpack_from("<Q", saved, 12)[0]
    header = json.loads(saved[20 : 20 + length])
    del header["identity"]["golden_functions"]
    header["identity"].update(dict.fromkeys(["golden_functions"][: len(golden_functions)], *golden_functions))
    head = json.dumps(header).encode()
    body = struct.pack("<Q", len(head)) + head + saved[20 + length :]
    return saved[:8] + struct.pack("<I", zlib.crc32(body)) + body


def test_saved_states_of_0_1_0_are_read_without_it() -> None:
    config, saved = snapshot(OLD)
    assert SavedState.from_bytes(told(saved), config).to_bytes() == saved


@pytest.mark.parametrize("hash_", ["5bc2a621c5bb173a", f"{RULES - 1}:0123456789abcdef"])
def test_saved_states_of_other_rules_are_read(hash_: str) -> None:
    """Theirs is another hash of the same functions."""
    config, saved = snapshot(OLD)
    assert SavedState.from_bytes(told(saved, hash_), config).to_bytes() == saved
    with pytest.raises(SavedStateError, match="golden_functions"):
        SavedState.from_bytes(told(saved, f"{RULES}:0123456789abcdef"), config)


if __name__ == "__main__":
    for name, behaviour in behaviours(ours()).items():
        keep_fact(name, "behaviour", behaviour)
