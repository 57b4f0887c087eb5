"""Gymnasium's classic control with real numbers: its formulas and constants, no shift and no scale.

Importing the package registers them, from the folder of this repository:

    pearl run examples.reals:RealAcrobot --n-agents 1000
    pearl verify examples.reals:RealAcrobot --device rtl
    pearl verify examples.reals:RealAcrobot --against Acrobot-v1
"""

from dataclasses import replace
from typing import Any

import numpy as np

import pearl_marl

from . import acrobot, cart_pole, mountain_car, mountain_car_continuous, pendulum

MODULES = acrobot, cart_pole, mountain_car, mountain_car_continuous, pendulum


def pose(original: Any, state: tuple[float, ...]) -> None:
    """Put an environment of Gymnasium's into a state, to draw it or to compare a step."""
    original.state = np.array(state)
    original.last_u = original.steps_beyond_terminated = None


SPECS = tuple(replace(module.SPEC, pose=pose) for module in MODULES)
for spec in SPECS:
    pearl_marl.register(spec)
