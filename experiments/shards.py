"""How long updates gather and learn, with agents stepped by this process and by shards on this machine.

``python experiments/shards.py`` prints the table of docs/scaling.md ("Weights travel instead of steps").
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from statistics import median
from typing import Any

import torch

from pearl_marl.benchmark.tables import MeasuredTable
from pearl_marl.envs import get_spec
from pearl_marl.experiments.calling import call
from pearl_marl.training.ppo import PPO
from pearl_marl.training.rollout import RolloutBuffer
from pearl_marl.training.run import settings_for

TRAININGS: dict[str, dict[str, Any]] = {
    "CartPole": {"n_agents": 8192, "rollout_length": 32},
    "Seaquest": {"n_agents": 2048, "rollout_length": 32, "epochs": 1},
}
SHARDS = None, 1, 2
UPDATES = 5


def main() -> None:
    """Print the table in Markdown."""
    torch.set_num_threads(1)
    rows = []
    for name, changes in TRAININGS.items():
        times = [measured(name, changes, shards, UPDATES) for shards in SHARDS]
        learning = [learns for _, learns in times]
        size = f"{changes['n_agents']:,}, {changes['rollout_length']}"
        gathering = [f"{1000 * gathers:,.0f} ms" for gathers, _ in times]
        between = f"{1000 * min(learning):,.0f} to {1000 * max(learning):,.0f} ms"
        rows.append((name, size, *gathering, between))
    headings = "", "agents, steps of each", "gathering: no shards", "1 shard", "2 shards", "learning"
    print(MeasuredTable(headings, rows, (0,)).markdown())


def measured(name: str, changes: Mapping[str, Any], shards: int | None, updates: int) -> tuple[float, float]:
    """Return the seconds in which PPO gathers and learns: medians of so many updates, after a first one."""
    # Agents are in as many blocks for any number of shards, and for none.
    settings = settings_for("ppo", name, dict(changes), shards or 1)
    trainer = PPO(get_spec(name), "native", settings, shards)
    gather, gathers, learns = trainer.worker.gather, [], []

    def timed(rollout: int) -> RolloutBuffer:
        began = time.perf_counter()
        result: RolloutBuffer = gather(rollout)
        gathers.append(time.perf_counter() - began)
        return result

    trainer.worker.gather = timed
    for _ in range(1 + updates):
        began = time.perf_counter()
        trainer.iterate()
        learns.append(time.perf_counter() - began - gathers[-1])
    return median(gathers[1:]), median(learns[1:])


if __name__ == "__main__":
    call(main)
