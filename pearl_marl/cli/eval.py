"""``pearl eval``: a policy on any device."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from pearl_marl.benchmark.tables import duration, rate
from pearl_marl.checks import MANY
from pearl_marl.cli import common, match
from pearl_marl.cli.common import console, error_console
from pearl_marl.errors import ArgumentError, LockstepError, PearlError
from pearl_marl.evaluation.machine import machine
from pearl_marl.evaluation.report import write_report
from pearl_marl.evaluation.run import LIMIT, Evaluation
from pearl_marl.policies.loading import load_policy


def command(
    env_id: common.EnvName,
    policy: Annotated[
        str,
        typer.Option(
            help="`random`, a table of action values (FILE.npy, FILE.npz), a model of Stable-Baselines3 "
            "(FILE.zip), a folder of `pearl train`, a file of `pearl quantize`, or a function of "
            "observations (MODULE:FUNCTION, FILE.py:FUNCTION)."
        ),
    ],
    # What `pearl match` does was an option here; these two work for one version more.
    against: Annotated[list[str] | None, typer.Option(hidden=True)] = None,
    openings: Annotated[int | None, typer.Option(min=0, hidden=True)] = None,
    n_agents: common.Agents = None,
    device: common.DeviceName = "native",
    episodes: Annotated[
        int | None,
        typer.Option(min=1, max=MANY, help="Number of episodes that count.", show_default="one an agent"),
    ] = None,
    seed: common.Seed = 0,
    max_cycles: Annotated[int | None, common.max_cycles_option(f"the environment's, or {LIMIT:,}")] = None,
    lockstep: common.InLockstep = False,
    option: common.Options = None,
    out: common.Out = None,
    as_json: common.AsJson = False,
) -> None:
    """Evaluate a policy on a device: returns, lengths, latency of every stage, and a digest.

    The digest is the same on every device. A policy of `pearl quantize` acts in rollouts, and has a rate in
    place of latencies. --out gets evaluation.json and a page, evaluation.html.
    Exit status 1: with --lockstep, the device differs from the golden functions.
    """
    if against:
        if episodes is not None:
            raise ArgumentError("in a match every agent plays one episode: leave --episodes out")
        rivals = [policy, *against]
        options = [word for name in against for word in ("--against", name)]
        old = ["eval", env_id, "--policy", policy, *options]
        common.warn_of_old_form(old, ["match", env_id, *rivals])
        match.command(
            *(env_id, rivals, openings, n_agents, device, seed, max_cycles, lockstep, option, out, as_json)
        )
        return
    if openings is not None:
        raise ArgumentError("--openings is an option of pearl match: leave it out")
    spec = common.spec_of(env_id, option)
    n_agents = common.agents_of(spec, n_agents)
    divergence = common.divergence_file(spec, device)
    common.check_results(out, "evaluation.json", "evaluation.html", *([divergence] if lockstep else []))
    stepped = common.device_maker(device, lockstep)()
    loaded = load_policy(policy, spec, seed)
    evaluation = Evaluation(
        spec, loaded, n_agents, stepped, episodes=episodes, seed=seed, max_cycles=max_cycles
    )
    try:
        for _ in common.progress(
            evaluation.run(), evaluation.episodes, f"{spec.name} on {device}, {n_agents:,} agents: episodes"
        ):
            pass
    except LockstepError as error:
        common.end_with(error, out, divergence, env_id, device)
    result = {
        **evaluation.summary(),
        "policy": policy,
        "device": device,
        "simulated": common.simulated(device),
        "lockstep": common.REFERENCE if lockstep else None,
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
    if "latency" in result:
        console.print(_latency(result))
    if lockstep:
        console.print(
            f"{escape(device)} is bit-exact with {common.REFERENCE}: "
            f"{result['words_compared']:,} words compared.",
            style="bold green",
        )
    for path in written:
        common.say(f"Wrote {path}")


def _outcome(result: dict[str, Any]) -> Table:
    grid = Table(title=common.on_device(result["environment"], result["device"]), show_header=False)
    grid.add_column("what", style="bold")
    grid.add_column("figure", overflow="fold")  # a digest that is cut cannot be compared
    grid.add_row("policy", escape(result["policy"]))
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
    if "agent_steps_per_second" in result:
        grid.add_row("rollouts", f"{rate(result['agent_steps_per_second'])} agent-steps/s with the policy")
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
