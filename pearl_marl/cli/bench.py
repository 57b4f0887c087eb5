"""``pearl bench``: this package beside its peers, in one run."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.markup import escape
from rich.table import Table

from pearl_marl.benchmark.contenders import contenders
from pearl_marl.benchmark.growth import COUNTS, SUBJECTS, growth
from pearl_marl.benchmark.machine import machine
from pearl_marl.benchmark.measure import Contender, duration, measure, rate
from pearl_marl.checks import MANY
from pearl_marl.cli import common, trainings
from pearl_marl.cli.common import console
from pearl_marl.errors import ArgumentError
from pearl_marl.registry import names
from pearl_marl.spec import EnvSpec

Rounds = Annotated[
    int,
    typer.Option(
        "--rounds", min=1, max=MANY, help="How often each contender is timed; the median is reported."
    ),
]
MOST_SECONDS = 3600
Seconds = Annotated[float, typer.Option("--seconds", help="About how long one timing lasts.")]


OURS = {"kernel only": "kernel", "step_batch": "step_batch"}
ENVPOOL = "EnvPool, sync"
OTHERS = {
    "Gymnasium SyncVectorEnv": "Sync",
    "Gymnasium's own vectorisation": "NumPy",
    "MinAtar": "MinAtar",
    "jaxmarl": "JaxMARL",
    "lbforaging": "lbforaging",
    "overcooked-ai": "overcooked-ai",
    "PettingZoo connect_four_v3": "PettingZoo",
}
"""The contenders of ``--all``, by name, with the words for them in its table."""

AnyEnv = Annotated[
    str | None,
    typer.Argument(metavar="[ENV]", help="An environment of `pearl envs`; by default CliffWalking."),
]
Every = Annotated[bool, typer.Option("--all", help="Compare every environment, with fewer contenders.")]
Training = Annotated[
    bool,
    typer.Option(
        "--training",
        help="Compare whole trainings with those of other packages, on ENV or on all environments.",
    ),
]
Quick = Annotated[bool, typer.Option("--quick", help="With --training: only a few iterations of one seed.")]
Growth = Annotated[
    bool,
    typer.Option(
        "--growth", help="Show how the time of a step per agent grows, from 43,008 agents to 10 million."
    ),
]


def command(
    env_id: AnyEnv = None,
    every: Every = False,
    training: Training = False,
    quick: Quick = False,
    growing: Growth = False,
    n_agents: common.Agents = None,
    rounds: Rounds = 7,
    seconds: Seconds = 0.2,
    option: common.Options = None,
    out: common.Out = None,
    as_json: common.AsJson = False,
) -> None:
    """Measure steps per second against EnvPool, Gymnasium's vector environments and the games' packages."""
    if not 0 <= seconds <= MOST_SECONDS:
        raise ArgumentError(f"--seconds is {seconds}; it must be a number from 0 to {MOST_SECONDS:,}")
    if quick and not training:
        raise ArgumentError("--quick works only with --training: add that, or leave --quick out")
    if training:
        if every or growing or option or n_agents is not None:
            raise ArgumentError(
                "--training has settings of its own: leave out --all, --growth, --option and --n-agents"
            )
        trainings.show(env_id, quick, out, as_json)
        return
    if growing:
        if env_id is not None or option or every or n_agents is not None:
            raise ArgumentError(
                "--growth has its own environments and sizes: leave out ENV and other options"
            )
        _growth(rounds, out, as_json)
        return
    if every:
        if env_id is not None or option:
            raise ArgumentError("--all takes every environment as it is: leave out ENV and --option")
        _every(n_agents, rounds, seconds, out, as_json)
        return
    spec = common.spec_of(env_id or "CliffWalking", option)
    n_agents = common.agents_of(spec, n_agents)
    file = f"bench_{spec.name}_{n_agents}.json"
    common.check_results(out, file)
    rows = contenders(spec, n_agents)
    small = [
        c
        for c in contenders(spec, spec.agents)
        if c.ours and c.name in ("kernel only", "step_batch, copy=False")
    ]
    result = _measured(spec, n_agents, rows, small, rounds, seconds)
    if common.delivered(result, as_json, out, file):
        return
    console.print(_table(spec.id, rows))
    if result["steps_of"] is not None:
        console.print(f"{result['steps_of']} {result['actions']}")
    kernel, batch = (c.seconds_per_step for c in small)
    one = "One agent" if spec.agents == 1 else f"One world of {spec.agents} agents"
    console.print(
        f"{one}: step_batch takes {duration(batch)}, of which the call of a kernel {duration(kernel)}; "
        f"so {duration(batch - kernel)} are checks and bookkeeping."
    )
    _print_machine(result["machine"])


def _growth(rounds: int, out: Path | None, as_json: bool) -> None:
    common.check_results(out, "bench_growth.json")
    expected = len(SUBJECTS) * len(COUNTS)
    points = list(common.progress(growth(rounds), expected, "from 43,008 agents to 10 million"))
    result: dict[str, Any] = {
        "machine": machine(),
        "rounds": rounds,
        "points": [point._asdict() for point in points],
    }
    if common.delivered(result, as_json, out, "bench_growth.json"):
        return
    grid = common.table(
        "Nanoseconds for each agent", ["environment"], ["agents", "step_batch", "writing", "x"]
    )
    for point in points:
        figures = f"{point.n_agents:,}", f"{point.step:.2f}", f"{point.write:.2f}"
        grid.add_row(point.subject, *figures, f"{point.step / point.write:.1f}")
    console.print(grid)
    console.print(
        "Writing fills the arrays of the results with one thread, and does nothing else.", style="dim"
    )
    _print_machine(result["machine"])


def _every(n_agents: int | None, rounds: int, seconds: float, out: Path | None, as_json: bool) -> None:
    about = common.ABOUT if n_agents is None else n_agents
    file = f"bench_all_{about}.json"
    common.check_results(out, file)
    grid = common.table(
        f"Agent-steps per second, {about:,} agents",
        ["environment"],
        [*OURS.values(), "EnvPool", "x", "best other", "x"],
        box=box.SIMPLE,
        padding=0,  # so that all fits into 80 columns
    )
    results = []
    for name in names():
        spec = common.spec_of(name, None)
        count = common.agents_of(spec, n_agents)
        rows = [c for c in contenders(spec, count) if c.name in (*OURS, ENVPOOL, *OTHERS)]
        results.append(_measured(spec, count, rows, [], rounds, seconds))
        grid.add_row(spec.name, *_figures(rows))
    if common.delivered(results, as_json, out, file):
        return
    console.print(grid)
    console.print(
        "x is step_batch over that peer; Sync and NumPy are Gymnasium's SyncVectorEnv and its own vectorised "
        "form, PettingZoo its connect_four_v3. What each counts: `pearl bench ENV`.",
        style="dim",
    )
    _print_machine(results[0]["machine"])


def _figures(rows: list[Contender]) -> list[str]:
    """Return the cells of one environment: our rates, then EnvPool's and the best other's, and x of each."""
    rates = {c.name: c.n / c.seconds_per_step for c in rows if c.unavailable is None}
    figures = [rate(rates[contender]) for contender in OURS]
    best = max((contender for contender in OTHERS if contender in rates), key=rates.__getitem__, default="")
    for peer, label in ((ENVPOOL, ""), (best, f" [dim]{OTHERS.get(best)}[/]")):
        if peer in rates:
            times = rates["step_batch"] / rates[peer]
            figures += [rate(rates[peer]) + label, f"{times:,.0f}" if times >= 100 else f"{times:.3g}"]
        else:
            figures += ["-", "-"]
    return figures


def _measured(
    spec: EnvSpec, n: int, rows: list[Contender], small: list[Contender], rounds: int, seconds: float
) -> dict[str, Any]:
    """Time contenders, those of ``small`` for one agent; return all that a figure needs with it."""
    everyone = rows + small
    turns = len(everyone) * (rounds + 1)
    for _ in common.progress(measure(everyone, rounds, seconds), turns, f"{spec.name}, {n:,} agents"):
        pass
    return {
        "environment": spec.id,
        "options": dict(spec.options),
        "agents_per_world": spec.agents,
        **_counted(spec, n),
        "date": datetime.date.today().isoformat(),
        "machine": machine(),
        "rounds": rounds,
        "contenders": [c.row() for c in rows],
        "one_agent": [c.row() for c in small],
    }


def _counted(spec: EnvSpec, n: int) -> dict[str, str | None]:
    """Return what is counted as a step, where worlds have several agents, and which actions are taken."""
    worlds, steps = n // spec.agents, None
    if spec.agents > 1:
        which = ", whoever is on turn" if spec.turns else ""
        k = spec.agents
        steps = f"{worlds:,} worlds of {k} agents: a step of a world is {k} agent-steps{which}."
    actions = "The same random actions again and again."
    if spec.mask_fields:
        actions = "Everyone takes random legal actions, and choosing them is not timed."
    return {"steps_of": steps, "actions": actions}


def _print_machine(facts: dict[str, Any]) -> None:
    versions = {"Python": facts["python"], **facts["versions"]}
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    console.print(f"{facts['processor']}, {facts['cores']} cores; {listed}", style="dim")


def _table(title: str, rows: list[Contender]) -> Table:
    grid = Table(title=f"{title}: agent-steps per second", show_lines=True)
    grid.add_column("contender, and what is counted")
    for heading in ("agents", "steps/s", "x EnvPool", "a step", "spread"):
        grid.add_column(heading, justify="right", no_wrap=True)
    base = next((c for c in rows if c.name.startswith("EnvPool") and c.unavailable is None), None)
    for c in rows:
        name = f"[bold{'' if c.ours else ' cyan'}]{c.name}[/]\n[dim]{escape(c.unavailable or c.counts)}[/]"
        if c.unavailable is not None:
            grid.add_row(name, f"{c.n:,}", "-", "-", "-", "-")
            continue
        each = c.n / c.seconds_per_step
        ratio = f"{each / (base.n / base.seconds_per_step):,.3g}" if base else "-"
        once = len(c.seconds) < 2  # of which no spread is known
        spread = "-" if once else f"±{(max(c.seconds) - min(c.seconds)) / 2 / c.seconds_per_step:.0%}"
        grid.add_row(name, f"{c.n:,}", rate(each), ratio, duration(c.seconds_per_step), spread)
    return grid
