"""``pearl run``: step an environment and tell how fast it went and what happened."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer
from rich.table import Table

from pearl_marl.base.arrays import load_array
from pearl_marl.batch.step import on_host
from pearl_marl.benchmark.tables import duration, rate
from pearl_marl.cli import common
from pearl_marl.cli.common import console, error_console
from pearl_marl.errors import ArgumentError, PearlError
from pearl_marl.evaluation.episodes import EpisodeStatistics
from pearl_marl.evaluation.machine import machine
from pearl_marl.evaluation.run import acting
from pearl_marl.interfaces.parallel import PearlParallelEnv, parallel_env
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.policies.loading import Policy, forget, load_policy, random_policy
from pearl_marl.rendering import VIDEO_STEPS, VIDEO_WORLDS, HeatMap, Video
from pearl_marl.spec import EnvSpec


def command(
    env_id: common.EnvName,
    n_agents: common.Agents = None,
    device: common.DeviceName = "native",
    steps: common.Steps = 1000,
    seed: common.Seed = 0,
    max_cycles: Annotated[int | None, common.max_cycles_option()] = None,
    actions: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A .npy file of actions, of shape (steps, n_agents), or (steps, n_agents, n) if an action "
            "is an array of shape (n,), as in Pendulum, where n is 1; without it, actions are random.",
        ),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            help="A policy that acts, instead of random actions: what `pearl eval --policy` takes. One in "
            "integers, or a GoldenPolicy, acts in a rollout."
        ),
    ] = None,
    video: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.gif",
            help=f"Write a film of the first {VIDEO_WORLDS} worlds in the first {VIDEO_STEPS} steps.",
        ),
    ] = None,
    option: common.Options = None,
    out: common.Out = None,
    as_json: common.AsJson = False,
) -> None:
    """Step every agent with random (or given) actions, or a policy's: throughput and episode statistics."""
    spec = common.spec_of(env_id, option)
    n_agents = common.agents_of(spec, n_agents)
    if policy is not None and actions is not None:
        raise ArgumentError("--policy and --actions both say what agents do: leave one of them out")
    settings = {
        "environment": spec.id,
        "options": dict(spec.options),
        "device": device,
        "simulated": common.simulated(device),
        **({} if policy is None else {"policy": policy}),
        "n_agents": n_agents,
        "steps": steps,
        "seed": seed,
        "agent_steps": steps * n_agents,
    }
    player = None if policy is None else load_policy(policy, spec, seed)
    if isinstance(player, DevicePolicy) and video is None:
        common.check_results(out, "run.json")
        env = parallel_env(env_id, n_agents, device=device, max_cycles=max_cycles, **spec.options)
        result = settings | _rolled_out(env, player, steps, seed)
        if not common.delivered(result, as_json, out, "run.json"):
            console.print(_table(result))
        return
    common.check_results(out, "run.json", *(["heat_map.png"] if spec.grid else []))
    if video is not None:
        common.check_file("--video", video)
    given = None if actions is None else _read_actions(actions, spec, n_agents, steps)
    heat_map = HeatMap(spec) if spec.grid else None

    stepping: list[float] = []
    with contextlib.ExitStack() as closing:
        # Before the environment, which may have to be compiled: what cannot be filmed is refused at once.
        film = None if video is None else closing.enter_context(contextlib.closing(Video(spec, video)))
        env = parallel_env(env_id, n_agents, device=device, max_cycles=max_cycles, copy=False, **spec.options)
        closing.enter_context(contextlib.closing(env))
        statistics = EpisodeStatistics(n_agents)
        observed = env.reset_batch(seed)
        chooses = _chooser(env, player, given, seed)
        present = np.ones(n_agents, np.bool_)
        for _ in common.progress(range(steps), steps, f"{spec.name}, {n_agents:,} agents"):
            if film is not None and len(stepping) < VIDEO_STEPS:
                film.add(env.state())
            batch = chooses(observed)
            began = time.perf_counter()
            step = env.step_batch(batch)
            stepping.append(time.perf_counter() - began)
            statistics.add(step)
            observed = step.obs
            if player is not None:
                on = step.on_host()
                # An agent that has ended before its world may have had steps of no episode since.
                forget(player, on.ended | ~present)
                present = on.in_episode.copy()
            if heat_map is not None:
                heat_map.add(step)
        if film is not None:
            film.save()
            if doubt := film.doubt():
                error_console.print(doubt, markup=False)

    # The first step may load or compile the kernel, which says nothing about the others.
    typical = float(np.median(stepping[1:] or stepping))
    result = settings | {
        "counts": "step_batch, copy=False: all result arrays; median step",
        "agent_steps_per_second": n_agents / typical,
        "microseconds_per_step": typical * 1e6,
        "first_step_microseconds": stepping[0] * 1e6,
        **statistics.summary(),
        "machine": machine(),
    }
    written = [] if video is None else [video]
    if out is not None:
        written.append(common.write_json(out, "run.json", result))
        if heat_map is not None:
            try:
                heat_map.save(out / "heat_map.png")
                written.append(out / "heat_map.png")
            except ArgumentError:
                raise
            except PearlError as error:  # the run is done, and its figures are written
                error_console.print(f"No heat_map.png: {error}", markup=False)
    if as_json:
        common.print_json(result)
        return
    console.print(_table(result))
    if heat_map is not None:
        console.print("Visits of all agents (darker is more, logarithmic):")
        console.print(heat_map.text())
    for path in written:
        common.say(f"Wrote {path}")


def _rolled_out(env: PearlParallelEnv, policy: DevicePolicy, steps: int, seed: int) -> dict[str, Any]:
    """Return the figures of a rollout."""
    with contextlib.closing(env):
        env.reset_batch(seed)
        env.rollout(policy, 1)  # loads the loop, or compiles it
        env.reset_batch(seed)
        began = time.perf_counter()
        result = env.rollout(policy, steps)
        seconds = time.perf_counter() - began
    spread = None
    if result.mean_return is not None and not np.isnan(result.squares).any():
        variance = result.squares.sum() / result.episodes - result.mean_return**2
        spread = float(np.sqrt(max(variance, 0.0)))
    return {
        "counts": "one rollout, the policy included",
        "agent_steps_per_second": steps * env.batch_size / seconds,
        "microseconds_per_step": seconds / steps * 1e6,
        "episodes": result.episodes,
        "truncated": int(result.truncated.sum()),
        "return_mean": result.mean_return,
        "return_std": spread,
        "length_mean": result.mean_length,
        "machine": machine(),
    }


def _chooser(
    env: PearlParallelEnv,
    policy: Policy | DevicePolicy | None,
    given: Iterator[npt.NDArray[Any]] | None,
    seed: int,
) -> Callable[[Any], npt.NDArray[Any]]:
    """Return a function from observations to the next actions: a policy's, the given ones, or random ones."""
    if given is not None:
        return lambda _: next(given)
    chooses = random_policy(env.spec, seed) if policy is None else acting(policy, lambda: env.device)

    def choose(observed: Any) -> npt.NDArray[Any]:
        masks = env.action_masks
        # Random actions only depend on how many observations there are: those of a GPU may stay there.
        arguments = [observed if policy is None else on_host(observed)]
        actions: npt.NDArray[Any] = chooses(*arguments, *([] if masks is None else [on_host(masks)]))
        return actions

    return choose


def _read_actions(path: Path, spec: EnvSpec, n: int, steps: int) -> Iterator[npt.NDArray[Any]]:
    needed = (steps, n, *(spec.action_space.shape or ()))

    def check(shape: tuple[int, ...], _: Any) -> None:
        if len(shape) != len(needed) or shape[1:] != needed[1:] or shape[0] < steps:
            raise ArgumentError(
                f"--actions {path} has the shape {shape}; {steps} steps of {n} agents need {needed}"
            )

    return iter(load_array(path, ".npy file of actions", check, rows=steps)[:steps])


def _table(result: dict[str, Any]) -> Table:
    table = Table(title=common.on_device(result["environment"], result["device"]), show_header=False)
    table.add_column("what", style="bold")
    table.add_column("figure")
    step_seconds = result["microseconds_per_step"] * 1e-6
    table.add_row(
        "agents x steps", f"{result['n_agents']:,} x {result['steps']:,} = {result['agent_steps']:,}"
    )
    table.add_row("throughput", f"{rate(result['agent_steps_per_second'])} agent-steps/s")
    table.add_row("one step of all agents", f"{duration(step_seconds)} ({result['counts']})")
    if "first_step_microseconds" in result:
        first = duration(result["first_step_microseconds"] * 1e-6)
        table.add_row("first step", f"{first} (loads the kernel; the first time ever compiles it)")
    table.add_row("episodes finished", f"{result['episodes']:,}, of them truncated {result['truncated']:,}")
    if result["episodes"]:
        for name, digits in (("return", 2), ("length", 1)):
            text = f"{result[f'{name}_mean']:.{digits}f}"
            if (spread := result.get(f"{name}_std")) is not None:
                text += f", standard deviation {spread:.{digits}f}"
            if f"{name}_min" in result:
                text += f", from {result[f'{name}_min']:g} to {result[f'{name}_max']:g}"
            table.add_row(name, text)
    return table
