"""Policies trained on the native device, evaluated on others: the same digests.

Q-learning of CliffWalking and Blackjack, where all agents share one table, and PPO of CartPole. Each policy
is saved as a file, unless it is there already, loaded again, and evaluated on every device.

    python experiments/evaluation.py --device native --device rtl --out out/evaluation

``{env}`` in a device's name becomes the environment's, so that there can be a served board for each:
``--device "xdma:boards/{env}"``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from gymnasium.spaces import Tuple
from rich.console import Console
from rich.progress import track

import pearl_marl
from pearl_marl.evaluation import Evaluation
from pearl_marl.policies import load_policy

SIZES = {"CliffWalking": 43008, "Blackjack": 256, "CartPole": 256}
"""How many agents: CliffWalking at full size, the others at one whose models compile in two minutes."""

EPISODES = {"CliffWalking": 43008, "Blackjack": 2560, "CartPole": 1024}

console = Console(stderr=True)


def main(
    device: Annotated[list[str] | None, typer.Option(help="Where to evaluate; may be repeated.")] = None,
    out: Annotated[Path, typer.Option(help="Where the policies go.")] = Path("out/evaluation"),
) -> None:
    """Train, evaluate, and print a table in Markdown; exit with 1 if digests differ."""
    out.mkdir(parents=True, exist_ok=True)
    files = {
        "CliffWalking": out / "CliffWalking.npy",
        "Blackjack": out / "Blackjack.npy",
        "CartPole": out / "CartPole.zip",
    }
    train: dict[str, Callable[[], Any]] = {
        "CliffWalking": lambda: q_learning("CliffWalking", 43008, 300, 0.5, files["CliffWalking"]),
        "Blackjack": lambda: q_learning("Blackjack", 43008, 600, 0.05, files["Blackjack"]),
        "CartPole": lambda: ppo("CartPole", files["CartPole"]),
    }
    for env_id, path in files.items():
        if not path.exists():
            train[env_id]()
    print("| environment | device | agents | episodes | return | digest |")
    print("| --- | --- | ---: | ---: | ---: | --- |")
    same = True
    for env_id, path in files.items():
        digests = set()
        for name in device or ["native", "rtl"]:
            spec, n = pearl_marl.get_spec(env_id), SIZES[env_id]
            evaluation = Evaluation(
                spec, load_policy(str(path), spec), n, name.format(env=env_id), episodes=EPISODES[env_id]
            )
            for _ in track(evaluation.run(), f"{env_id} on {name}", EPISODES[env_id], console=console):
                pass
            found = evaluation.summary()
            digests.add(found["digest"])
            mean = found["return"]["mean"]
            print(
                f"| {env_id} | `{name.partition(':')[0]}` | {n:,} | {found['episodes']:,} | "
                f"{mean:,.3f} ± {mean - found['return']['ci95_low']:,.3f} | `{found['digest'][:16]}` |"
            )
        same &= len(digests) == 1
    if not same:
        raise typer.Exit(1)


def q_learning(env_id: str, n: int, steps: int, rate: float, path: Path) -> None:
    """Learn a table with all agents, who explore less and less; save it."""
    env = pearl_marl.parallel_env(env_id, n)
    space: Any = env.spec.observation_space
    action_space: Any = env.spec.action_space
    parts: Any = space.spaces if isinstance(space, Tuple) else (space,)
    shape = tuple(int(part.n) for part in parts)
    actions_n = int(action_space.n)
    table = np.zeros((int(np.prod(shape)), actions_n))
    rng = np.random.default_rng(0)

    def index(observations: Any) -> Any:
        return np.ravel_multi_index(observations.T if len(shape) > 1 else (observations,), shape)

    state = index(env.reset_batch(seed=0))
    for step in track(range(steps), f"{env_id}: Q-learning", console=console):
        explores = rng.random(n) < max(0.0, 0.2 * (1 - step / (0.8 * steps)))
        actions = np.where(explores, rng.integers(0, actions_n, n), table.argmax(1)[state])
        result = env.step_batch(actions)
        targets = result.rewards + table.max(1)[index(result.arrivals())] * ~result.terminations
        entries = state * actions_n + actions
        visits = np.bincount(entries, minlength=table.size)
        means = np.bincount(entries, targets, minlength=table.size) / np.maximum(visits, 1)
        flat = table.reshape(-1)
        flat += np.where(visits, rate * (means - flat), 0)
        state = index(result.obs)
    env.close()
    np.save(path, table.reshape(*shape, actions_n))


def ppo(env_id: str, path: Path) -> None:
    """Train a model of Stable-Baselines3 and save it."""
    from stable_baselines3 import PPO

    env = pearl_marl.wrappers.sb3_vec_env(pearl_marl.parallel_env(env_id, n_agents=64))
    model = PPO("MlpPolicy", env, n_steps=128, batch_size=1024, gamma=0.98, seed=0, device="cpu")
    with console.status(f"{env_id}: PPO"):
        model.learn(150_000)
    model.save(path)


if __name__ == "__main__":
    typer.run(main)
