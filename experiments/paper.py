"""Figures that others published, each with the place where it stands: nothing here was measured by us.

"The paper" is *PEARL: FPGA-Based Reinforcement Learning Acceleration with Pipelined Parallel Environments*. A
figure that it only draws, without a number, is not here. Its Table II is in ``pearl_marl.benchmark.paper``.
"""

from __future__ import annotations

from typing import NamedTuple

SAVED = {"state": 0.875, "action": 0.875, "reward": 0.969, "observation": 0.917, "ends": 0.875}
"""Shares of a transfer that the paper's compression saves, of CliffWalking."""
SAVED_SOURCE = "the paper, section III-B"

ACTION_SHARE = {
    "CliffWalking": 0.20,
    "Blackjack": 0.006,
    "CartPole": 0.007,
    "Pendulum": 0.333,
    "Seaquest": 0.005,
}
"""Bits of an action over those of an action and a state: what a step sends when states stay on the FPGA."""
ACTION_SHARE_SOURCE = "the paper, section III-B and Fig. 3"


COMPUTE_NS = {
    "CartPole": 800,
    "Pendulum": 960,
    "MountainCar": 840,
    "CliffWalking": 20,
    "FrozenLake": 20,
    "Taxi": 10,
    "Blackjack": 70,
    "Seaquest": 80,
}
"""Compute time of a step in ns. Of Blackjack, Table II has 80."""
COMPUTE_NS_SOURCE = "the paper, Table I"

OVER_VECTOR_ENV = {
    "CliffWalking": 4699.3,
    "Blackjack": 2998.5,
    "CartPole": 272.6,
    "Pendulum": 353.4,
    "Seaquest": 1225.2,
}
"""Steps per second of the paper's platform over Gymnasium's VectorEnv."""
OVER_ENVPOOL = (4.36, 972.6)
"""Least and most over EnvPool, of the five; which are which is only drawn."""
OVER_NO_PIPELINE = (2.7, 13.5)
"""Least and most over the same platform without pipeline."""
THROUGHPUT_SOURCE = "the paper, section IV-B and Fig. 6"


class Framework(NamedTuple):
    """A column of the paper's Table III, of CliffWalking."""

    steps_per_second: float
    steps_per_joule: float
    n_envs: str


FRAMEWORKS = {
    "VectorEnv": Framework(54_035, 1_172.89, "< 2,000"),
    "EnvPool": Framework(2_773_265, 44_845.81, "< 2,000"),
    "PEARL, their board": Framework(253_926_929, 5_375_707.70, "> 40,000"),
}
"""Steps per second, steps per second and watt, and the most environments."""
FRAMEWORKS_SOURCE = "the paper, Table III"

ENERGY_OVER = {
    "CliffWalking": (4583.0, 120.0),
    "Blackjack": (5134.0, 40.0),
    "CartPole": (583.0, 6.0),
    "Pendulum": (738.0, 6.0),
    "Seaquest": (3483.0, 2651.0),
}
"""Steps per joule of the paper's platform over VectorEnv, and over EnvPool."""
ENERGY_SOURCE = "the paper, section IV-C and Fig. 8"

GROWTH = {"lut": 2.24, "ff": 3.08, "power": 1.03}
"""From 1,024 to 43,008 slots of CliffWalking, after implementation."""
GROWTH_SIZES = (1024, 43008)
GROWTH_SOURCE = "the paper, section IV-D"

TRAINING_TIME_SAVED = {
    "PPO CartPole": {"EnvPool": 0.07, "VectorEnv": 0.18},
    "DQN CartPole": {"EnvPool": 0.12, "VectorEnv": 0.61},
    "DQN CliffWalking": {"EnvPool": 0.15, "VectorEnv": 0.44},
}
TRAINING_TIME_SOURCE = "the paper, section IV-B and Fig. 7"

MINATAR_SEAQUEST_DQN = 19.4
"""Return of MinAtar's DQN in Seaquest: mean over the last 100 of 5 million frames' episodes and 30 seeds, at
the best of its step sizes (2**-13). Read off the picture, to 0.2; no table states it."""
MINATAR_SEAQUEST_DQN_CURVE = 20.4
"""The highest that the same DQN's learning curve comes to, in the last 0.3 million frames; read off too."""
MINATAR_SOURCE = (
    "K. Young and T. Tian, arXiv:1903.03176, and github.com/kenjyoung/MinAtar at 4241f24: "
    "img/sensitivity_curves.gif and img/learning_curves.gif (MinAtar 1.0.10 and lower, in which the oxygen "
    "bar flashes to full before it runs out; its sticky actions, 0.1, and ramping difficulty are on)"
)
