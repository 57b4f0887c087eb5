"""``pearl match``: policies against each other."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.markup import escape

from pearl_marl.benchmark.tables import MeasuredTable
from pearl_marl.cli import common
from pearl_marl.cli.common import console
from pearl_marl.errors import ArgumentError, LockstepError
from pearl_marl.evaluation.machine import machine
from pearl_marl.evaluation.matches import OPENINGS, cross_table
from pearl_marl.evaluation.run import LIMIT
from pearl_marl.policies.loading import load_policy


def command(
    env_id: common.EnvName,
    policies: Annotated[
        list[str],
        typer.Argument(
            metavar="POLICY POLICY...",
            help="Two policies or more, each anything that `pearl eval --policy` takes.",
        ),
    ],
    openings: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="The number of random steps at the start of every episode.",
            show_default=f"{OPENINGS} in games of turns",
        ),
    ] = None,
    n_agents: common.Agents = None,
    device: common.DeviceName = "native",
    seed: common.Seed = 0,
    max_cycles: Annotated[int | None, common.max_cycles_option(f"the environment's, or {LIMIT:,}")] = None,
    lockstep: common.InLockstep = False,
    option: common.Options = None,
    out: common.Out = None,
    as_json: common.AsJson = False,
    as_markdown: common.AsMarkdown = False,
) -> None:
    """Let policies play each other where agents share a world: who wins, and what returns they get.

    Of each pair, the first plays one agent of each world, every seat equally often, and the second all
    others; every agent plays one episode. Exit status 1: with --lockstep, the device differs from the golden
    functions.
    """
    common.check_forms(as_json, as_markdown)
    spec = common.spec_of(env_id, option)
    n_agents = common.agents_of(spec, n_agents)
    if len(policies) < 2:
        raise ArgumentError("a match needs two policies: name another one")
    names = [f"{name} ({k + 1})" if policies.count(name) > 1 else name for k, name in enumerate(policies)]
    divergence = common.divergence_file(spec, device)
    common.check_results(out, "matches.json", *([divergence] if lockstep else []))
    make_device = common.device_maker(device, lockstep)
    loaded = {names[k]: load_policy(policy, spec, seed + k) for k, policy in enumerate(policies)}
    settings: dict[str, Any] = {"seed": seed, "max_cycles": max_cycles, "openings": openings}
    pairs = len(loaded) * (len(loaded) - 1) // 2
    label = f"{spec.name} on {device}, {n_agents:,} agents: pairs"
    try:
        outcomes = cross_table(spec, loaded, n_agents, make_device, **settings)
        rows = list(common.progress(outcomes, pairs, label))
    except LockstepError as error:
        common.end_with(error, out, divergence, env_id, device)
    result = {
        "environment": spec.id,
        "options": dict(spec.options),
        "n_agents": n_agents,
        "device": device,
        **settings,
        "lockstep": common.REFERENCE if lockstep else None,
        "matches": rows,
        "machine": machine(),
    }
    if common.delivered(result, as_json, out, "matches.json"):
        return
    table = _pairs(rows) if len(names) == 2 else _wins(names, rows)
    common.print_table(f"{spec.name}: matches", table, [], as_markdown)
    if lockstep and not as_markdown:
        console.print(f"{escape(device)} is bit-exact with {common.REFERENCE}.", style="bold green")


def _pairs(rows: list[dict[str, Any]]) -> MeasuredTable:
    headings = "policy", "against", "games", "won", "drawn", "lost", "return", "its return"
    return MeasuredTable(
        headings,
        [
            (
                row["policy"],
                row["against"],
                f"{row['games']:,}",
                *(f"{row[ending] / row['games']:.1%}" for ending in ("wins", "draws", "losses")),
                *(f"{row[what]['mean']:,.3f}" for what in ("return", "their_return")),
            )
            for row in rows
        ],
        (0, 1),
    )


def _wins(names: list[str], rows: list[dict[str, Any]]) -> MeasuredTable:
    """Return a row for each policy, with the share of games that it won against each of the others."""
    won: dict[tuple[str, str], float] = {}
    for row in rows:
        won[row["policy"], row["against"]] = row["wins"] / row["games"]
        won[row["against"], row["policy"]] = row["losses"] / row["games"]
    numbers = [str(k + 1) for k in range(len(names))]
    cells = [[f"{won[name, other]:.1%}" if name != other else "-" for other in names] for name in names]
    return MeasuredTable(
        ("", "won against", *numbers),
        [(number, name, *row) for number, name, row in zip(numbers, names, cells, strict=True)],
        (0, 1),
    )
