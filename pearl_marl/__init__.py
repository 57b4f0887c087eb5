"""PEARL-MARL: tens of thousands of environments as the agents of one PettingZoo ``ParallelEnv``.

>>> import pearl_marl
>>> env = pearl_marl.parallel_env("CliffWalking", n_agents=43008)
>>> observations, infos = env.reset(seed=0)
"""

import pearl_marl.envs  # the folders; the function below takes their name  # noqa: F401
import pearl_marl.wrappers as wrappers
from pearl_marl import devices, errors
from pearl_marl.interfaces.aec import env, raw_env
from pearl_marl.interfaces.parallel import PearlParallelEnv, parallel_env
from pearl_marl.interfaces.registration import announce, register
from pearl_marl.interfaces.vector import PearlVectorEnv, make_vec
from pearl_marl.packing import unpacked
from pearl_marl.registry import get_spec
from pearl_marl.registry import names as envs
from pearl_marl.spec import EnvSpec
from pearl_marl.version import __version__

__all__ = [
    "EnvSpec",
    "PearlParallelEnv",
    "PearlVectorEnv",
    "__version__",
    "devices",
    "env",
    "envs",
    "errors",
    "get_spec",
    "make_vec",
    "parallel_env",
    "raw_env",
    "register",
    "unpacked",
    "wrappers",
]

for _name in envs():
    announce(get_spec(_name))
