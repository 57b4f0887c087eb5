"""``pearl train``: learn a policy, and keep the run in a folder."""

from __future__ import annotations

import difflib
import warnings
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import TextColumn

from pearl_marl.checks import checked_number
from pearl_marl.cli import common
from pearl_marl.cli import quantize as integers
from pearl_marl.cli.common import error_console
from pearl_marl.cli.interrupts import interrupts
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError

ALGORITHMS = ("ppo", "pqn", "dqn", "q-learning", "ippo", "mappo", "iql", "vdn", "qmix", "self-play")
REMEMBERING = ("ppo", "ippo", "mappo", "pqn", "vdn", "qmix", "self-play")
"""Those that learn policies with memory."""


def command(
    env_id: common.EnvName,
    algo: Annotated[
        str | None,
        typer.Option(
            help="`ppo`, `pqn`, `dqn`, `q-learning`; in worlds also `ippo`, `mappo`, `iql`, `vdn`, `qmix`, "
            "`self-play`.",
            autocompletion=common.completed(lambda: ALGORITHMS),
            show_default="that of the environment's first preset, else `ppo`; with --quantize `ppo`",
        ),
    ] = None,
    n_agents: Annotated[
        int | None, typer.Option(help="Number of agents that gather experience.", show_default="preset")
    ] = None,
    iterations: Annotated[int | None, typer.Option(help="Number of updates.", show_default="preset")] = None,
    memory: Annotated[
        str | None,
        typer.Option(
            help="Memory of the policy: `none` or `gru`; not with `dqn`, `iql` and `q-learning`.",
            show_default="none",
        ),
    ] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="A setting of the algorithm, for example `learning_rate=0.001`; may be repeated. "
            "docs/training.md lists them.",
        ),
    ] = None,
    seed: common.Seed = 0,
    device: common.DeviceName = "native",
    goal: Annotated[
        float | None, typer.Option(help="End when an evaluation reaches this mean return of an agent.")
    ] = None,
    evaluate_every: Annotated[
        int | None, typer.Option(help="Iterations between evaluations.", show_default="50 evaluations")
    ] = None,
    shards: Annotated[
        int | None,
        typer.Option(
            help="Number of Ray processes that step agents; `ppo` and `pqn`.", show_default="this process"
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            help="Train so many seeds at once, from --seed on, each in a folder of its own.",
            show_default="one",
        ),
    ] = None,
    films: Annotated[
        bool,
        typer.Option(
            "--films", help="Film the policy at each evaluation: a GIF each, in the folder `films`."
        ),
    ] = False,
    track: Annotated[
        str | None,
        typer.Option(
            metavar="SERVICE",
            help="Send the metrics to `wandb` (Weights & Biases) or `mlflow`, too, which has to be "
            "installed.",
            show_default="only files",
        ),
    ] = None,
    quantize: Annotated[
        bool,
        typer.Option(
            "--quantize",
            help="In the end, do `pearl quantize`: write the policy in integers, too, and compare.",
        ),
    ] = False,
    option: common.Options = None,
    out: Annotated[
        Path | None,
        common.folder_option(
            "The run's folder; if it holds an unfinished run, the command continues it.", "out/ENV-ALGORITHM"
        ),
    ] = None,
    as_json: common.AsJson = False,
) -> None:
    """Train a policy that all agents share; with the --out of a run that was killed, resume it."""
    spec = common.spec_of(env_id, option)
    by_default = algo is None
    if algo is None:
        algo = "ppo" if quantize else next(iter(get_spec(env_id).presets), "ppo")
    elif algo not in ALGORITHMS:
        near = difflib.get_close_matches(algo, ALGORITHMS, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"possible are {', '.join(map(repr, ALGORITHMS))}"
        raise ArgumentError(f"--algo is {algo!r}; {hint}")
    if goal is not None:
        checked_number("--goal", goal)
    out = out or Path("out") / f"{spec.name}-{algo}"
    interrupts.advice = f": to go on, give the same command again, with the same --out {out}"
    try:
        with interrupts.at_once():  # PyTorch takes seconds to load
            from pearl_marl.training import run as training
            from pearl_marl.training.population import Population
    except ModuleNotFoundError as error:
        raise ArgumentError(
            f"training needs the Python package {error.name}: pip install '.[train]'"
        ) from None
    if memory is not None:
        if memory not in (possible := training.SETTINGS["ppo"].range("memory")):
            raise ArgumentError(f"--memory is {memory!r}; it must be {possible}")
        if algo not in REMEMBERING:
            raise ArgumentError(
                f"{algo} learns no policies with memory: leave --memory out, or use one of "
                f"{', '.join(REMEMBERING)}{_learns(algo, spec.name) if by_default else ''}"
            )
    chosen = {"n_agents": n_agents, "iterations": iterations, "memory": memory}
    # --seed always has a value, which must not overrule --set seed=N.
    changes = {"seed": seed, **common.env_options(setting, "--set")}
    changes |= {name: n for name, n in chosen.items() if n is not None}
    with warnings.catch_warnings(record=True) as renamed:
        warnings.simplefilter("always", DeprecationWarning)
        try:
            settings = training.settings_for(algo, env_id, changes, shards, spec.agents)
        except ArgumentError as error:
            if not by_default:
                raise
            raise ArgumentError(f"{error}{_learns(algo, spec.name)}") from None
    for warning in renamed:
        error_console.print(f"pearl: {warning.message}", markup=False, soft_wrap=True)
    plan = training.Training(env_id, algo, settings, dict(spec.options), device, goal, evaluate_every)
    if seeds is not None:
        if shards is not None or films or track is not None or quantize:
            raise ArgumentError(
                "--seeds trains in this process, for the spread: leave --shards, --films, --track and "
                "--quantize out"
            )
        population = Population(plan, out, seeds)
        _train(population, f"{env_id}, {algo}, {seeds} seeds", settings.iterations)
        _tell_spread(population, env_id, algo, as_json)
        return
    run = training.TrainingRun(plan, out, shards, films=films, track=track)
    if quantize:
        integers.check(run.trainer.policy)
    _train(run, f"{env_id}, {algo}", settings.iterations)
    rows = run.rows
    best = max(rows, key=lambda row: row["eval_return"])
    result: dict[str, Any] = {"environment": env_id, "algorithm": algo, "folder": str(out)}
    result |= {"best": best, "last": rows[-1]}
    if as_json:
        if quantize:
            result["quantized"] = integers.quantize_run(out)
        common.print_json(result)
        return
    common.say(
        f"Best mean return {best['eval_return']:.2f}, after {best['agent_steps']:,} agent-steps and "
        f"{best['seconds']:.1f} s. Wrote {out}: policy.safetensors, metrics.csv, learning_curve.png"
    )
    if quantize:
        integers.show(integers.quantize_run(out))


def _learns(algorithm: str, name: str) -> str:
    """Return what a message adds where the algorithm was not named."""
    return f" (without --algo, {algorithm} learns {name})"


def _train(run: Any, title: str, iterations: int) -> None:
    """Train a run, or several, to the end, or until Ctrl-C."""
    # An iteration that has begun is done to its end: a run cannot go on from half of one.
    keeping = "keeping the run after this iteration; Ctrl-C again ends it now"
    with common.progress_bar(TextColumn("{task.fields[note]}")) as bar, run.claimed():
        task = bar.add_task(title, total=iterations, note="")
        while not run.finished:
            with interrupts.later(keeping):
                row = run.iterate()
            if row is not None:
                trained = row["train_return"]
                more = "" if trained is None else f", in training {trained:.1f}"
                bar.update(task, completed=run.done, note=f"return {row['eval_return']:.1f}{more}")
            if interrupts.noted and not run.finished:
                run.keep()
                raise KeyboardInterrupt


def _tell_spread(population: Any, env_id: str, algorithm: str, as_json: bool) -> None:
    """Print how the seeds did."""
    goal, reached = population.training.goal, population.reached
    last = population.spread()[-1]
    if as_json:
        runs = [{"seed": run.seed, "best": run.best, "last": run.rows[-1]} for run in population.sound]
        result = {"environment": env_id, "algorithm": algorithm, "folder": str(population.folder)}
        figures = {"goal": goal, "reached": reached, "spread": last, "runs": runs}
        common.print_json({**result, **figures, "diverged": population.diverged})
        return
    at_goal = "" if goal is None else f" {reached} of {len(population.runs)} seeds reached {goal:g}."
    for seed, why in population.diverged.items():
        error_console.print(f"pearl: without seed {seed}: {why}", markup=False, soft_wrap=True)
    common.say(
        f"Mean returns {last['least']:.2f} to {last['greatest']:.2f}, median {last['median']:.2f}.{at_goal} "
        f"Wrote {population.folder}: seed-*, spread.csv, learning_curves.png"
    )
