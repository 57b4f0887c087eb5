"""Tabular Q-learning of CliffWalking: thousands of agents, one shared table.

All agents explore at once and write into one table of 48 x 4 values. A step's updates are averaged
for each state and action, so one step of all agents is one update of the table, and the table is
right after a few hundred steps.

    python experiments/cliff_walking_q_learning.py --out out/demo
"""

from __future__ import annotations

import contextlib
import io
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

import pearl_marl
from pearl_marl.base.files import replace_file
from pearl_marl.evaluation.episodes import EpisodeStatistics
from pearl_marl.experiments.calling import call
from pearl_marl.rendering import new_figure, save_figure

ROWS, COLUMNS, START, GOAL = 4, 12, 36, 47
OPTIMAL_RETURN = -13
ARROWS = "↑→↓←"
EVALUATE_EVERY = 2
EXPLORING = 0.8  # the part of the steps in which agents explore less and less

Table = npt.NDArray[np.float64]
console = Console()


def main(
    n_agents: Annotated[int, typer.Option(help="How many agents share the table.")] = 43008,
    steps: Annotated[int, typer.Option(help="Steps of every agent.")] = 300,
    epsilon: Annotated[float, typer.Option(help="How often an agent explores at first; falls to 0.")] = 0.2,
    learning_rate: Annotated[float, typer.Option(help="Of the averaged update.")] = 0.5,
    discount: Annotated[float, typer.Option(help="Of the next state's value.")] = 1.0,
    seed: Annotated[int, typer.Option(help="Of everything random.")] = 0,
    device: Annotated[str, typer.Option(help="Where the agents are stepped.")] = "native",
    out: Annotated[Path, typer.Option(help="Where the curve and the table go.")] = Path("out/demo"),
) -> None:
    """Learn, draw the policy, and write learning_curve.png, q_learning.json and q_table.npy."""
    table = np.zeros((ROWS * COLUMNS, 4))
    with contextlib.closing(pearl_marl.parallel_env("CliffWalking", n_agents, device=device)) as env:
        curve = learn(table, env, steps, epsilon, learning_rate, discount, seed)

    solved = next((point for point in curve if point["greedy_return"] == OPTIMAL_RETURN), None)
    console.print(draw_policy(table))
    if solved is None:
        console.print(
            f"The optimal return of {OPTIMAL_RETURN} was not reached in {steps} steps.", style="red"
        )
    else:
        console.print(
            f"Optimal return of {OPTIMAL_RETURN} after {solved['seconds']:.2f} s "
            f"and {solved['agent_steps']:,} agent-steps."
        )
    saved = io.BytesIO()
    np.save(saved, table)
    replace_file(out / "q_table.npy", saved.getvalue())
    about = {"n_agents": n_agents, "seed": seed, "curve": curve}
    replace_file(out / "q_learning.json", json.dumps(about, indent=2).encode())
    draw_curve(curve, n_agents, out / "learning_curve.png")
    console.print(f"Wrote {out}/learning_curve.png, q_learning.json and q_table.npy", markup=False)
    if solved is None:
        raise typer.Exit(1)


def learn(
    table: Table,
    env: pearl_marl.PearlParallelEnv,
    steps: int,
    epsilon: float,
    learning_rate: float,
    discount: float,
    seed: int,
) -> list[dict[str, Any]]:
    """Step all agents and write what they learn into the table; return the learning curve."""
    rng = np.random.default_rng(seed)
    n_agents = len(env.possible_agents)
    obs = env.reset_batch(seed)
    curve: list[dict[str, Any]] = []
    statistics = EpisodeStatistics(n_agents)
    columns = (TextColumn("Q-learning"), BarColumn(), TimeElapsedColumn(), TextColumn("{task.fields[note]}"))
    began = time.perf_counter()
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("learn", total=steps, note="")
        for step in range(1, steps + 1):
            greedy = table.argmax(axis=1).astype(np.uint8)
            explores = rng.random(n_agents, np.float32) < epsilon * (1 - step / (EXPLORING * steps))
            actions = np.where(explores, rng.integers(0, 4, n_agents, np.uint8), greedy[obs])
            result = env.step_batch(actions)
            update(table, obs, actions, result, learning_rate, discount)
            statistics.add(result)
            obs = result.obs
            if step % EVALUATE_EVERY and step < steps:
                continue
            point = {
                "agent_steps": step * n_agents,
                "seconds": time.perf_counter() - began,
                "greedy_return": evaluate(table),
                "exploring_return": statistics.summary()["return_mean"],
            }
            statistics.clear()
            curve.append(point)
            found = point["greedy_return"]
            shown = "not at the goal yet" if found is None else f"return {found:g}"
            note = f"{step * n_agents / 1e6:.1f} M steps, {shown}"
            progress.update(task, advance=EVALUATE_EVERY, note=note)
    return curve


def update(
    table: Table,
    obs: npt.NDArray[Any],
    actions: npt.NDArray[Any],
    result: pearl_marl.devices.BatchStep,
    learning_rate: float,
    discount: float,
) -> None:
    """Move each visited entry towards the mean of its targets."""
    # arrivals() is where the step itself led: bootstrapping from the next episode's start would be wrong.
    targets = result.rewards + discount * table.max(axis=1)[result.arrivals()] * ~result.terminations
    entries = obs * 4 + actions
    visits = np.bincount(entries, minlength=table.size)
    means = np.bincount(entries, targets, minlength=table.size) / np.maximum(visits, 1)
    flat = table.reshape(-1)
    flat += np.where(visits, learning_rate * (means - flat), 0)


def greedy_steps(table: Table) -> Iterator[pearl_marl.devices.BatchStep]:
    """Yield what the greedy policy meets in its first episode, in 100 steps at most.

    On the CPU, whatever device learns: all give the same answers, and a board may serve one at a time.
    """
    with contextlib.closing(pearl_marl.parallel_env("CliffWalking", 1)) as env:
        obs = env.reset_batch(seed=0)
        for _ in range(100):
            result = env.step_batch(table.argmax(axis=1)[obs])
            yield result
            if result.terminations[0]:
                return
            obs = result.obs


def evaluate(table: Table) -> float | None:
    """Return the greedy policy's return, or None if it does not reach the goal."""
    steps = list(greedy_steps(table))
    return sum(float(step.rewards[0]) for step in steps) if steps[-1].terminations[0] else None


def draw_policy(table: Table) -> Text:
    """Return the greedy action of every cell as arrows, with the path from start to goal in colour."""
    path = {START, *(int(step.arrivals()[0]) for step in greedy_steps(table))}
    text = Text()
    for cell in range(ROWS * COLUMNS):
        if cell == GOAL:
            symbol, style = "G", "bold green"
        elif START < cell < GOAL:
            symbol, style = "▒", "red"
        else:
            symbol = ARROWS[int(table[cell].argmax())]
            style = "bold green" if cell in path else "dim"
        text.append(f" {symbol}", style)
        if cell % COLUMNS == COLUMNS - 1:
            text.append("\n")
    return text


def draw_curve(curve: list[dict[str, Any]], n_agents: int, path: Path) -> None:
    """Write the learning curve as a picture."""
    figure = new_figure(7, 4)
    from matplotlib.ticker import LogLocator, NullFormatter

    axes = figure.subplots()
    steps = np.array([point["agent_steps"] for point in curve]) / 1e6
    for key, label in (
        ("exploring_return", "while exploring (mean of episodes that ended)"),
        ("greedy_return", "greedy policy"),
    ):
        costs = [np.nan if point[key] is None else -point[key] for point in curve]
        axes.plot(steps, costs, label=label, marker=".", markersize=4)
    axes.axhline(-OPTIMAL_RETURN, color="grey", linestyle="--", label=f"optimal: {OPTIMAL_RETURN}")
    axes.set(xlabel="agent-steps (millions)", ylabel="return (log scale)", yscale="log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(lambda value, _: f"-{value:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.invert_yaxis()
    axes.set_title(f"CliffWalking: tabular Q-learning, {n_agents:,} agents, one shared table")
    axes.grid(alpha=0.3)
    axes.legend()
    save_figure(figure, path)


if __name__ == "__main__":
    call(main)
