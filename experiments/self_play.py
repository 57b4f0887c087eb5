"""How a player of ConnectFour became better: its past selves, against each other and by a perfect player.

Reads the folder of ``pearl train ConnectFour --algo self-play``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer
from pearl_marl.experiments.perfect_play import ILLEGAL, Judge
from rich.console import Console
from rich.table import Table

from pearl_marl.batch.actions import random_actions
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.errors import PearlError
from pearl_marl.evaluation.matches import Match, cross_table
from pearl_marl.policies.loading import RANDOM, Policy, load_policy
from pearl_marl.registry import get_spec

Array = npt.NDArray[Any]

FIRST, LAST = 14, 24
"""Discs on the boards that are judged: with fewer, a perfect player takes too long."""

SPEC = get_spec("ConnectFour")


def positions(count: int, seed: int = 0) -> tuple[Array, Array]:
    """Return what players of random games see who are on turn, and what each column is worth to them.

    Only where there is something to do wrong: where not all columns are worth the same.
    """
    rng, judge = np.random.default_rng(seed), Judge()
    found: list[tuple[Array, Array]] = []
    device = Native().open(BatchConfig(spec=SPEC, n_envs=4 * count))
    obs = device.reset(seed)
    while sum(len(values) for _, values in found) < count:
        masks = device.action_masks
        assert masks is not None
        # Of each game in a while one position: those after each other are alike.
        discs = obs.sum((1, 2, 3), dtype=np.int64)
        rows = masks.any(1) & (discs >= FIRST) & (discs <= LAST) & (rng.random(len(obs)) < 0.02)
        seen = obs[rows]
        values = judge.values(seen)
        open_to_error = np.where(values == ILLEGAL, values.max(1, keepdims=True), values).min(1) < values.max(
            1
        )
        found.append((seen[open_to_error], values[open_to_error]))
        obs = device.step(random_actions(SPEC, rng, len(obs), masks)).obs
    device.close()
    seen, values = (np.concatenate(parts)[:count] for parts in zip(*found, strict=True))
    return seen, values


def share_of_optimal(policy: Policy, seen: Array, values: Array) -> float:
    """Return the share of positions in which a policy chooses a column that is worth as much as any."""
    actions = np.asarray(policy(seen, (values != ILLEGAL).astype(np.int8)))
    return float((values[np.arange(len(values)), actions] == values.max(1)).mean())


def main(
    run: Annotated[Path, typer.Argument(help="The run's folder.")],
    members: Annotated[int, typer.Option(help="How many past selves to show, evenly spread.")] = 6,
    games: Annotated[int, typer.Option(help="Games of each pair.")] = 1000,
    judged: Annotated[int, typer.Option(help="Positions for the perfect player to judge.")] = 1000,
) -> None:
    """Print wins of past selves against a random player, how many moves are as good as any, a cross table."""
    console = Console(highlight=False)
    try:
        files = sorted((run / "past").glob("*.safetensors"))
        chosen = [files[k] for k in sorted({round(k) for k in np.linspace(0, len(files) - 1, members)})]
        policies = {str(int(file.stem)): load_policy(str(file), SPEC) for file in chosen if files}
        policies["last"] = load_policy(str(run), SPEC)
    except PearlError as error:
        console.print(f"Error: {error}")
        raise typer.Exit(2) from None
    seen, values = positions(judged)
    table = Table("after iteration", "against random: won", "drawn", "lost", "moves as good as any")
    chance = share_of_optimal(load_policy(RANDOM, SPEC), seen, values)
    table.add_row(RANDOM, "", "", "", f"{chance:.1%}")
    for name, policy in policies.items():
        match = Match(SPEC, policy, load_policy(RANDOM, SPEC, 1), 2 * games, openings=0)
        for _ in match.run():
            pass
        out = match.outcome()
        shares = (f"{out[what] / out['games']:.1%}" for what in ("wins", "draws", "losses"))
        table.add_row(name, *shares, f"{share_of_optimal(policy, seen, values):.1%}")
    console.print(table)
    won: dict[tuple[str, str], float] = {}
    for row in cross_table(SPEC, policies, 2 * games):
        first, second = row["policy"], row["against"]
        won[first, second] = row["wins"] / row["games"]
        won[second, first] = row["losses"] / row["games"]
    cross = Table("won against", *policies)
    for name in policies:
        cross.add_row(name, *(f"{won[name, other]:.0%}" if name != other else "-" for other in policies))
    console.print(cross)


if __name__ == "__main__":
    typer.run(main)
