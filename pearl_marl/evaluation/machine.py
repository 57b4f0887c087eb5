"""The machine that a figure was measured on."""

from __future__ import annotations

import os
import platform
import re
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any


def machine() -> dict[str, Any]:
    """Return the facts that make a figure repeatable: processor, cores, versions."""
    versions = {}
    peers = (
        *("gymnasium", "pettingzoo", "envpool", "lbforaging", "overcooked-ai", "jaxmarl", "jax"),
        *("gymnax", "pgx", "jumanji", "bsuite", "MinAtar", "minigrid", "mpe2", "or-gymnasium", "pyRDDLGym"),
    )
    for package in ("pearl-marl", "numpy", "numba", *peers):
        with suppress(metadata.PackageNotFoundError):
            versions[package] = metadata.version(package)
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
        "versions": versions,
    }


def _processor() -> str:
    """Return the processor's model, as Linux names it where it does."""
    with suppress(OSError):
        if found := re.search(r"^model name\s*: *(.*)", Path("/proc/cpuinfo").read_text(), re.MULTILINE):
            return found[1].strip()
    return platform.processor()
