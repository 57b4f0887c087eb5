"""What collecting a rollout for Stable-Baselines3's PPO costs, by our bridge and by SuperSuit's chain.

Rollouts are collected in turns, and medians are quoted. Times are of this process's CPU, with one
thread, so that other programs on the machine do not count.

    python experiments/sb3_rollout.py --out out/sb3_rollout
"""

from __future__ import annotations

import json
import statistics
import time
import warnings
from pathlib import Path
from typing import Annotated, Any

import stable_baselines3
import torch
import typer
from rich.console import Console
from rich.table import Table

import pearl_marl
from pearl_marl.base.files import replace_file
from pearl_marl.devices import Native
from pearl_marl.experiments.calling import call
from pearl_marl.experiments.cpu_clock import CPUClock

console = Console()


class RolloutTiming:
    """PPO about to collect rollouts from one vector environment."""

    def __init__(self, name: str, env: Any, vec_env: Any, steps: int) -> None:
        self.name, self.n, self.steps = name, vec_env.num_envs, steps
        self.inside, self.stepping = CPUClock(), CPUClock()
        self.stepping.time(vec_env, "step")
        # SuperSuit steps a copy, so of its chain the environment's part is not told apart.
        self.inside.time(env, "step_batch")
        # A chain with no seed() cannot take one here.
        self.model = stable_baselines3.PPO("MlpPolicy", vec_env, n_steps=steps, batch_size=1024)
        _, self.callback = self.model._setup_learn(1)
        self.rounds: list[dict[str, float]] = []

    def collect(self) -> None:
        """Collect one rollout; write down the milliseconds of a step of all slots."""
        self.inside.seconds = self.stepping.seconds = 0.0
        began = time.process_time()
        model = self.model
        assert model.env is not None
        model.collect_rollouts(model.env, self.callback, model.rollout_buffer, self.steps)
        scale = 1000 / self.steps
        whole = (time.process_time() - began) * scale
        stepping, inside = self.stepping.seconds * scale, self.inside.seconds * scale
        self.rounds.append({"rollout": whole, "stepping": stepping, "environment": inside})

    def medians(self) -> dict[str, float]:
        """Return the median of every figure, without the first round, which compiles."""
        return {key: statistics.median(r[key] for r in self.rounds[1:]) for key in self.rounds[0]}


def supersuit_chain(env: Any) -> Any:
    """Return SuperSuit's conversion for SB3."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it tells of its successor
        import supersuit

        env = supersuit.pettingzoo_env_to_vec_env_v1(env)
        return supersuit.concat_vec_envs_v1(env, 1, num_cpus=1, base_class="stable_baselines3")


def main(
    env_id: Annotated[str, typer.Option(help="A name of pearl_marl.list_envs().")] = "CartPole",
    n_agents: Annotated[list[int], typer.Option(help="How many; may be given more than once.")] = [  # noqa: B006
        1024,
        43008,
    ],
    steps: Annotated[int, typer.Option(help="Steps of every slot in a rollout.")] = 8,
    rounds: Annotated[int, typer.Option(help="Rollouts of each chain, after a first one.")] = 3,
    out: Annotated[Path, typer.Option(help="Where the figures go.")] = Path("out/sb3_rollout"),
) -> None:
    """Measure, print the table and write sb3_rollout.json."""
    torch.set_num_threads(1)
    table = Table(title=f"{env_id}: milliseconds of CPU for one step of all slots, medians")
    for heading in ("chain", "agents", "rollout", "of it stepping", "of that the environment", "stepping"):
        table.add_column(heading, justify="left" if heading == "chain" else "right")
    figures = []
    for n in n_agents:
        contenders = []
        for name, chain in (("ours", pearl_marl.wrappers.sb3_vec_env), ("SuperSuit", supersuit_chain)):
            env = pearl_marl.parallel_env(env_id, n, device=Native(threads=1))
            contenders.append(RolloutTiming(name, env, chain(env), steps))
        for _ in range(rounds + 1):
            for contender in contenders:
                contender.collect()
        for contender in contenders:
            row = contender.medians()
            share = row["stepping"] / row["rollout"]
            figures.append({"name": contender.name, "n_agents": n, **row, "share": share})
            inside = f"{row['environment']:.2f}" if row["environment"] else ""
            numbers = f"{row['rollout']:.2f}", f"{row['stepping']:.2f}", inside
            table.add_row(contender.name, f"{n:,}", *numbers, f"{share:.1%}")
    console.print(table)
    replace_file(out / "sb3_rollout.json", json.dumps(figures, indent=2).encode())


if __name__ == "__main__":
    call(main)
