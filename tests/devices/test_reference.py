"""The reference device: what it checks, and that it is independent of what it checks.

That its results are right is what the tests of the environments against their oracles show, through
the native device, which the contract tests hold against this one.
"""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
import pytest

import pearl_marl
from pearl_marl.compiler.packing import observed_as
from pearl_marl.devices import BatchConfig, Native, Reference, make_device
from pearl_marl.errors import DeviceError
from pearl_marl.spec import EnvSpec, Field

from ..toy import LADDER, SLIDE, LadderState, with_state

CLIFF = pearl_marl.get_spec("CliffWalking")


def open_reference(spec: EnvSpec, n: int = 70, **config: object) -> Reference:
    device = Reference().open(BatchConfig(spec=spec, n_envs=n, **config))
    device.reset(seed=0)
    return device


def test_it_has_a_name() -> None:
    assert isinstance(make_device("reference"), Reference)
    env = pearl_marl.parallel_env("CliffWalking", 3, device="reference")
    assert env.reset(seed=0)[0] == {"agent_0": 36, "agent_1": 36, "agent_2": 36}


def test_nothing_is_compiled_and_no_kernel_is_made(tmp_path) -> None:
    """A mistake of the kernels' generator, or of Numba, must not be able to reach it."""
    program = """
import sys
from unittest import mock
import numba
import numpy as np
import pearl_marl
from pearl_marl.batch.actions import room_for_words
from pearl_marl.compiler import kernels
from pearl_marl.devices import BatchConfig, Reference

POISON = AssertionError("compiled")
with mock.patch.object(kernels, "kernel_source", side_effect=POISON), \\
        mock.patch.object(kernels, "load", side_effect=POISON), \\
        mock.patch.object(kernels, "compile_kernels", side_effect=POISON), \\
        mock.patch("numba.core.dispatcher.Dispatcher.compile", side_effect=POISON):
    for name in pearl_marl.list_envs():
        spec = pearl_marl.get_spec(name)
        device = Reference().open(BatchConfig(spec=spec, n_envs=3, max_cycles=2))
        device.reset(seed=0)
        for _ in range(3):
            words = np.zeros_like(room_for_words(spec, 3 * spec.agents))
            if device.action_masks is not None:
                words[:] = device.action_masks.argmax(-1)
            device.step_words(words)  # actions are checked and encoded for all devices alike, by Numba
assert not [name for name in sys.modules if name.startswith("pearl_marl_kernel_")]
"""
    subprocess.run([sys.executable, "-c", program], check=True, cwd=tmp_path)


@pytest.mark.parametrize("observations", ["whole", "packed"])
@pytest.mark.parametrize("name", ["ConnectFour", "Overcooked", "Seaquest"])
def test_no_generated_code_unpacks_planes(name: str, observations: str) -> None:
    """Kernels are made of ``unpack`` as a function of words, which is generated: a mistake of it is seen."""
    spec = observed_as(pearl_marl.get_spec(name), observations)
    right = open_reference(spec, 5).step(np.full(5 * spec.agents, 1)).obs
    broken = replace(spec, configure=None)
    poison = mock.Mock(side_effect=AssertionError("generated code"))
    broken.__dict__["positional"] = spec.positional._replace(unpack=poison)
    np.testing.assert_array_equal(open_reference(broken, 5).step(np.full(5 * spec.agents, 1)).obs, right)
    native = Native().open(BatchConfig(spec=spec, n_envs=5))
    native.reset(seed=0)
    np.testing.assert_array_equal(native.step(np.full(5 * spec.agents, 1)).obs, right)


def test_it_shows_what_unpack_writes() -> None:
    """Not what a kernel makes of it: here a function that no compiler takes."""

    def write(row_word: int, column: int, picture: Any) -> None:
        picture[:] = [int(c) for c in f"{column:b}".zfill(24)]

    device = open_reference(replace(SLIDE, unpack=write, configure=None), 40)
    obs = device.step(np.zeros((40, 1), np.float32)).obs
    place = device.state()[:, 0] & 127
    weights = 1 << np.arange(24)[::-1]
    assert (obs.reshape(40, 24) @ weights).tolist() == place.tolist()
    assert len(set(place.tolist())) > 10


def test_snapshots_are_those_of_the_native_device() -> None:
    """Byte for byte, or saved states would tell which device made them."""
    config = BatchConfig(spec=CLIFF, n_envs=70, max_cycles=9, initial_states="stored")
    devices = [Native().open(config), Reference().open(config)]
    for device in devices:
        device.reset(seed=0)
        for t in range(20):
            device.step(np.full(70, t % 3, np.uint8))
    first, second = (device.snapshot().to_bytes() for device in devices)
    assert first == second


def narrow(spec: EnvSpec) -> dict[str, EnvSpec]:
    """Specs that promise one bit less than their golden functions need."""
    return {
        "column": with_state(spec, (spec.state[0], Field("column", 3))),
        "cell": replace(spec, observation=(Field("cell", 5),)),
        "row": with_state(spec, (Field("row", 1), spec.state[1])),
    }


@pytest.mark.parametrize("name", ["column", "cell", "row"])
def test_words_that_do_not_fit_are_refused(name: str) -> None:
    device = Reference().open(BatchConfig(spec=narrow(CLIFF)[name], n_envs=4))

    def walk() -> None:
        device.reset(seed=0)
        for action in (0, *[1] * 11):
            device.step(np.full(4, action, np.uint8))

    with pytest.raises(DeviceError, match=rf"CliffWalking gave {name} = \d+, and \d bits hold 0 to"):
        walk()


def test_a_refused_step_changes_nothing() -> None:
    device = open_reference(narrow(CLIFF)["column"])
    device.step(np.zeros(70, np.uint8))
    for _ in range(7):
        device.step(np.ones(70, np.uint8))
    before = device.snapshot().to_bytes()
    with pytest.raises(DeviceError, match=r"column = 8.* fix step\(\)"):
        device.step(np.ones(70, np.uint8))
    assert device.snapshot().to_bytes() == before
    device.step(np.zeros(70, np.uint8))


def unchecked(spec: EnvSpec, **golden: Any) -> EnvSpec:
    """Return a spec with other golden functions, which nobody has traced."""
    with mock.patch.object(EnvSpec, "check_golden"):
        return replace(spec, golden=spec.golden._replace(**golden))


def test_a_terminated_that_is_no_bit_is_refused() -> None:
    spec = unchecked(LADDER, step=lambda state, action, draws: (state, 0, 2))
    with pytest.raises(DeviceError, match="terminated = 2"):
        open_reference(spec).step(np.zeros(70, np.uint8))


def test_a_refused_reset_keeps_seed_and_tick() -> None:
    device = Reference().open(BatchConfig(spec=LADDER, n_envs=70))
    device.reset(seed=0)
    device.step(np.zeros(70, np.uint8))
    before = device.snapshot().to_bytes()
    good = device.config
    device.config = replace(good, spec=unchecked(LADDER, initial=lambda draws: LadderState(draws.bits())))
    for seed in (None, 7):
        with pytest.raises(DeviceError, match="rung"):
            device.reset(seed=seed)
    device.config = good
    assert device.snapshot().to_bytes() == before


def test_it_is_fast_enough_to_be_asked() -> None:
    """43,008 slots for 30 steps: seconds of this processor, however busy it is with other things."""
    device = open_reference(CLIFF, 43008, max_cycles=50)
    actions = np.random.default_rng(0).integers(4, size=(30, 43008), dtype=np.uint8)
    began = time.thread_time()
    for row in actions:
        device.step(row)
    assert time.thread_time() - began < 20


def test_a_step_makes_no_source_of_kernels() -> None:
    """Making it takes Seaquest some twenty times as long as the step."""
    device = open_reference(pearl_marl.get_spec("Seaquest"), 3)
    with mock.patch("pearl_marl.compiler.kernels.kernel_source", side_effect=AssertionError):
        device.step(np.zeros(3, np.uint8))
