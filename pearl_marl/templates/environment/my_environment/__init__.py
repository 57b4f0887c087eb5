"""MyEnvironment, an environment for PEARL-MARL.

Importing this package registers it, and the name before the colon imports it:

>>> env = pearl_marl.parallel_env("my_environment:MyEnvironment", n_agents=1000)
"""

from pearl_marl import register

from .spec import SPEC

register(SPEC)
