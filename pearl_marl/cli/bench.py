"""``pearl bench``: this package beside its peers, in one run."""

from __future__ import annotations

import datetime
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from pearl_marl.benchmark import Contender, contenders, machine, measure
from pearl_marl.cli.common import (
    Agents,
    AsJson,
    EnvName,
    Options,
    Out,
    console,
    duration,
    env_options,
    print_json,
    progress,
    rate,
    write_json,
)
from pearl_marl.registry import get_spec

Rounds = Annotated[
    int, typer.Option("--rounds", min=1, help="How often each contender is timed; the median counts.")
]
Seconds = Annotated[float, typer.Option("--seconds", min=0.0, help="About how long one timing lasts.")]


def command(
    env_id: EnvName,
    n_agents: Agents = 43008,
    rounds: Rounds = 7,
    seconds: Seconds = 0.2,
    option: Options = None,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Measure steps per second against Gymnasium's vector environments and EnvPool."""
    spec = get_spec(env_id).with_options(**env_options(option))
    rows = contenders(spec, n_agents)
    small = [c for c in contenders(spec, 1) if c.ours and c.name in ("kernel only", "step_batch, copy=False")]
    everyone = rows + small
    for _ in progress(
        measure(everyone, rounds, seconds), len(everyone) * (rounds + 1), f"{spec.name}, {n_agents:,} agents"
    ):
        pass
    facts = machine()
    result = {
        "environment": spec.id,
        "options": dict(spec.options),
        "date": datetime.date.today().isoformat(),
        "machine": facts,
        "rounds": rounds,
        "contenders": [c.row() for c in rows],
        "one_agent": [c.row() for c in small],
    }
    if out is not None:
        write_json(out, f"bench_{spec.name}_{n_agents}.json", result)
    if as_json:
        print_json(result)
        return
    console.print(_table(spec.id, rows))
    kernel, batch = (c.seconds_per_step for c in small)
    console.print(
        f"One agent: step_batch takes {duration(batch)}, of which the call of a kernel {duration(kernel)}; "
        f"so {duration(batch - kernel)} are checks and bookkeeping."
    )
    console.print(
        f"{facts['processor']}, {facts['cores']} cores; {_versions(facts)}", style="dim", highlight=False
    )


def _versions(facts: dict[str, Any]) -> str:
    return ", ".join(
        f"{name} {version}" for name, version in {"Python": facts["python"], **facts["versions"]}.items()
    )


def _table(title: str, rows: list[Contender]) -> Table:
    table = Table(title=f"{title}: agent-steps per second", show_lines=True)
    table.add_column("contender, and what is counted")
    for heading in ("agents", "steps/s", "x EnvPool", "a step", "spread"):
        table.add_column(heading, justify="right", no_wrap=True)
    base = next((c for c in rows if c.name.startswith("EnvPool") and c.unavailable is None), None)
    for c in rows:
        name = f"[bold{'' if c.ours else ' cyan'}]{c.name}[/]\n[dim]{escape(c.unavailable or c.counts)}[/]"
        if c.unavailable is not None:
            table.add_row(name, f"{c.n:,}", "-", "-", "-", "-")
            continue
        each = c.n / c.seconds_per_step
        ratio = f"{each / (base.n / base.seconds_per_step):,.3g}" if base else "-"
        spread = f"±{(max(c.seconds) - min(c.seconds)) / 2 / c.seconds_per_step:.0%}"
        table.add_row(name, f"{c.n:,}", rate(each), ratio, duration(c.seconds_per_step), spread)
    return table
