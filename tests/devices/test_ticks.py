"""The step counter on every device: up to 2**64, where it begins again at 0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Cuda, Device, Lockstep, Native, Reference, Rtl, Sharded
from pearl_marl.testing.case import assert_same_step
from tests.devices.boards import OwnBoard

N = 9
DEVICES: dict[str, Callable[[], Device]] = {
    "one thread": lambda: Native(1),
    "two threads": lambda: Native(2),
    "sharded": lambda: Sharded([Reference(), Native()]),
    "lockstep": lambda: Lockstep("native", "reference"),
    "rtl": lambda: Rtl(pe_num=3),
    "served board": lambda: OwnBoard(3),
    "cuda": Cuda,
}


def opened(device: Device) -> Device:
    device.open(BatchConfig(spec=get_spec("Blackjack"), n_envs=N, max_cycles=4))
    device.reset(seed=5)
    return device


@pytest.mark.filterwarnings("ignore:overflow encountered")  # NumPy, of the simulated GPU's integers
@pytest.mark.parametrize("start", [2**32 - 2, 2**63 - 2, 2**64 - 2])
@pytest.mark.parametrize("kind", DEVICES)
def test_the_same_as_the_reference_across_the_edges(kind: str, start: int) -> None:
    device, reference = opened(DEVICES[kind]()), opened(Reference())
    saved = replace(reference.snapshot(), tick=start)
    for each in (device, reference):
        each.restore(saved)
    rng = np.random.default_rng(1)
    for t in range(5):
        actions = rng.integers(2, size=N)
        assert_same_step(device.step(actions), reference.step(actions))
        assert device.tick == (start + t + 1) % 2**64
        assert device.snapshot().to_bytes() == reference.snapshot().to_bytes()
    device.restore(saved)
    device.send(np.zeros(N, int))
    device.recv()
    assert device.tick == (start + 1) % 2**64
    some = np.arange(N) % 2 == 0
    device.restore(replace(saved, tick=2**64 - 1))
    reference.restore(replace(saved, tick=2**64 - 1))
    for mask in (some, None):
        np.testing.assert_array_equal(np.asarray(device.reset(mask=mask)), reference.reset(mask=mask))
    assert device.tick == reference.tick == 0
    device.close()
