"""Elevators as pyRDDLGym has it."""

from __future__ import annotations

import copy
import importlib
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.spec import EnvSpec

KINDS = "move-current-dir", "open-door-going-up", "open-door-going-down", "close-door"
"""RDDL's names of our actions from 1 on."""


def make(spec: EnvSpec) -> Any:
    """Return RDDL's environment."""
    return copy.deepcopy(_translated(str(spec.options["instance"])))


@cache  # it takes half a second
def _translated(instance: str) -> Any:
    import pyRDDLGym

    importlib.import_module("rddlrepository")
    return pyRDDLGym.make("Elevators_MDP_ippc2011", instance)


def moves_of(spec: EnvSpec, actions: npt.NDArray[np.integer[Any]]) -> list[dict[str, bool]]:
    """Return actions by RDDL's names; those that do nothing have none."""
    return [
        {f"{KINDS[kind - 1]}___e{car}": True for car, kind in enumerate(row) if kind}
        for row in actions.tolist()
    ]
