"""PPO and DQN of Stable-Baselines3 on this package's environments, and on the same ones of others.

``python -m pearl_marl.experiments.sb3_training CartPole --algo ppo`` trains, and writes a folder; PPO's model
in it is one for ``pearl eval --policy``. With ``--source envpool`` or ``--source gymnasium`` nothing changes
but the library that steps the environments: this is the trainer of the paper's Figure 7.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import typer
from gymnasium.spaces import Box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize
from torch import nn

import pearl_marl
from pearl_marl.benchmark.measure import UnavailableError
from pearl_marl.benchmark.peers import envpool_of
from pearl_marl.benchmark.trainers.sb3 import EnvPoolVecEnv, best_actions
from pearl_marl.benchmark.watch import mean_return
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.experiments.calling import call
from pearl_marl.training.run_folder import RunFolder

MODELS: dict[str, Any] = {"ppo": PPO, "dqn": DQN}

SETTINGS: dict[str, dict[str, Any]] = {
    "ppo": {
        "n_steps": 32,
        "batch_size": 1024,
        "n_epochs": 4,
        "learning_rate": 2e-3,
        "gamma": 0.98,
        "gae_lambda": 0.9,
    },
    "dqn": {
        "train_freq": 1,
        "gradient_steps": 4,
        "batch_size": 256,
        "learning_rate": 2e-3,
        "learning_starts": 10_000,
        "buffer_size": 100_000,
        "exploration_fraction": 0.2,
        "exploration_final_eps": 0.02,
        "target_update_interval": 6400,
        "policy_kwargs": {"net_arch": [64, 64], "activation_fn": nn.Tanh},
    },
}
"""For batches of hundreds of agents; the same for each library that steps them."""

SOURCES = ("pearl", "envpool", "gymnasium")
EVALUATION_LIMIT = 500
"""Steps after which an episode of an evaluation ends: some policies would make no progress for ever."""

console = Console(stderr=True)


def vec_env(source: str, env_id: str, n: int, seed: int) -> VecEnv:
    """Return ``n`` environments for Stable-Baselines3, stepped by one of :data:`SOURCES`."""
    if source not in SOURCES:
        raise ArgumentError(f"--source is {source!r}; possible are {', '.join(map(repr, SOURCES))}")
    oracle = get_spec(env_id).oracle
    if source == "pearl":
        env: VecEnv = pearl_marl.wrappers.sb3_vec_env(pearl_marl.parallel_env(env_id, n_agents=n))
    elif oracle is None or ":" in oracle:
        raise ArgumentError(f"--source {source} has no {env_id}")
    elif source == "envpool":
        try:
            return EnvPoolVecEnv(envpool_of(get_spec(env_id), n, seed), n)
        except UnavailableError as error:
            raise ArgumentError(f"--source envpool: {error}") from None
    else:
        env = DummyVecEnv([partial(gymnasium.make, oracle)] * n)
    env.seed(seed)
    return env


class Evaluating(BaseCallback):
    """Evaluates now and then, with the clock stopped; ends the training once the goal is reached.

    Attributes
    ----------
    points
        Of every evaluation: seconds of training, agent-steps, mean return.
    """

    def __init__(
        self, env_id: str, goal: float | None, every: int, show: Callable[[int, float], None]
    ) -> None:
        super().__init__()
        self.env_id, self.goal, self.every, self.show = env_id, goal, every, show
        self.points: list[tuple[float, int, float]] = []
        self._paused = 0.0

    def _on_training_start(self) -> None:
        self._began = time.perf_counter()
        self._next = self.every

    def _on_step(self) -> bool:
        if self.num_timesteps <= self._next:  # in the step after, the rollout has been learned from
            return True
        self._next += self.every
        stopped = time.perf_counter()
        mean = mean_return(get_spec(self.env_id), best_actions(self.model), EVALUATION_LIMIT)
        self.points.append((stopped - self._began - self._paused, self.num_timesteps, mean))
        self.show(self.num_timesteps, mean)
        self._paused += time.perf_counter() - stopped
        return self.goal is None or mean < self.goal


def train(
    source: str,
    env_id: str,
    algorithm: str,
    n: int,
    steps: int,
    seed: int,
    goal: float | None,
    every: int,
    settings: dict[str, Any] | None = None,
    show: Callable[[int, float], None] = lambda done, mean: None,
) -> tuple[Any, list[tuple[float, int, float]]]:
    """Train until an evaluation reaches the goal; return the model, and the points of :class:`Evaluating`."""
    env = vec_env(source, env_id, n, seed)
    if algorithm == "dqn" and isinstance(env.observation_space, Box):
        env = VecNormalize(env, norm_reward=False)  # without it, few seeds learn
    try:
        given = SETTINGS[algorithm] if settings is None else settings
        model = MODELS[algorithm]("MlpPolicy", env, seed=seed, device="cpu", **given)
        evaluating = Evaluating(env_id, goal, every, show)
        model.learn(steps, callback=evaluating)
    finally:
        env.close()
    return model, evaluating.points


def main(
    env_id: Annotated[str, typer.Argument(metavar="ENV", help="An environment of `pearl envs`.")],
    algo: Annotated[str, typer.Option(help="`ppo` or `dqn`.")] = "ppo",
    n_agents: Annotated[int, typer.Option(help="How many.")] = 256,
    steps: Annotated[int, typer.Option(help="Agent-steps at most.")] = 1_000_000,
    goal: Annotated[
        float | None, typer.Option(help="The mean return that ends the training.", show_default="none")
    ] = None,
    every: Annotated[int, typer.Option(help="Agent-steps between evaluations.")] = 20_000,
    seed: Annotated[int, typer.Option(help="Of the training.")] = 0,
    source: Annotated[str, typer.Option(help="What steps: `pearl`, `envpool` or `gymnasium`.")] = "pearl",
    out: Annotated[Path, typer.Option(help="The run's folder.")] = Path("out/sb3_training"),
) -> None:
    """Train, and write model.zip, metrics and a learning curve; such a run cannot be gone on with."""
    if algo not in MODELS:
        raise typer.BadParameter(f"{algo!r}; possible are 'ppo' and 'dqn'", param_hint="--algo")
    about = {"environment": env_id, "algorithm": algo, "n_agents": n_agents, "steps": steps, "goal": goal}
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.fields[note]}"))
    run = RunFolder(out, {**about, "every": every, "seed": seed, "source": source})
    with run.claimed():
        run.write_config()
        with Progress(*columns, console=console) as bar:
            task = bar.add_task(env_id, total=steps, note="")

            def show(done: int, mean: float) -> None:
                bar.update(task, completed=min(done, steps), note=f"return {mean:.1f}")

            model, points = train(source, env_id, algo, n_agents, steps, seed, goal, every, show=show)
        for seconds, done, mean in points:
            run.report(done, seconds=seconds, eval_return=mean)
        run.write_metrics()
        run.draw_curve(f"{env_id}: {algo} of Stable-Baselines3 on {source}, {n_agents:,} agents", goal)
        model.save(out / "model.zip")
        normalised = model.get_vec_normalize_env()
        if normalised is not None:
            normalised.save(str(out / "normalize.pkl"))
    if points:
        seconds, done, mean = points[-1]
        print(f"Mean return {mean:.1f} after {done:,} agent-steps, {seconds:.1f} s of training.")
    print(f"Wrote {out}: model.zip, metrics.csv, learning_curve.png")


if __name__ == "__main__":
    call(main)
