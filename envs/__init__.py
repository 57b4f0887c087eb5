"""The environments, a folder each: ``spec.py``, ``step.py``, ``README.md``, the core in SystemVerilog.

The package is also a function: ``pearl_marl.envs()`` returns the names of all environments.
"""

import sys
import types

from pearl_marl.registry import names


class _Environments(types.ModuleType):
    # `pearl_marl.envs` has to be this package, for its folders to be importable, and a function,
    # for users; Python allows both where the module's class has a __call__.
    def __call__(self) -> list[str]:
        return names()


sys.modules[__name__].__class__ = _Environments
