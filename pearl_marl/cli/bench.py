"""``pearl bench``: speed beside that of other packages, each kind of measurement a command of its own."""

from __future__ import annotations

import datetime
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from pearl_marl.benchmark import rollouts
from pearl_marl.benchmark.growth import COUNTS, SUBJECTS, growth
from pearl_marl.benchmark.measure import Contender, measure
from pearl_marl.benchmark.steps import compared, contenders
from pearl_marl.benchmark.tables import (
    KERNEL,
    duration,
    environments_table,
    growth_table,
    machine_line,
    rollouts_table,
    steps_table,
    training_table,
)
from pearl_marl.checks import MANY, checked_number
from pearl_marl.cli import common
from pearl_marl.cli.common import console
from pearl_marl.envs import get_spec, names
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation.machine import machine
from pearl_marl.spec import EnvSpec

app = typer.Typer(add_completion=False, no_args_is_help=True)


@app.callback()
def command() -> None:
    """Measure speed beside that of other packages: of steps, rollouts, many agents, and trainings."""


Rounds = Annotated[
    int, typer.Option(min=1, max=MANY, help="How often each contender is timed; the median is reported.")
]
MOST_SECONDS = 3600
Seconds = Annotated[float, typer.Option(help="About how long one timing lasts.")]


@app.command("steps")
def steps(
    env_id: Annotated[
        str | None,
        typer.Argument(metavar="[ENV]", help="An environment of `pearl envs`; by default CliffWalking."),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Compare every environment, with fewer contenders.")
    ] = False,
    n_agents: common.Agents = None,
    rounds: Rounds = 7,
    seconds: Seconds = 0.2,
    option: common.Options = None,
    out: common.Out = None,
    as_json: common.AsJson = False,
    as_markdown: common.AsMarkdown = False,
) -> None:
    """Measure steps per second against EnvPool, Gymnasium's vector environments and the games' packages."""
    checked_number("--seconds", seconds, 0, MOST_SECONDS)
    common.check_forms(as_json, as_markdown)
    if every:
        if env_id is not None or option:
            raise ArgumentError("--all takes every environment as it is: leave out ENV and --option")
        _every(n_agents, rounds, seconds, out, as_json, as_markdown)
        return
    spec = common.spec_of(env_id or "CliffWalking", option)
    n_agents = common.agents_of(spec, n_agents)
    file = f"bench_{spec.name}_{n_agents}.json"
    common.check_results(out, file)
    rows = contenders(spec, n_agents)
    small = [c for c in contenders(spec, spec.agents) if c.name in (KERNEL, "step_batch, copy=False")]
    result = _measured(spec, n_agents, rows, small, rounds, seconds)
    if common.delivered(result, as_json, out, file):
        return
    kernel, batch = (c.seconds_per_step for c in small)
    one = "One agent" if spec.agents == 1 else f"One world of {spec.agents} agents"
    notes = [result["steps_of"], result["actions"]] if result["steps_of"] else []
    notes.append(
        f"{one}: step_batch takes {duration(batch)}, of which the call of a kernel {duration(kernel)}; "
        f"so {duration(batch - kernel)} are checks and bookkeeping."
    )
    if as_markdown:
        common.print_table("", steps_table(rows), [*notes, _medians(result)], as_markdown)
        return
    console.print(_contenders(f"{spec.id}: agent-steps per second", rows))
    for note in notes:
        console.print(note)
    console.print(machine_line(result["machine"]), style="dim")


@app.command("rollouts")
def measure_rollouts(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A folder of `pearl train`, after `pearl quantize`.")
    ],
    n_agents: common.Agents = None,
    rounds: Rounds = 7,
    seconds: Seconds = 0.2,
    out: common.Out = None,
    as_json: common.AsJson = False,
    as_markdown: common.AsMarkdown = False,
) -> None:
    """Measure policy steps per second: rollouts, the loop of pearl eval, EnvPool with torch, gymnax."""
    from pearl_marl.policies.integer_file import load_policy
    from pearl_marl.policies.integer_network import IntegerNetwork

    checked_number("--seconds", seconds, 0, MOST_SECONDS)
    common.check_forms(as_json, as_markdown)
    network = load_policy(run)
    spec = network.spec
    if not isinstance(network, IntegerNetwork):
        raise ArgumentError(
            f"{run} has a network for each of the {spec.agents} agents of a world; rollouts are timed with "
            "one that all share: train it with sharing all or indicator"
        )
    n_agents = common.agents_of(spec, n_agents)
    file = f"bench_rollouts_{spec.name}_{n_agents}.json"
    common.check_results(out, file)
    rows = rollouts.contenders(run, network, n_agents)
    result = _measured(spec, n_agents, rows, [], rounds, seconds) | {"actions": "Those of the policy."}
    for row, figures in zip(rows, result["contenders"], strict=True):
        if row.unavailable is None:
            figures["steps_per_core_second"] = row.rate_of_a_core
    if common.delivered(result, as_json, out, file):
        return
    absent = [f"{row.name}: {row.unavailable}." for row in rows if row.unavailable is not None]
    notes = (
        *absent,
        "x is the first row over another. Of a core: a second of processor time, in all threads together.",
        f"{n_agents:,} agents; {_medians(result)}",
    )
    common.print_table(f"{spec.id}: acting and stepping", rollouts_table(rows), notes, as_markdown)


@app.command("growth")
def measure_growth(
    rounds: Rounds = 7,
    out: common.Out = None,
    as_json: common.AsJson = False,
    as_markdown: common.AsMarkdown = False,
) -> None:
    """Show how the time of a step per agent grows, from 43,008 agents to 10 million.

    It takes some gigabytes of memory and a minute.
    """
    common.check_forms(as_json, as_markdown)
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
    notes = (
        "Writing fills the arrays of the results with one thread, and does nothing else.",
        machine_line(result["machine"]),
    )
    common.print_table("Time of a step", growth_table(points), notes, as_markdown)


@app.command("training")
def compare_trainings(
    env_id: Annotated[
        str | None, typer.Argument(metavar="[ENV]", help="An environment; by default all that are compared.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Run only a few iterations of one seed.")] = False,
    out: common.Out = None,
    as_json: common.AsJson = False,
    as_markdown: common.AsMarkdown = False,
) -> None:
    """Compare whole trainings with those of other packages, rollout and learning together."""
    common.check_forms(as_json, as_markdown)
    try:
        from pearl_marl.benchmark import training
    except ModuleNotFoundError as error:
        raise ArgumentError(
            f"training needs the Python package {error.name}: pip install '.[train]'"
        ) from None
    name = None if env_id is None else get_spec(env_id).name
    tasks = training.tasks_of(name, quick)
    if not tasks:
        possible = ", ".join(dict.fromkeys(task.env_id for task in training.TASKS))
        raise ArgumentError(f"no training of {name} is compared; possible are {possible}")
    work = training.jobs(tasks, quick)
    file = f"trainings_{name or 'all'}.json"
    common.check_results(out, file)
    goals = {task.name: task.goal for task in tasks}
    rows: list[dict[str, Any]] = []
    threads = os.environ.get("OMP_NUM_THREADS", "as each chooses")
    result: dict[str, Any] = {"machine": machine(), "threads": threads, "quick": quick}
    result |= {"goals": goals, "rows": rows}
    for row in common.progress(training.run(work), len(work), "trainings"):
        rows.append(row)
        result["date"] = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        result["compared"] = training.compared(rows)
        if out is not None:  # a run that is ended leaves what it has measured
            common.write_json(out, file, result)
    if common.delivered(result, as_json, out, file):
        return
    absent = dict.fromkeys(
        f"{row['contender']}: {row['missing']}." for row in result["compared"] if "missing" in row
    )
    reached = [f"{task} to a return of {goal:g}" for task, goal in goals.items() if goal is not None]
    notes = [
        *absent,
        "Medians over seeds. x is how many times as fast ours is, and how many times sooner it reaches the "
        f"goal, with the least and the most. {'; '.join(reached)}",
        machine_line(result["machine"]),
    ]
    common.print_table("Trainings", training_table(result["compared"]), notes, as_markdown)


def current(arguments: Sequence[str]) -> list[str]:
    """Return a command line in its present form; warn if it has that of before ``pearl bench steps``."""
    kinds = {"--training": "training", "--growth": "growth"}
    if arguments and arguments[0] in ("steps", "rollouts", "growth", "training", "-h", "--help"):
        return list(arguments)
    kind = next((kinds[word] for word in arguments if word in kinds), "steps")
    now = [kind, *(word for word in arguments if word not in kinds)]
    common.warn_of_old_form(["bench", *arguments], ["bench", *now])
    return now


def _every(
    n_agents: int | None, rounds: int, seconds: float, out: Path | None, as_json: bool, as_markdown: bool
) -> None:
    about = common.ABOUT if n_agents is None else n_agents
    file = f"bench_all_{about}.json"
    common.check_results(out, file)
    environments, results = [], []
    for name in names():
        spec = common.spec_of(name, None)
        count = common.agents_of(spec, n_agents)
        rows = compared(spec, count)
        results.append(_measured(spec, count, rows, [], rounds, seconds))
        environments.append((spec.name, rows))
    if common.delivered(results, as_json, out, file):
        return
    notes = (
        f"Agent-steps per second, {about:,} agents; x is step_batch over that peer. Sync and NumPy are "
        "Gymnasium's SyncVectorEnv and its own vectorised form. What each counts: `pearl bench steps ENV`.",
        _medians(results[0]),
    )
    common.print_table("Agent-steps per second", environments_table(environments), notes, as_markdown)


def _measured(
    spec: EnvSpec, n: int, rows: list[Contender], small: list[Contender], rounds: int, seconds: float
) -> dict[str, Any]:
    """Time contenders, those of ``small`` for one agent; return all that a figure needs with it."""
    timed, k, steps = rows + small, spec.agents, None
    if k > 1:
        which = ", even though they take turns" if spec.turns else ""
        steps = f"{n // k:,} worlds of {k} agents: a step of a world is {k} agent-steps{which}."
    actions = "The same random actions again and again."
    if spec.mask_fields:
        actions = "All agents take random legal actions, and choosing them is not timed."
    turns = len(timed) * (rounds + 1)
    for _ in common.progress(measure(timed, rounds, seconds), turns, f"{spec.name}, {n:,} agents"):
        pass
    return {
        "environment": spec.id,
        "options": dict(spec.options),
        "agents_per_world": spec.agents,
        "steps_of": steps,
        "actions": actions,
        "date": datetime.date.today().isoformat(),
        "machine": machine(),
        "rounds": rounds,
        "contenders": [c.row() for c in rows],
        "one_agent": [c.row() for c in small],
    }


def _medians(result: dict[str, Any]) -> str:
    return f"{result['date']}; medians of {result['rounds']}; {machine_line(result['machine'])}"


def _contenders(title: str, rows: list[Contender]) -> Table:
    """Return the table of contenders in one environment, with what is counted below each name."""
    grid = Table(title=title, show_lines=True)
    grid.add_column("contender, and what is counted")
    for heading in ("agents", "steps/s", "a step", "over\nEnvPool", "spread"):
        grid.add_column(heading, justify="right", no_wrap=True)
    measured = {name: figures for name, *figures, _ in steps_table(rows).rows}
    for c in rows:
        name = f"[bold{'' if c.ours else ' cyan'}]{c.name}[/]\n[dim]{escape(c.unavailable or c.counts)}[/]"
        if c.unavailable is not None:
            grid.add_row(name, f"{c.n:,}", "-", "-", "-", "-")
            continue
        once = len(c.seconds) < 2  # of which no spread is known
        spread = "-" if once else f"±{(max(c.seconds) - min(c.seconds)) / 2 / c.seconds_per_step:.0%}"
        grid.add_row(name, *measured[c.name], spread)
    return grid
