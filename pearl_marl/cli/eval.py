"""``pearl eval``: a policy on any device."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from pearl_marl.benchmark.machine import machine
from pearl_marl.benchmark.measure import duration
from pearl_marl.checks import MANY
from pearl_marl.cli import common
from pearl_marl.cli.common import console, error_console
from pearl_marl.devices import Lockstep
from pearl_marl.errors import ArgumentError, LockstepError, PearlError
from pearl_marl.evaluation.matches import OPENINGS, Match, cross_table
from pearl_marl.evaluation.report import write_report
from pearl_marl.evaluation.run import LIMIT, Evaluation
from pearl_marl.policies.loading import load_policy
from pearl_marl.spec import MAX_CYCLES, EnvSpec

PolicyName = Annotated[
    str,
    typer.Option(
        "--policy",
        help="`random`, a table of action values (FILE.npy, FILE.npz), a model of Stable-Baselines3 "
        "(FILE.zip), a folder of `pearl train`, or a function of observations (MODULE:FUNCTION, "
        "FILE.py:FUNCTION).",
    ),
]
Against = Annotated[
    list[str] | None,
    typer.Option(
        "--against",
        help="Another policy, which plays all agents of a world but one. Repeat it for a table of "
        "who beats whom.",
        show_default="none",
    ),
]
Openings = Annotated[
    int | None,
    typer.Option(
        "--openings",
        min=0,
        help="With --against: the number of random steps at the start of every episode.",
        show_default=f"{OPENINGS} in games of turns",
    ),
]
Episodes = Annotated[
    int | None,
    typer.Option(
        "--episodes", min=1, max=MANY, help="Number of episodes that count.", show_default="one an agent"
    ),
]
MaxCycles = Annotated[
    int | None,
    typer.Option(
        "--max-cycles",
        min=0,
        max=MAX_CYCLES,
        help="Time limit of an episode, 0 for none.",
        show_default=f"the environment's, or {LIMIT:,}",
    ),
]
InLockstep = Annotated[
    bool, typer.Option("--lockstep", help="Compare every word of every step with the golden functions.")
]

REFERENCE = "reference"
_ENDS = ("wins", "won"), ("draws", "drawn"), ("losses", "lost")


def command(
    env_id: common.EnvName,
    policy: PolicyName,
    against: Against = None,
    openings: Openings = None,
    n_agents: common.Agents = None,
    device: common.DeviceName = "native",
    episodes: Episodes = None,
    seed: common.Seed = 0,
    max_cycles: MaxCycles = None,
    lockstep: InLockstep = False,
    option: common.Options = None,
    out: common.Out = None,
    as_json: common.AsJson = False,
) -> None:
    """Evaluate a policy on a device: returns, lengths, latency of every stage, and a digest.

    The digest is the same on every device. --out gets evaluation.json and a page, evaluation.html.
    Exit status 1: with --lockstep, the device differs from the golden functions.
    """
    spec = common.spec_of(env_id, option)
    n_agents = common.agents_of(spec, n_agents)
    rivals = against or []
    given: dict[str, Any] = {"seed": seed, "max_cycles": max_cycles}
    if rivals and episodes is not None:
        raise ArgumentError("with --against every agent plays one episode: leave --episodes out")
    if openings is not None and not rivals:
        raise ArgumentError("--openings works only with --against: add that, or leave --openings out")
    if len(rivals) > 1:
        if lockstep:
            raise ArgumentError("--lockstep compares one evaluation: give one --against, or none")
        given |= {"device": device, "openings": openings}
        _tournament(spec, [policy, *rivals], n_agents, given, out, as_json)
        return
    divergence = f"divergence_{spec.name}_{common.in_file_name(device)}.json"
    common.check_results(out, "evaluation.json", "evaluation.html", *([divergence] if lockstep else []))
    if lockstep and device == REFERENCE:
        raise ArgumentError(
            f"--lockstep compares with {REFERENCE!r}, which always agrees with itself: name another --device"
        )
    stepped = Lockstep(device, REFERENCE) if lockstep else device
    chooses = load_policy(policy, spec, seed)
    evaluation: Evaluation
    if rivals:
        rival = load_policy(rivals[0], spec, seed + 1)
        evaluation = Match(spec, chooses, rival, n_agents, stepped, openings, **given)
    else:
        evaluation = Evaluation(spec, chooses, n_agents, stepped, episodes=episodes, **given)
    try:
        for _ in common.progress(
            evaluation.run(), evaluation.episodes, f"{spec.name} on {device}, {n_agents:,} agents: episodes"
        ):
            pass
    except LockstepError as error:
        error_console.print(f"[bold red]Not bit-exact.[/] {escape(str(error))}", soft_wrap=True)
        if out is not None:
            path = out / divergence
            error.replay.write(path)
            again = common.replaying(path, env=env_id, device=device)
            error_console.print(f"Wrote {path}: {again} replays it.", markup=False, soft_wrap=True)
        sys.exit(1)
    result = {
        **evaluation.summary(),
        "policy": policy,
        **({"against": rivals[0], "match": evaluation.outcome()} if isinstance(evaluation, Match) else {}),
        "device": device,
        "simulated": common.simulated(device),
        "lockstep": REFERENCE if lockstep else None,
        "machine": machine(),
    }
    written = []
    if out is not None:
        written.append(common.write_json(out, "evaluation.json", result))
        try:
            write_report(evaluation, result, out / "evaluation.html")
            written.append(out / "evaluation.html")
        except ArgumentError:
            raise
        except PearlError as error:  # the evaluation is done, and its figures are written
            error_console.print(f"No evaluation.html: {error}", markup=False)
    if as_json:
        common.print_json(result)
        return
    console.print(_outcome(result))
    console.print(_latency(result))
    if lockstep:
        console.print(
            f"{escape(device)} is bit-exact with {REFERENCE}: {result['words_compared']:,} words compared.",
            style="bold green",
        )
    for path in written:
        common.say(f"Wrote {path}")


def _tournament(
    spec: EnvSpec,
    names: list[str],
    n_agents: int,
    given: dict[str, Any],
    out: Path | None,
    as_json: bool,
) -> None:
    """Evaluate each policy against each of the others; show who beats whom."""
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"{name!r} is given as --policy or --against twice; a table has it once")
    common.check_results(out, "matches.json")
    policies = {name: load_policy(name, spec, given["seed"] + k) for k, name in enumerate(names)}
    pairs = len(policies) * (len(policies) - 1) // 2
    label = f"{spec.name} on {given['device']}, {n_agents:,} agents: pairs"
    rows = list(common.progress(cross_table(spec, policies, n_agents, **given), pairs, label))
    result = {
        "environment": spec.id,
        "options": dict(spec.options),
        "n_agents": n_agents,
        **given,
        "matches": rows,
        "machine": machine(),
    }
    if common.delivered(result, as_json, out, "matches.json"):
        return
    won: dict[tuple[str, str], tuple[int, int]] = {}
    for row in rows:
        won[row["policy"], row["against"]] = row["wins"], row["games"]
        won[row["against"], row["policy"]] = row["losses"], row["games"]
    headings = [str(k + 1) for k in range(len(policies))]
    grid = common.table(f"{spec.name}: wins of the row's policy", ["", "policy"], headings)
    for column in grid.columns:  # a long name is folded, and leaves the figures their room
        column.no_wrap, column.overflow = column.header != "policy", "fold"
    for k, name in enumerate(policies):
        cells = (won.get((name, other)) for other in policies)
        shown = ("-" if cell is None else f"{cell[0] / cell[1]:.1%}" for cell in cells)
        grid.add_row(str(k + 1), escape(name), *shown)
    console.print(grid)


def _outcome(result: dict[str, Any]) -> Table:
    grid = Table(title=common.on_device(result["environment"], result["device"]), show_header=False)
    grid.add_column("what", style="bold")
    grid.add_column("figure", overflow="fold")  # a digest that is cut cannot be compared
    grid.add_row("policy", escape(result["policy"]))
    if "match" in result:
        match = result["match"]
        games = match["games"]
        shares = (f"{match[what] / games:.1%} {name}" for what, name in _ENDS)
        grid.add_row("against", escape(result["against"]))
        grid.add_row("match", f"{games:,} games: {', '.join(shares)}")
        ours, theirs = match["return"]["mean"], match["their_return"]["mean"]
        grid.add_row("mean return", f"{ours:,.3f} of the policy, {theirs:,.3f} of its opponents")
    limit = f"at most {result['max_cycles']:,} steps each" if result["max_cycles"] else "no time limit"
    grid.add_row("episodes", f"{result['episodes']:,} of {result['n_agents']:,} agents, {limit}")
    grid.add_row("truncated", f"{result['truncated']:,}")
    for name in ("return", "length"):
        figures = result[name]
        text = f"{figures['mean']:,.2f}"
        if figures["ci95_low"] is not None:
            text += f" ± {figures['mean'] - figures['ci95_low']:,.2f} (95 %)"
        grid.add_row(name, f"{text}, from {figures['min']:g} to {figures['max']:g}")
    if "world_return" in result:
        grid.add_row("return of a world", f"{result['world_return']['mean']:,.3f}")
        each = ", ".join(f"{row['mean']:,.3f} ({row['role']} {row['agent']})" for row in result["agents"])
        grid.add_row("of its agents", each)
    grid.add_row("digest", result["digest"])
    return grid


def _latency(result: dict[str, Any]) -> Table:
    grid = common.table(
        common.on_device("One step of all agents", result["device"]),
        ["stage", "time"],
        ["median", "90 %", "99 %", "max"],
    )
    for row in (*result["latency"], {"stage": "step without policy", "paper": None, **result["step"]}):
        figures = (duration(row[key] * 1e-6) for key in ("p50_us", "p90_us", "p99_us", "max_us"))
        grid.add_row(row["stage"], row["paper"], *figures)
    return grid
