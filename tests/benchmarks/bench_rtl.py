"""Simulated CliffWalking: env-steps a second of the device, results delivered, and cycles a step.

``make bench``
"""

from __future__ import annotations

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Rtl

# Slots, processing elements, bits of a word; the first is what device="rtl" takes by default.
SIZES = [
    (43008, None, None),
    (43008, 256, 1024),
    (43008, 64, 512),
    (1024, 16, 128),
    (1000, 16, 64),
    (7, 4, 32),
]


@pytest.mark.benchmark(group="simulated CliffWalking")
@pytest.mark.parametrize(("n_envs", "pe_num", "data_wl"), SIZES)
def test_step(benchmark, n_envs: int, pe_num: int | None, data_wl: int | None) -> None:
    if not benchmark.enabled:
        pytest.skip("a benchmark: run pytest --benchmark-enable")
    device = Rtl(pe_num, data_wl).open(BatchConfig(spec=get_spec("CliffWalking"), n_envs=n_envs))
    device.reset(seed=0)
    actions = np.random.default_rng(0).integers(4, size=n_envs, dtype=np.uint8)
    benchmark.pedantic(device.step, (actions,), rounds=100, warmup_rounds=3)
    benchmark.extra_info["million env-steps/s"] = round(n_envs / benchmark.stats.stats.median / 1e6, 3)
    benchmark.extra_info["cycles"] = device.cycles
    device.close()
