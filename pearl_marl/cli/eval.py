"""``pearl eval``: a policy on any device."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from pearl_marl.benchmark.machine import machine
from pearl_marl.benchmark.measure import duration
from pearl_marl.cli import common
from pearl_marl.cli.common import console, error_console
from pearl_marl.devices import Lockstep
from pearl_marl.errors import LockstepError, PearlError
from pearl_marl.evaluation.report import write_report
from pearl_marl.evaluation.run import LIMIT, Evaluation
from pearl_marl.policies.loading import load_policy

PolicyName = Annotated[
    str,
    typer.Option(
        "--policy",
        help="`random`, a table of action values (FILE.npy, FILE.npz), a model of Stable-Baselines3 "
        "(FILE.zip), a folder of `pearl train`, or a function of observations (MODULE:FUNCTION, "
        "FILE.py:FUNCTION).",
    ),
]
Episodes = Annotated[
    int | None,
    typer.Option("--episodes", min=1, help="How many episodes count.", show_default="one an agent"),
]
MaxCycles = Annotated[
    int | None,
    typer.Option(
        "--max-cycles",
        help="Time limit of an episode, 0 for none.",
        show_default=f"the environment's, or {LIMIT:,}",
    ),
]
InLockstep = Annotated[
    bool, typer.Option("--lockstep", help="Compare every word with the golden functions, all the way.")
]

REFERENCE = "reference"


def command(
    env_id: common.EnvName,
    policy: PolicyName,
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
    Exit status 1: with --lockstep, the device parts from the golden functions.
    """
    spec = common.spec_of(env_id, option)
    n_agents = common.agents_of(spec, n_agents)
    evaluation = Evaluation(
        spec,
        load_policy(policy, spec, seed),
        n_agents,
        Lockstep(device, REFERENCE) if lockstep else device,
        episodes=episodes,
        seed=seed,
        max_cycles=max_cycles,
    )
    if out is not None:
        common.out_folder(out)
    try:
        for _ in common.progress(
            evaluation.run(), evaluation.episodes, f"{spec.name} on {device}, {n_agents:,} agents: episodes"
        ):
            pass
    except LockstepError as error:
        error_console.print(f"[bold red]Not bit-exact.[/] {escape(str(error))}", soft_wrap=True)
        if out is not None:
            path = out / f"divergence_{spec.name}_{common.in_file_name(device)}.json"
            error.replay.write(path)
            error_console.print(
                f"Wrote {path}: pearl verify {path} replays it.", markup=False, soft_wrap=True
            )
        sys.exit(1)
    result = {
        **evaluation.summary(),
        "policy": policy,
        "device": device,
        "lockstep": REFERENCE if lockstep else None,
        "machine": machine(),
    }
    written = []
    if out is not None:
        written.append(common.write_json(out, "evaluation.json", result))
        try:
            write_report(evaluation, result, out / "evaluation.html")
            written.append(out / "evaluation.html")
        except PearlError as error:  # the evaluation is done, and its figures are written
            error_console.print(f"No evaluation.html: {error}", markup=False)
    if as_json:
        common.print_json(result)
        return
    console.print(_outcome(result))
    console.print(_latency(result))
    if lockstep:
        console.print(
            f"{device} is bit-exact with {REFERENCE}: {result['words_compared']:,} words compared.",
            style="bold green",
        )
    for path in written:
        console.print(f"Wrote {path}")


def _outcome(result: dict[str, Any]) -> Table:
    grid = Table(title=f"{result['environment']} on {result['device']}", show_header=False)
    grid.add_column("what", style="bold")
    grid.add_column("figure")
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
    grid.add_row("digest", result["digest"])
    return grid


def _latency(result: dict[str, Any]) -> Table:
    grid = common.table("One step of all agents", ["stage", "time"], ["median", "90 %", "99 %", "max"])
    for row in (*result["latency"], {"stage": "step without policy", "paper": None, **result["step"]}):
        figures = (duration(row[key] * 1e-6) for key in ("p50_us", "p90_us", "p99_us", "max_us"))
        grid.add_row(row["stage"], row["paper"], *figures)
    return grid
