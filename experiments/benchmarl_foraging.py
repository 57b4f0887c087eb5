"""BenchMARL's algorithms learn level-based foraging, and what share of their time the environments take.

    python experiments/benchmarl_foraging.py --algorithm mappo --out out/benchmarl_foraging

``--through pettingzoo`` is the same by TorchRL's own wrapper of PettingZoo environments, one for each world.
Seconds are of this process's CPU, with one thread, so that other programs on the machine do not count.
"""

from __future__ import annotations

import json
import tempfile
import time
import warnings
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import torch
import typer
from benchmarl.algorithms import IppoConfig, IqlConfig, MappoConfig, QmixConfig, VdnConfig
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from rich.console import Console
from torchrl.envs import PettingZooWrapper, SerialEnv

import pearl_marl
from pearl_marl.base.files import replace_file
from pearl_marl.experiments.calling import call
from pearl_marl.experiments.cpu_clock import CPUClock
from pearl_marl.wrappers.benchmarl import PearlTask
from pearl_marl.wrappers.torchrl import TorchRLEnv

console = Console()


class Algorithm(StrEnum):
    """Those that are tried here."""

    mappo = "mappo"
    ippo = "ippo"
    iql = "iql"
    qmix = "qmix"
    vdn = "vdn"


class Way(StrEnum):
    """How environments get to TorchRL."""

    pearl = "pearl"
    pettingzoo = "pettingzoo"


CONFIGS: dict[str, Any] = {
    "mappo": MappoConfig,
    "ippo": IppoConfig,
    "iql": IqlConfig,
    "qmix": QmixConfig,
    "vdn": VdnConfig,
}
STEPPING: dict[str, tuple[Any, tuple[str, ...]]] = {
    "pearl": (TorchRLEnv, ("_step", "_reset")),
    "pettingzoo": (SerialEnv, ("_step", "_reset")),
}
INSIDE = {"pearl": ("step_batch", "reset_batch", "reset_slots"), "pettingzoo": ("step", "reset")}
"""What of this package's environment either calls."""


class PettingZooTask(PearlTask):
    """The same task as TorchRL and BenchMARL know it without our bridges."""

    def get_env_fun(self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any) -> Any:
        """Return what makes one world; BenchMARL puts many of them one after the other."""
        arguments = {name: value for name, value in self.config.items() if name not in ("state", "wrap")}

        def make() -> Any:
            env = pearl_marl.parallel_env(self.name, autoreset=False, **arguments)
            return PettingZooWrapper(env, seed=seed, device=device)

        return make


class Curve(Callback):  # type: ignore[misc]
    """Notes the return of the episodes that ended in each batch."""

    def __init__(self) -> None:
        super().__init__()
        self.points: list[dict[str, float]] = []

    def on_batch_collected(self, batch: Any) -> None:
        """Note what the players of a world got together, and the CPU seconds until now."""
        (group,) = self.experiment.group_map
        ended = batch["next", "done"][..., 0]
        returns = batch["next", group, "episode_reward"][ended].sum(1)
        point = {
            "frames": self.experiment.total_frames,
            "episodes": len(returns),
            "return": float(returns.mean()),
            "seconds": time.process_time(),
        }
        self.points.append(point)
        console.print(
            "{frames:>9,} steps of worlds: return {return:.3f} of {episodes} episodes".format(**point)
        )


def configured(worlds: int, steps: int, iterations: int, folder: str) -> ExperimentConfig:
    """Return BenchMARL's settings for many worlds at once, and without logs."""
    config = ExperimentConfig.get_from_yaml()
    config.loggers, config.create_json, config.evaluation, config.render = [], False, False, False
    config.save_folder = folder
    config.max_n_frames, config.max_n_iters = None, iterations
    config.lr = 1e-3
    config.gamma = 0.98
    batch = worlds * steps
    config.on_policy_n_envs_per_worker = config.off_policy_n_envs_per_worker = worlds
    config.on_policy_collected_frames_per_batch = config.off_policy_collected_frames_per_batch = batch
    config.on_policy_minibatch_size = max(batch // 8, 1)
    config.on_policy_n_minibatch_iters = 4
    config.off_policy_train_batch_size = 256
    config.off_policy_n_optimizer_steps = 40
    config.off_policy_memory_size = 100_000
    config.polyak_tau = 0.02
    config.exploration_eps_end = 0.1
    config.exploration_anneal_frames = batch * iterations // 2
    return config


def main(
    algorithm: Annotated[Algorithm, typer.Option(help="BenchMARL's.")] = Algorithm.mappo,
    through: Annotated[Way, typer.Option(help="How environments get to TorchRL.")] = Way.pearl,
    worlds: Annotated[int, typer.Option(help="How many worlds of two players.")] = 512,
    steps: Annotated[int, typer.Option(help="Steps of every world between two updates.")] = 25,
    iterations: Annotated[int, typer.Option(help="Updates.")] = 100,
    size: Annotated[int, typer.Option(help="Rows and columns of the grid.")] = 8,
    food: Annotated[int, typer.Option(help="Foods at the start.")] = 3,
    seed: Annotated[int, typer.Option(help="Of everything that is drawn.")] = 0,
    out: Annotated[Path, typer.Option(help="Where the curve goes.")] = Path("out/benchmarl_foraging"),
) -> None:
    """Learn, print the curve and the shares, and write both into a file of the algorithm's name."""
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")  # TorchRL and BenchMARL tell of their own coming changes
    stepping, inside = CPUClock(), CPUClock()
    owner, methods = STEPPING[through]
    stepping.time(owner, *methods)
    inside.time(pearl_marl.PearlParallelEnv, *INSIDE[through])
    curve = Curve()
    settings = CONFIGS[algorithm].get_from_yaml()
    if algorithm in ("mappo", "ippo"):
        settings.entropy_coef = 0.01
    task = PearlTask if through is Way.pearl else PettingZooTask
    with tempfile.TemporaryDirectory() as folder:
        experiment = Experiment(
            task=task(
                "LevelBasedForaging",
                {"state": False, "wrap": None, "field_size": (size, size), "max_num_food": food},
            ),
            algorithm_config=settings,
            model_config=MlpConfig.get_from_yaml(),
            critic_model_config=MlpConfig.get_from_yaml(),
            seed=seed,
            config=configured(worlds, steps, iterations, folder),
            callbacks=[curve],
        )
        stepping.seconds = inside.seconds = 0.0
        began = time.process_time()
        experiment.run()
        whole = time.process_time() - began
    shares = {"whole": whole, "stepping": stepping.seconds, "environment": inside.seconds}
    total = worlds * steps * iterations
    console.print(
        f"{whole:.1f} s of CPU for {total:,} steps of worlds: stepping {stepping.seconds / whole:.1%}, "
        f"the environment {inside.seconds / whole:.1%}"
    )
    written = {"worlds": worlds, "steps": steps, "seconds": shares, "curve": curve.points}
    replace_file(out / f"{algorithm}_{through}.json", json.dumps(written, indent=2).encode())


if __name__ == "__main__":
    call(main)
