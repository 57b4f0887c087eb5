"""Everything that ``pearl bench`` times."""

from __future__ import annotations

from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.results import check_memory
from pearl_marl.benchmark.gpu import on_gpu
from pearl_marl.benchmark.measure import Contender
from pearl_marl.benchmark.ours import ours
from pearl_marl.benchmark.peers import peers
from pearl_marl.spec import EnvSpec


def contenders(spec: EnvSpec, n: int) -> list[Contender]:
    """Return this package at each of its levels, and its peers, for one environment."""
    check_memory(BatchConfig(spec=spec, n_envs=n))
    return [*ours(spec, n), *on_gpu(spec, n), *peers(spec, n)]
