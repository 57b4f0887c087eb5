"""Gymnasium's classic control with real numbers: its formulas and constants, no shift and no scale.

Importing the package registers them, from the folder of this repository:

    pearl run examples.reals:RealPendulum --n-agents 1000
    pearl verify examples.reals:RealPendulum --device rtl
    pearl verify examples.reals:RealPendulum --against Pendulum-v1
"""

from dataclasses import replace
from typing import Any

import numpy as np

import pearl_marl

from . import cart_pole, mountain_car, pendulum

MODULES = cart_pole, mountain_car, pendulum


def pose(original: Any, state: tuple[float, ...]) -> None:
    """Put an environment of Gymnasium's into a state, to draw it or to compare a step."""
    original.state = np.array(state)
    original.last_u = original.steps_beyond_terminated = None


SPECS = tuple(replace(module.SPEC, pose=pose) for module in MODULES)
for spec in SPECS:
    pearl_marl.register(spec)
