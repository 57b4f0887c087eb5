"""What policies lose in integers: every environment with a trained preset, in one table.

``python -m experiments.integer_policies`` trains each by its preset, quantises it, and prints the returns of
both in Markdown. ``--only CartPole`` does one; what has been trained in ``--out`` is not trained again.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from pearl_marl.benchmark.tables import MeasuredTable
from pearl_marl.envs import get_spec

TRAININGS: dict[str, tuple[str, ...]] = {
    "CliffWalking": ("--algo", "q-learning"),
    "FrozenLake": ("--algo", "q-learning"),
    "Taxi": ("--algo", "q-learning"),
    "Blackjack": ("--algo", "q-learning"),
    **dict.fromkeys(
        (
            *("CartPole", "MountainCar", "Acrobot", "MountainCarContinuous", "Pendulum"),
            *("Asterix", "Breakout", "Freeway", "Seaquest", "SpaceInvaders"),
            *("MiniGridDoorKey", "MiniGridFourRooms", "Elevators"),
            *("SimpleSpread", "SimpleTag", "CoinGame", "LevelBasedForaging", "RobotWarehouse"),
        ),
        ("--algo", "ppo"),
    ),
    # Their settings are for these options.
    "Overcooked": ("--algo", "ppo", "--option", "reward_shaping_factor=1"),
    "Snake": ("--algo", "ppo", "--option", "num_rows=6", "--option", "num_cols=6"),
    **dict.fromkeys(("ConnectFour", "KuhnPoker", "LeducPoker"), ("--algo", "self-play")),
}
"""How each is trained."""


def pearl(*arguments: str) -> Any:
    """Run a command of ``pearl``; return its figures."""
    call = [sys.executable, "-m", "pearl_marl", *arguments, "--json"]
    return json.loads(subprocess.run(call, stdout=subprocess.PIPE, check=True, text=True).stdout)


def row(figures: dict[str, Any], algorithm: str) -> tuple[str, ...]:
    """Return a row of the table: both returns, and the change with its interval."""
    means = [f"{figures[name]['mean']:,.3g}" for name in ("return_before", "return_after")]
    change = figures["change"]
    return (
        figures["environment"].removesuffix("-v0").removesuffix("-v1"),
        algorithm,
        *means,
        f"{change['mean']:+.3g}",
        f"{change['ci95_low']:+.3g} to {change['ci95_high']:+.3g}",
    )


def main(
    only: Annotated[list[str] | None, typer.Option("--only", metavar="ENV")] = None,
    n_agents: Annotated[int, typer.Option("--n-agents", help="Agents, an episode each.")] = 1000,
    out: Annotated[Path, typer.Option("--out", help="The folder of the runs.")] = Path("out/integers"),
) -> None:
    """Train, quantise, and print the table."""
    rows = []
    for name in only or TRAININGS:
        arguments, run = TRAININGS[name], out / name
        if not (run / "policy.safetensors").exists():
            pearl("train", name, *arguments, "--out", str(run))
        agents = get_spec(name).agents
        figures = pearl("quantize", str(run), "--n-agents", str(n_agents // agents * agents))
        rows.append(row(figures, arguments[1]))
        print(*rows[-1], flush=True)
    headings = ("", "trained by", "return", "in integers", "change", "95 % confidence")
    print(MeasuredTable(headings, rows, (0, 1)).markdown())


if __name__ == "__main__":
    typer.run(main)
