"""Slots over the machines of a Ray cluster: a machine that is lost takes none of them with it.

The machines are played by one: each has the processes and resources that it would have, and SIGKILL ends it.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Native, Ray, cluster
from pearl_marl.errors import DeviceError
from pearl_marl.testing import assert_same_step

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install '.[ray]'")

MEMORY = {"object_store_memory": 80_000_000}
HOST, BOARD = {"host": 1}, {"fpga": 1}


@pytest.fixture
def machines(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Begin a cluster of a machine without a board, which soon notices a lost one."""
    from ray.cluster_utils import Cluster

    checks = {
        "health_check_initial_delay_ms": 0,
        "health_check_period_ms": 500,
        "health_check_failure_threshold": 4,
    }
    head = {"num_cpus": 0, "resources": HOST, "include_dashboard": False, "_system_config": checks}
    ray.shutdown()  # that of other tests
    made = Cluster(initialize_head=True, head_node_args={**head, **MEMORY})
    monkeypatch.setenv("RAY_ADDRESS", made.address)
    try:
        yield made
        ray.shutdown()
    finally:
        made.shutdown()


@pytest.mark.exhaustive  # the tests of lost actors go the same way, on one machine
def test_lost_machines(machines: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Slots move to another machine that has what they need; without one, they wait for it."""
    boards = [machines.add_node(num_cpus=0, resources=BOARD, **MEMORY) for _ in range(2)]
    machines.wait_for_nodes()
    device, native = Ray(["native", "native"], resources=[HOST, BOARD], checkpoint_every=4), Native()
    random = np.random.default_rng(0)
    for each in (device, native):
        each.open(BatchConfig(spec=get_spec("CliffWalking"), n_envs=70, max_cycles=20))
        each.reset(seed=0)

    def place() -> str | None:
        """Return the machine of the second actor; it may be lost."""
        ask = device.parts[1]._actor.__ray_call__.remote(lambda _: ray.get_runtime_context().get_node_id())
        with contextlib.suppress(cluster.lost()):
            return str(cluster.get(ask))
        return None

    def lose(machine: str | None) -> None:
        machines.remove_node(next(b for b in boards if b.node_id == machine), allow_graceful=False)

    def step_until(done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 1800
        while not done():
            assert time.monotonic() < deadline
            actions = random.integers(4, size=70, dtype=np.uint8)
            step = device.step(actions)  # of which native knows nothing if it fails
            assert_same_step(step, native.step(actions))

    try:
        first = place()
        lose(first)
        step_until(lambda: place() not in (None, first))
        lose(place())
        monkeypatch.setattr(cluster, "START_SECONDS", 2)
        with pytest.raises(DeviceError, match=r"'fpga': 1"):
            step_until(lambda: False)
        machines.add_node(num_cpus=0, resources=BOARD, **MEMORY)
        monkeypatch.setattr(cluster, "START_SECONDS", 100)
        device.recover()
        steps = iter(range(10))
        step_until(lambda: next(steps, None) is None)
    finally:
        device.close()
        native.close()
