"""Gymnasium's classic control with real numbers: its formulas and constants, no shift and no scale.

Importing the package registers them, from the folder of this repository:

    pearl run examples.reals:RealAcrobot --n-agents 1000
    pearl verify examples.reals:RealAcrobot --device rtl
"""

import pearl_marl

from . import acrobot, cart_pole, mountain_car, mountain_car_continuous, pendulum

SPECS = tuple(m.SPEC for m in (acrobot, cart_pole, mountain_car, mountain_car_continuous, pendulum))
for spec in SPECS:
    pearl_marl.register(spec)
