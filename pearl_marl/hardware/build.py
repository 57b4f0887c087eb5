"""One build of the hardware: for which environment, and with which memory map."""

from __future__ import annotations

from typing import NamedTuple

from pearl_marl.memory_map import Engine, MemoryMap, default_map
from pearl_marl.spec import EnvSpec


class Build(NamedTuple):
    """What decides every file, parameter and address of a design: environment, options and sizes."""

    spec: EnvSpec
    layout: MemoryMap

    @classmethod
    def of(
        cls,
        spec: EnvSpec,
        n_envs: int,
        pe_num: int | None = None,
        data_wl: int | None = None,
        engine: Engine | None = None,
    ) -> Build:
        """Return the build of so many slots; sizes that are not given are those of :func:`default_map`."""
        return cls(spec, default_map(spec, n_envs, pe_num, data_wl, engine))
