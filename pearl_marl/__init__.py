"""PEARL-MARL: tens of thousands of environments as the agents of one PettingZoo ``ParallelEnv``.

>>> import pearl_marl
>>> env = pearl_marl.parallel_env("CliffWalking", n_agents=43008)
>>> observations, infos = env.reset(seed=0)
"""

from __future__ import annotations

import os
import types
import warnings
from typing import TYPE_CHECKING

import pearl_marl.envs
from pearl_marl import errors
from pearl_marl.base.version import __version__
from pearl_marl.envs import get_spec
from pearl_marl.envs import names as list_envs
from pearl_marl.interfaces.registration import announce_all, register

_threads = os.environ.get("NUMBA_NUM_THREADS", "").strip()
if _threads.lstrip("-").isdecimal() and int(_threads) < 1:
    raise errors.ArgumentError(
        f"the environment variable NUMBA_NUM_THREADS is {_threads}, and Numba takes 1 or more: unset it"
    )

if TYPE_CHECKING:
    import pearl_marl.wrappers as wrappers
    from pearl_marl import devices
    from pearl_marl.compiler.packing import unpacked
    from pearl_marl.interfaces.aec import env, raw_env
    from pearl_marl.interfaces.parallel import PearlParallelEnv, parallel_env
    from pearl_marl.interfaces.vector import PearlVectorEnv, make_vec
    from pearl_marl.policies.integer_file import load_policy
    from pearl_marl.spec import EnvSpec
else:
    # Numba, Gymnasium and PettingZoo take a second to import: whoever asks for one of these waits for it.
    _MODULES = {
        "EnvSpec": "spec",
        "PearlParallelEnv": "interfaces.parallel",
        "PearlVectorEnv": "interfaces.vector",
        "devices": "devices",
        "env": "interfaces.aec",
        "load_policy": "policies.integer_file",
        "make_vec": "interfaces.vector",
        "parallel_env": "interfaces.parallel",
        "raw_env": "interfaces.aec",
        "unpacked": "compiler.packing",
        "wrappers": "wrappers",
    }

    def __getattr__(name):
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        module = import_module(f"{__name__}.{_MODULES[name]}")
        globals()[name] = module if name == _MODULES[name] else getattr(module, name)
        return globals()[name]

    def __dir__():
        return sorted({*globals(), *__all__})


class _Environments(types.ModuleType):
    """The package of the environments, which had the name of :func:`list_envs` as well."""

    def __call__(self) -> list[str]:
        warnings.warn("pearl_marl.envs() is now pearl_marl.list_envs()", DeprecationWarning, stacklevel=2)
        return list_envs()


pearl_marl.envs.__class__ = _Environments

__all__ = [
    "EnvSpec",
    "PearlParallelEnv",
    "PearlVectorEnv",
    "__version__",
    "devices",
    "env",
    "errors",
    "get_spec",
    "list_envs",
    "load_policy",
    "make_vec",
    "parallel_env",
    "raw_env",
    "register",
    "unpacked",
    "wrappers",
]

announce_all()
