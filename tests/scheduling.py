"""Which tests go to which process of xdist: together what shares something dear, and the longest first.

Two processes that need the same kernel, model or cluster at the same time would each make it.
"""

from __future__ import annotations

import re
from typing import Any

from xdist.scheduler import LoadScopeScheduling

FIRST = (
    "tests/devices/test_ray.py",
    "tests/docs/test_docs.py::test_walks",
    "tests/cli/test_report.py",
    "tests/rtl/test_proofs.py",
    "tests/devices/test_rtl.py",
    "tests/rtl/test_netlist.py",
    "tests/rtl/test_modules.py",
    "tests/contract/test_environments.py::TestSimulated",
    "tests/rtl/test_top.py",
    "tests/hardware",
    "tests/rtl/test_boards.py",
    "tests/devices/test_ray_nodes.py",
    "tests/rtl/test_cores.py",
    "tests/envs/test_robot_warehouse.py",
    "tests/compiler/test_proofs.py",
    "tests/cli/test_new.py",  # checks types: the linters beside fill mypy's cache meanwhile
    "tests/envs/test_seaquest.py",
    "tests/rtl/test_coverage.py",
    "tests/rtl/test_mutation.py",
    "tests/contract",
    "tests/wrappers/test_stable_baselines3.py",
    "tests/envs/test_frozen_lake.py",
    "tests/docs",
    "tests/training",
)
"""Beginnings of groups' names; what comes after them takes less than half a minute each."""


CLUSTER = ("tests/devices/test_ray.py", "tests/training/test_workers.py")
"""Files whose tests share a Ray cluster."""


def group(test: str) -> str:
    """Return the group of a test: of the contract an environment, of the pages a test, else a file."""
    file, _, rest = test.partition("::")
    if file in CLUSTER:
        return CLUSTER[0]
    if file.endswith("contract/test_environments.py"):
        environment = re.search(r"\[(\w+)", rest)
        return f"{file}::{rest.partition('::')[0]}::{environment[1] if environment else ''}"
    return test if file.endswith("docs/test_docs.py") else file


def urgency(name: str) -> int:
    return next((i for i, first in enumerate(FIRST) if name.startswith(first)), len(FIRST))


class Scheduling(LoadScopeScheduling):
    def __init__(self, config: Any, log: Any = None) -> None:
        super().__init__(config, log)
        config.option.loadscopereorder = False

    def _split_scope(self, nodeid: str) -> str:
        return group(nodeid)
