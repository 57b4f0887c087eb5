"""One build of the hardware: for which environment, and with which memory map."""

from __future__ import annotations

from typing import NamedTuple

from pearl_marl.memory_map import MemoryMap
from pearl_marl.spec import EnvSpec


class Build(NamedTuple):
    """What decides every file, parameter and address of a design.

    Parameters
    ----------
    spec
        The environment, with its options.
    layout
        The memory map, which also says how many slots, processing elements and bits of a word there are.
    """

    spec: EnvSpec
    layout: MemoryMap
