"""PEARL-MARL: tens of thousands of environments as the agents of one PettingZoo ``ParallelEnv``.

>>> import pearl_marl
>>> env = pearl_marl.parallel_env("CliffWalking", n_agents=43008)
>>> observations, infos = env.reset(seed=0)
"""

import importlib
from collections.abc import Callable
from typing import cast

from pearl_marl import devices, errors
from pearl_marl.parallel_env import PearlParallelEnv, env, parallel_env, raw_env
from pearl_marl.registry import get_spec, register, register_elsewhere
from pearl_marl.spec import EnvSpec
from pearl_marl.vector_env import PearlVectorEnv, make_vec

# These two are folders beside this one, mapped into the package when it is installed.
envs = cast(Callable[[], list[str]], importlib.import_module("pearl_marl.envs"))
wrappers = importlib.import_module("pearl_marl.wrappers")

__all__ = [
    "EnvSpec",
    "PearlParallelEnv",
    "PearlVectorEnv",
    "devices",
    "env",
    "envs",
    "errors",
    "get_spec",
    "make_vec",
    "parallel_env",
    "raw_env",
    "register",
    "wrappers",
]

__version__ = "0.1.0"

for _name in envs():
    register_elsewhere(get_spec(_name))
