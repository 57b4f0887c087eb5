"""How a player of ConnectFour became better: its past selves, against each other and by a perfect player.

Reads the folder of ``pearl train ConnectFour --algo self-play``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from pearl_marl.base.arrays import Array
from pearl_marl.batch.actions import random_actions
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation.matches import Match, cross_table
from pearl_marl.experiments.calling import call
from pearl_marl.experiments.perfect_play import ILLEGAL, Judge
from pearl_marl.policies import trained
from pearl_marl.policies.loading import RANDOM, Policy, random_policy

FIRST, LAST = 14, 24
"""Discs on the boards that are judged: with fewer, a perfect player takes too long."""

STRAY = 0.2
"""Share of random moves in games of the last policy, so that they differ."""

SPEC = get_spec("ConnectFour")


def positions(
    count: int, policy: Policy | None = None, share: float = 1.0, seed: int = 0
) -> tuple[Array, Array]:
    """Return what players who are on turn see, and what each column is worth to them.

    They play at random, or by a policy but for a ``share`` of moves. Only positions where there is something
    to do wrong count: where not all columns are worth the same.
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
        actions = random_actions(SPEC, rng, len(obs), masks)
        if policy is not None:
            actions = np.where(rng.random(len(obs)) < share, actions, policy(obs, masks))
        obs = device.step(actions).obs
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
    judged: Annotated[int, typer.Option(help="Positions of each kind that a perfect player judges.")] = 500,
) -> None:
    """Print wins of past selves against a random player, their shares of optimal moves, and a cross table."""
    console = Console(highlight=False)
    files = sorted((run / "past").glob("*.safetensors"))
    if not files:
        raise ArgumentError(f"{run} has no folder past/: give that of a run of --algo self-play")
    chosen = [files[k] for k in sorted({round(k) for k in np.linspace(0, len(files) - 1, members)})]
    policies = {str(int(file.stem)): trained.load(file).choose for file in chosen}
    policies["last"] = trained.load(run).choose
    sets = positions(judged), positions(judged, policies["last"], STRAY)
    headings = "optimal in random games", "in games of the last"
    table = Table("after iteration", "against random: won", "drawn", "lost", *headings)
    chance = (share_of_optimal(random_policy(SPEC), *each) for each in sets)
    table.add_row(RANDOM, "", "", "", *(f"{share:.1%}" for share in chance))
    for name, policy in policies.items():
        match = Match(SPEC, policy, random_policy(SPEC, 1), 2 * games, openings=0)
        for _ in match.run():
            pass
        out = match.outcome()
        shares = [out[what] / out["games"] for what in ("wins", "draws", "losses")]
        shares += [share_of_optimal(policy, *each) for each in sets]
        table.add_row(name, *(f"{share:.1%}" for share in shares))
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
    call(main)
