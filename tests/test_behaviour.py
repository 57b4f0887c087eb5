"""What tells golden functions apart, for hardware and saved states: what they do, and nothing else."""

from __future__ import annotations

import json
import os
import pickle
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Discrete

from pearl_marl.batch.saved_state import SavedState
from pearl_marl.devices import BatchConfig, Native, Rtl, Xdma
from pearl_marl.devices.simulator.model_build import library
from pearl_marl.errors import DeviceError, SavedStateError
from pearl_marl.golden import i16, u8, u32
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.elaboration import env_hash
from pearl_marl.registry import get_spec, names
from pearl_marl.spec import EnvSpec, Field, Golden

from .devices.boards import served
from .toy_world import MEADOW, NIM

TABLE, ROWS, SCALE = (5, 6, 7, 8), ((1, 2), (3, 4)), 3


def initial(draw: Any) -> Any:
    return draw >> 28


def step(x: Any, action: Any, draw: Any) -> Any:
    moved = (x + action) & 15
    flag = (moved > 12) | (TABLE[action] == 6)
    seen = ROWS[moved & 1][action >> 1] + u8(draw) - i16(draw)
    return np.where(flag, moved, np.minimum(moved, 9)), (seen * SCALE) & 15, moved == 15


def observe(x: Any) -> Any:
    return x


def masks(x: Any) -> Any:
    return 1, 1, x < 8, 1


def shift(step: Any = step, **parts: Any) -> EnvSpec:
    golden = {"initial": initial, "observe": observe, "masks": masks}
    golden |= {name: parts.pop(name) for name in golden if name in parts}
    whole = {
        "name": "Shift",
        "version": 0,
        "summary": "A counter",
        "state": (Field("x", 4),),
        "action": Field("action", 2),
        "observation": (Field("x", 4),),
        "reward": Field("reward", 4),
        "rewards": None,
        "observation_space": Discrete(16),
        "action_space": Discrete(4),
        "golden": Golden(step=step, **golden),
        "reset_draws": 1,
        "step_draws": 1,
    }
    return EnvSpec(**{**whole, **parts})


def written(old: str, new: str) -> Callable[..., Any]:
    """Return the step above with some of its text replaced."""
    lines = (
        "def step(x, action, draw):\n"
        "    moved = (x + action) & 15\n"
        "    flag = (moved > 12) | (TABLE[action] == 6)\n"
        "    seen = ROWS[moved & 1][action >> 1] + u8(draw) - i16(draw)\n"
        "    return np.where(flag, moved, np.minimum(moved, 9)), (seen * SCALE) & 15, moved == 15\n"
    )
    assert old in lines
    scope: dict[str, Any] = {"np": np, "u8": u8, "u32": u32, "i16": i16}
    scope |= {"TABLE": TABLE, "ROWS": ROWS, "SCALE": SCALE}
    exec(lines.replace(old, new), scope)
    return scope["step"]  # type: ignore[no-any-return]


SAME = {
    "as it is written": ("x", "x"),
    "names of variables": ("moved", "where_it_goes"),
    "names of arguments": ("draw", "dice"),
    "a comment": ("    flag =", "    # whether it is over\n    flag ="),
    "another way to write it": ("moved > 12", "12 < moved"),
    "terms in another order": ("x + action", "action + x"),
    "NumPy's type of a constant": ("moved == 15", "moved == np.int64(15)"),
    "a helper": ("(x + action) & 15", "(lambda a, b: (a + b) & 15)(x, action)"),
}
OTHER = {
    "a factor": ("x + action", "x + 2 * action"),
    "a sign": ("x + action", "x - action"),
    "terms of a difference": ("u8(draw) - i16(draw)", "i16(draw) - u8(draw)"),
    "a constant": ("moved > 12", "moved > 11"),
    "a comparison": ("moved > 12", "moved >= 12"),
    "its sides": ("moved > 12", "12 > moved"),
    "an equality": ("moved == 15", "moved != 15"),
    "a table": ("TABLE[action]", "(lambda t: t)(TABLE)[3 - action]"),
    "an operation": (") | (", ") & ("),
    "a choice": ("flag, moved,", "flag, draw >> 28,"),
    "a minimum": ("np.minimum", "np.maximum"),
    "a clip": ("np.minimum(moved, 9)", "np.clip(moved, 1, 9)"),
    "a width": ("u8(draw)", "u32(draw)"),
    "a shift": ("action >> 1", "1 - (action >> 1)"),
    "one draw": ("u8(draw)", "u8(draw >> 1)"),
}
PARTS: dict[str, dict[str, Any]] = {
    "the start": {"initial": lambda draw: draw >> 29},
    "a constant start": {"initial": lambda draw: 3},
    "what is seen": {"observe": lambda x: 15 - x},
    "a mask": {"masks": lambda x: (1, 1, x < 9, 1)},
    "no masks": {"masks": None},
    "a wider observation": {"observation": (Field("x", 5),)},
    "a wider reward": {"reward": Field("reward", 5)},
    "a reward's scale": {"reward": Field("reward", 4, fraction=1)},
    "a table of rewards": {"rewards": tuple(float(k) for k in range(16))},
    "a draw less": {"initial": lambda: 0, "reset_draws": 0},
    "a draw more": {"initial": lambda draw, more: draw >> 28, "reset_draws": 2},
}


@pytest.mark.parametrize("change", SAME)
def test_what_changes_nothing_is_the_same(change: str) -> None:
    assert shift(written(*SAME[change])).behaviour == shift().behaviour


def test_what_does_something_else_is_another() -> None:
    found = {"as it is": shift().behaviour}
    found |= {change: shift(written(*OTHER[change])).behaviour for change in OTHER}
    found |= {change: shift(**PARTS[change]).behaviour for change in PARTS}
    for name, value in {"TABLE": (5, 6, 7, 9), "ROWS": ((1, 2), (3, 5)), "SCALE": 4}.items():
        changed = written("x", "x")
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
    def other(*words: Any) -> Any:
        *_, agent = words
        seen = spec.positional.observe(*words)
        if agent != spec.agents - 1:
            return seen
        return (1 - (seen[0] & 1), *seen[1:]) if isinstance(seen, tuple) else 1 - (seen & 1)

    changed = replace(spec, golden=spec.golden._replace(observe=other))
    assert changed.behaviour != spec.behaviour


KNOWN = {
    "Blackjack": "481df7d15dae7737",
    "CartPole": "5b479b5fdd671295",
    "CliffWalking": "5bc2a621c5bb173a",
    "CoinGame": "cc0a0edd400bef91",
    "ConnectFour": "fe72203342a73218",
    "FrozenLake": "19543b72de10640e",
    "LevelBasedForaging": "821a7c62c24e189c",
    "MountainCar": "ea418932461240a7",
    "Overcooked": "9bd638803cd007a6",
    "Pendulum": "75f022ae84c5904e",
    "RobotWarehouse": "8dd2f24f65bbe913",
    "Seaquest": "a1299b1ddb778853",
    "Taxi": "d48b3d752050b457",
}
"""As of all environments in all versions: boards are built with these. A change of one of them has to be
meant, since boards and saved states of that environment are refused from then on."""


def behaviours() -> dict[str, str]:
    return {name: get_spec(name).behaviour for name in names()}


def test_those_of_known_environments_stay() -> None:
    assert {name: get_spec(name).behaviour for name in KNOWN} == KNOWN
    assert KNOWN.keys() >= set(names()) - {"Meadow", "Nim"}


@pytest.mark.parametrize("seed", ["0", "1", "12345"])
def test_they_are_the_same_in_every_process(seed: str) -> None:
    program = "from tests.test_behaviour import behaviours; print(sorted(behaviours().items()))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONHASHSEED": seed},
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=True,
    )
    assert eval(done.stdout) == sorted(KNOWN.items())


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


OLD, NEW, N = shift(), shift(written("x + action", "x + 2 * action")), 7
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

    def other(*words: Any) -> Any:
        row, column, reward, terminated = step(*words)
        return row, column, reward, terminated & (column > 3)

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
    with pytest.raises(SavedStateError, match=r"golden_functions = '[0-9a-f]{16}'; this environment has '"):
        SavedState.from_bytes(saved, changed)
    renamed, _ = snapshot(shift(written("moved", "there")))
    assert SavedState.from_bytes(saved, renamed).to_bytes() == saved


def test_saved_states_of_0_1_0_are_read_without_it() -> None:
    config, saved = snapshot(OLD)
    length = struct.unpack_from("<Q", saved, 12)[0]
    header = json.loads(saved[20 : 20 + length])
    del header["identity"]["golden_functions"]
    head = json.dumps(header).encode()
    body = struct.pack("<Q", len(head)) + head + saved[20 + length :]
    blob = saved[:8] + struct.pack("<I", zlib.crc32(body)) + body
    assert SavedState.from_bytes(blob, config).to_bytes() == saved
