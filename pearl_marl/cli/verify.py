"""``pearl verify``: a device against the golden functions, bit for bit; or those against an original."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from gymnasium.vector import AutoresetMode
from rich.markup import escape
from rich.table import Table

from pearl_marl.checks import MANY
from pearl_marl.cli import common
from pearl_marl.cli.common import console, error_console
from pearl_marl.devices import Device, Lockstep, Rtl
from pearl_marl.devices.replay import Replay
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError, DeviceError, LockstepError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.engines import with_engine
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.spec import EnvSpec
from pearl_marl.verification import Run, replay, runs, verify

Autoreset = StrEnum("Autoreset", {"SAME_STEP": "same-step", "NEXT_STEP": "next-step"})
"""The modes of a device, as the command line writes them."""
Starts = StrEnum("Starts", ["RANDOM", "STORED"])
"""The initial states of a device."""
ABOUT = 1024
"""How many agents are compared by default: the reference steps them one by one, in Python."""
STEPS = 300


def command(
    subject: Annotated[
        str, typer.Argument(metavar="ENV|FILE", help="An environment of `pearl envs`, or a replay file.")
    ],
    device: Annotated[
        str | None, typer.Option(help="The device to check.", show_default="native, or the file's")
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            help="What it must agree with: `reference` (the golden functions) or another device.",
            show_default="reference, or the file's",
        ),
    ] = None,
    n_agents: Annotated[int | None, common.agents_option(ABOUT)] = None,
    steps: Annotated[
        int, typer.Option(min=1, max=MANY, help="Number of steps of every agent, divided among the modes.")
    ] = STEPS,
    seed: common.Seed = 0,
    max_cycles: Annotated[int | None, common.max_cycles_option("both")] = None,
    autoreset_mode: Annotated[
        Autoreset | None, typer.Option(help="When a world that ended starts again.", show_default="both")
    ] = None,
    initial_states: Annotated[
        Starts | None, typer.Option(help="Where episodes begin.", show_default="both")
    ] = None,
    policy: Annotated[
        str | None,
        common.device_policy_option(
            "Do rollouts of this policy, not steps with random actions; the device `rtl` gets an engine for "
            "it."
        ),
    ] = None,
    option: common.Options = None,
    env: Annotated[
        str | None,
        typer.Option(
            metavar="PACKAGE:ENV", help="The environment of a replay file, where it is of a package of yours."
        ),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="PACKAGE:CLASS|ID",
            help="Compare the golden functions with the environment that they follow, not a device with "
            "them.",
        ),
    ] = None,
    original_option: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="An argument of the original of --against; may be repeated."),
    ] = None,
    out: common.Out = None,
    as_json: common.AsJson = False,
) -> None:
    """Compare a device with the golden functions, every word of every field, or replay a divergence.

    Exit status 0: bit-exact. 1: not, and the first divergence is shown; with --out, it is also
    written as a file that `pearl verify FILE` replays. 2: the call was refused.
    """
    if against is not None:
        others = device, reference, n_agents, max_cycles, autoreset_mode, initial_states, policy, env, out
        if any(given is not None for given in others):
            raise ArgumentError(
                "--against compares golden functions with an original: of the options it takes --steps, "
                "--seed, --option, --original-option and --json"
            )
        _against(common.spec_of(subject, option), against, original_option, steps, seed, as_json)
        return
    if original_option is not None:
        raise ArgumentError("--original-option is about the original of --against: give one")
    if subject.endswith(".json") or Path(subject).is_file():
        modes = n_agents, max_cycles, autoreset_mode, initial_states, policy, option, out
        if any(given is not None for given in modes) or (steps, seed) != (STEPS, 0):
            raise ArgumentError(
                f"{subject} is one recorded call: of the options, it takes --env, --device, --reference and "
                "--json"
            )
        _replay(Path(subject), env, device, reference, as_json)
        return
    if env is not None:
        raise ArgumentError(f"--env is for a replay file, and {subject} is none: leave it out")
    try:
        spec = common.spec_of(subject, option)
    except ArgumentError:
        if Path(subject).is_dir():
            raise ArgumentError(
                f"{subject} is a folder; name an environment of `pearl envs`, or a replay file"
            ) from None
        raise
    n_agents = common.agents_of(spec, n_agents, ABOUT)
    mode = None if autoreset_mode is None else AutoresetMode[autoreset_mode.name]
    plan = runs(spec, n_agents, steps, mode, initial_states and initial_states.value, max_cycles)
    device, reference = device or "native", reference or "reference"
    if policy is not None and out is not None:
        raise ArgumentError("--out is for a file that is replayed, which rollouts have none of: leave it out")
    acting = common.device_policy(policy, spec)
    if device == reference:
        raise ArgumentError(
            f"--device and --reference are both {device!r}, which always agrees with itself: name another one"
        )
    divergence = common.divergence_file(spec, device)
    common.check_results(out, divergence)
    parted: LockstepError | None = None
    path = None
    try:
        steps_of_all = (
            step
            for run in plan
            for step in verify(run, Lockstep(_checked(device, run, acting), reference), seed, acting)
        )
        label = f"{spec.name} on {device}, {n_agents:,} agents"
        for _ in common.progress(steps_of_all, sum(run.steps for run in plan), label):
            pass
    except LockstepError as caught:
        parted = caught
        if out is not None:
            path = out / divergence
            _smallest(parted.replay, device, reference).write(path)
    result: dict[str, Any] = {
        "environment": spec.id,
        "options": dict(spec.options),
        "device": device,
        "reference": reference,
        "n_agents": n_agents,
        "seed": seed,
        "exact": parted is None,
        "agent_steps": n_agents * sum(run.taken for run in plan),
        "words": sum(run.words for run in plan),
        "episodes": sum(run.episodes for run in plan),
        "modes": [_row(run) for run in plan],
        "divergence": None if parted is None else parted.divergence.as_json(),
        "replay": None if path is None else str(path),
    }
    if as_json:
        common.print_json(result)
    else:
        console.print(_table(escape(f"{spec.id} on {device}, compared with {reference}"), result["modes"]))
        _say(
            parted,
            f"{device} is bit-exact with {reference} over {result['agent_steps']:,} agent-steps: "
            f"{result['words']:,} words compared, {result['episodes']:,} episodes ended.",
        )
        if path is not None:
            again = common.replaying(path, env=subject, device=device, reference=reference)
            common.say(f"Wrote {path}: {again} replays it.")
    if parted is not None:
        sys.exit(1)
    if not result["episodes"]:
        error_console.print(
            "Warning: no episode ended, so no restart was compared. Take more --steps or --n-agents.",
            style="yellow",
        )


def _checked(device: str, run: Run, policy: DevicePolicy | None) -> str | Device:
    """Return the device to check: the simulated hardware has the engine that a policy needs."""
    if policy is None or device != "rtl":
        return device
    return Rtl(engine=with_engine(Build.of(run.config.spec, run.config.n_envs), policy).layout.engine)


def _against(
    spec: EnvSpec, name: str, options: list[str] | None, steps: int, seed: int, as_json: bool
) -> None:
    """Compare golden functions with the environment that they follow."""
    from pearl_marl.porting import Original
    from pearl_marl.porting.against import compare

    given = dict(spec.options) if spec.oracle == name else {}  # which has the same arguments
    given |= common.env_options(options, "--original-option")
    result = compare(spec, Original(name, **given), steps, seed)
    if as_json:
        errors = [error._asdict() for error in result.errors]
        common.print_json({"environment": spec.id, "original": name, **result._asdict(), "errors": errors})
    else:
        common.say(f"{spec.id} beside {name}: {result.how}.")
        if result.difference is not None:
            console.print(f"[bold red]It differs.[/] {escape(result.difference)}.", soft_wrap=True)
        elif result.errors:
            grid = common.table(
                f"Error of one step, {result.steps:,} steps", ["of", "states"], ["max", "mean"]
            )
            for error in result.errors:
                grid.add_row(escape(error.name), error.states, f"{error.most:.3g}", f"{error.mean:.3g}")
            console.print(grid)
        elif result.steps:
            console.print(f"[bold green]Equal in {result.steps:,} steps.[/]")
        (mean, spread), (other, other_spread) = result.returns
        mine, theirs = result.lengths
        common.say(
            f"Returns of a random policy: {mean:.4g} +- {spread:.3g} in {mine:.4g} steps, the original's "
            f"{other:.4g} +- {other_spread:.3g} in {theirs:.4g} steps."
        )
    if not result.equal:
        sys.exit(1)


def _smallest(recorded: Replay, device: str, reference: str) -> Replay:
    """Return the replay of the one slot if that differs by itself in the same word, else of the batch."""
    alone = recorded.alone()
    try:
        again = replay(alone, Lockstep(device, reference))
    except DeviceError:  # not every device can be so small
        return recorded
    return alone if again is not None and again.field == recorded.divergence.field else recorded


def _replay(path: Path, env: str | None, device: str | None, reference: str | None, as_json: bool) -> None:
    """Replay a file; ``env`` is imported first, as nothing is that the file itself names."""
    spec = None if env is None else get_spec(env)
    recorded_call = Replay.read(path)
    if spec is not None and recorded_call.config.spec.id != spec.id:
        raise ArgumentError(f"--env is {env}, and {path} is of {recorded_call.config.spec.id}")
    recorded = recorded_call.divergence
    for option, given, there in (
        ("--device", device, recorded.device),
        ("--reference", reference, recorded.reference),
    ):
        if given is None and ":" in there:  # nothing is opened and written to because a file says so
            raise ArgumentError(f"it was recorded on {there}: give {option} {there}, or another one")
    device, reference = device or recorded.device, reference or recorded.reference
    error = replay(recorded_call, Lockstep(device, reference))
    if as_json:
        common.print_json(
            {
                "environment": recorded.environment,
                "device": device,
                "reference": reference,
                "exact": error is None,
                "divergence": None if error is None else error.divergence.as_json(),
                "recorded": recorded.as_json(),
            }
        )
    else:
        agents = common.counted(recorded_call.config.n_agents, "agent")
        common.say(f"Recorded, replayed here with {agents}:\n{recorded}\n")
        _say(error, f"The divergence is gone: {device} agrees with {reference} in every word of this call.")
    if error is not None:
        sys.exit(1)


def _say(error: LockstepError | None, verdict: str) -> None:
    if error is None:
        console.print(f"[bold green]{escape(verdict)}[/]", soft_wrap=True)
    else:
        console.print(f"[bold red]Not bit-exact.[/] {escape(str(error))}", soft_wrap=True)


def _row(run: Run) -> dict[str, Any]:
    return {
        "autoreset_mode": Autoreset[run.config.autoreset_mode.name].value,
        "initial_states": run.config.initial_states,
        "max_cycles": run.config.limit,
        "steps": run.taken,
        "exact": run.exact,
        "words": run.words,
        "episodes": run.episodes,
        "truncated": run.truncated,
    }


def _table(title: str, modes: list[dict[str, Any]]) -> Table:
    grid = common.table(title, ["autoreset", "starts"], ["limit", "steps", "words", "episodes"])
    grid.add_column("", no_wrap=True)
    verdicts = {True: "[green]bit-exact[/]", False: "[bold red]differs[/]", None: "[dim]not run[/]"}
    for mode in modes:
        figures = (f"{mode[name]:,}" for name in ("steps", "words", "episodes"))
        limit = f"{mode['max_cycles'] or 'none'}"
        grid.add_row(mode["autoreset_mode"], mode["initial_states"], limit, *figures, verdicts[mode["exact"]])
    return grid
