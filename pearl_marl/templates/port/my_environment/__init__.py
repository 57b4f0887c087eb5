"""MyEnvironment, an environment for PEARL-MARL.

Importing this package registers it, and the name before the colon imports it:

>>> env = pearl_marl.parallel_env("my_environment:MyEnvironment", n_agents=@agents@000)
"""

import warnings

from pearl_marl import register
from pearl_marl.errors import ArgumentError

# Until `step.py` is filled in there is nothing to register. Then two lines do: the import and register(SPEC).
try:
    from .spec import SPEC
except ArgumentError as error:
    warnings.warn(f"MyEnvironment is not registered yet: {error}", stacklevel=2)
else:
    register(SPEC)
