"""Environments that nobody wrote step alike on every device: branches, loops, lists, divisions and reals."""

from __future__ import annotations

import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl.devices import Lockstep
from pearl_marl.verification import runs, verify

from ..rtl.random_steps import random_spec
from ..sampling import sampled

DEVICES = {"native": 40, "cuda": 6, "rtl": 24}
"""How many slots are compared with the reference's."""
KINDS: dict[str, dict[str, bool]] = {"plain": {}, "divided": {"divided": True}, "reals": {"reals": True}}
CASES = sampled(
    [(kind, device, seed) for kind in KINDS for device in DEVICES for seed in range(100, 108)],
    [
        *((kind, "rtl", 100 + k) for k, kind in enumerate(KINDS)),
        ("reals", "native", 102),
        ("reals", "cuda", 102),
    ],
)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_random_golden_functions(case: tuple[str, str, int]) -> None:
    kind, device, seed = case
    if device == "cuda":
        pytest.importorskip("numba_cuda", reason="numba-cuda is not installed: pip install '.[cuda]'")
    spec = random_spec(seed, **KINDS[kind])
    for run in runs(spec, DEVICES[device], 24, AutoresetMode.SAME_STEP):
        for _ in verify(run, Lockstep(device, "reference"), seed):
            pass
        assert run.exact
