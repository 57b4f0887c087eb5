"""``pearl plan``: which build, and how fast it will be behind a link."""

from __future__ import annotations

import math
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from pearl_marl.benchmark.tables import duration, rate
from pearl_marl.checks import checked_choice
from pearl_marl.cli import common
from pearl_marl.cli.common import console
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation.machine import machine
from pearl_marl.hardware.boards import BOARDS
from pearl_marl.hardware.elaboration import clocked
from pearl_marl.hardware.fitting import PARTS
from pearl_marl.latency import LINKS, Link, loop_cycles
from pearl_marl.latency.planning import Plan, plan
from pearl_marl.latency.rollout_planning import RolloutCandidate, plan_rollouts

ANY = "any"
"""The ``--part`` that everything fits."""
CLOCK = BOARDS["vc707"].clock_mhz


def command(
    env_id: common.EnvName,
    n_envs: Annotated[int, typer.Option(min=1, help="Number of slots (worlds) of the design.")] = 43008,
    link: Annotated[
        str,
        typer.Option(
            metavar=f"{'|'.join(LINKS)}|CALL,WRITE,READ",
            help="The link between host and hardware; or your own: microseconds per call, GB/s to the "
            "hardware, GB/s from it.",
        ),
    ] = "gen2x8",
    part: Annotated[
        str,
        typer.Option(
            metavar=f"{'|'.join(PARTS)}|{ANY}",
            help=f"The part that memories and multipliers have to fit; `{ANY}` is without limits.",
        ),
    ] = "vc707",
    clock: Annotated[float, typer.Option(metavar="MHZ", help="The hardware's clock rate.")] = CLOCK,
    pe_num: Annotated[
        int | None, typer.Option(help="Consider only this number of processing elements.")
    ] = None,
    data_wl: Annotated[int | None, typer.Option(help="Consider only words of this many bits.")] = None,
    policy: Annotated[
        str | None,
        common.device_policy_option("Plan for rollouts of this policy, which move nothing over the link."),
    ] = None,
    option: common.Options = None,
    out: common.Out = None,
    as_json: common.AsJson = False,
) -> None:
    """Choose processing elements and word width for a link and a part; predict throughput and bottleneck.

    The smallest build that is nearly the fastest. Where its cores would take more than a quarter of the
    part's multipliers, they are fewer, as long as they compute a step in less time than the link moves it.

    A prediction: clock cycles are counted, the host's part is measured here, the link's is as stated. With
    --policy, multipliers are divided between cores and policy engine.
    """
    spec = common.spec_of(env_id, option)
    checked_choice("--part", part, (*PARTS, ANY))
    acting = common.device_policy(policy, spec)
    if acting is not None:
        if (acting.spec.id, acting.spec.options) != (spec.id, spec.options):
            raise ArgumentError(f"{policy} is for {acting.spec.id}, and the plan for {spec.id}")
        file = f"plan_rollouts_{spec.name}_{n_envs}.json"
        common.check_results(out, file)
        plans = plan_rollouts(acting, n_envs, clock * 1e6, PARTS.get(part), pe_num, data_wl)
        result: dict[str, Any] = {
            "environment": spec.id,
            "options": dict(spec.options),
            "policy": policy,
            "n_envs": n_envs,
            "clock_mhz": clock,
            "part": part,
            "chosen": plans[0].as_json(),
            "candidates": [candidate.as_json() for candidate in plans],
            "machine": machine(),
        }
        if not common.delivered(result, as_json, out, file):
            _show_rollouts(f"{spec.id}, {n_envs:,} slots: rollouts at {clock:g} MHz", plans, part)
        return
    taken = _link(link)
    file = f"plan_{spec.name}_{n_envs}.json"
    common.check_results(out, file)
    found = plan(spec, n_envs, taken, clock * 1e6, PARTS.get(part), pe_num, data_wl)
    layout, usage = found.chosen.layout, found.usage
    sizes = f"--n-envs {layout.n_envs} --pe-num {layout.pe_num} --data-wl {layout.data_wl}"
    options = (f"--option {pair}" for pair in option or ())
    result = {
        "environment": spec.id,
        "options": dict(spec.options),
        "n_envs": layout.n_envs,
        "clock_mhz": clock,
        "link": {
            "name": taken.name,
            "call_us": round(taken.call * 1e6, 6),
            "write_gb_per_s": taken.write_rate / 1e9,
            "read_gb_per_s": taken.read_rate / 1e9,
            "source": taken.source,
        },
        "bytes_written": layout.step_write[1],
        "bytes_read": layout.step_read[1],
        "loop_cycles": loop_cycles(spec, layout, clocked("xc7", clock))._asdict(),
        "chosen": found.chosen.as_json(),
        "overlap": None if found.overlap is None else found.overlap.as_json(),
        "candidates": [candidate.as_json() for candidate in found.candidates],
        "part": part,
        "own_core": spec.core is not None,
        "reason": _reason(found, part),
        "usage": None if usage is None else usage.as_json(),
        "synthesise": " ".join([f"pearl synth {env_id} {sizes}", *options]),
        "machine": machine(),
    }
    if common.delivered(result, as_json, out, file):
        return
    console.print(_candidates(result, found))
    console.print(_stages(result, found))
    for sentence in _sentences(result, found):
        console.print(sentence, soft_wrap=True)


def _show_rollouts(title: str, plans: list[RolloutCandidate], part: str) -> None:
    best = plans[0]
    grid = common.table(title, [], ["PEs", "side", "cycles", "steps/s", "core DSP", "engine DSP"])
    grid.add_column("limit", no_wrap=True)
    for candidate in sorted(plans, key=lambda one: one.layout.pe_num):
        engine, chosen = candidate.layout.engine, candidate is best
        side = "-" if engine is None or not engine.is_network else f"{engine.side:,}"
        figures = (candidate.layout.pe_num, candidate.cycles, candidate.core_dsp, candidate.engine_dsp)
        pes, cycles, cores, multipliers = (f"{figure:,}" for figure in figures)
        limit = f"{candidate.limit}{' (chosen)' if chosen else ''}"
        cells = pes, side, cycles, rate(candidate.rate), cores, multipliers, limit
        grid.add_row(*cells, style="bold green" if chosen else None)
    console.print(grid)
    common.say(
        f"What limits: the {best.limit}. DSP: {best.core_dsp + best.engine_dsp:,}{_of(part, 'dsp')}; those "
        "of drawn actions, and the block RAM of weights, are not counted. Side: groups of slots that the "
        "engine computes side by side."
    )


def _link(text: str) -> Link:
    if text in LINKS:
        return LINKS[text]
    try:
        call, write, read = (float(part) for part in text.split(","))
    except ValueError:
        raise ArgumentError(
            f"there is no link {text!r}; possible are {', '.join(LINKS)}, and three numbers such as "
            "30,3.2,2.6: microseconds a call, GB/s to the hardware, GB/s from it"
        ) from None
    if not (0 <= call < math.inf and 0 < write < math.inf and 0 < read < math.inf):
        raise ArgumentError(
            f"--link is {text!r}; the microseconds a call must be at least 0, and both rates above 0"
        )
    return Link(text, call * 1e-6, write * 1e9, read * 1e9, "given")


def _candidates(result: dict[str, Any], found: Plan) -> Table:
    title = f"{result['environment']}, {result['n_envs']:,} slots, link {result['link']['name']}"
    grid = common.table(title, [], ["PEs", "word", "cycles", "a step", "steps/s", "BRAM36", "DSP"])
    grid.add_column("longest stage", no_wrap=True)
    for candidate in found.candidates:
        prediction, chosen = candidate.prediction, candidate is found.chosen
        grid.add_row(
            f"{prediction.pe_num:,}",
            f"{prediction.data_wl}",
            f"{round(prediction.device * result['clock_mhz'] * 1e6):,}",
            duration(prediction.total),
            rate(prediction.rate),
            f"{candidate.bram36:g}",
            f"{candidate.dsp:,}",
            f"{prediction.bottleneck}{' (chosen)' if chosen else ''}",
            style="bold green" if chosen else None,
        )
    return grid


def _stages(result: dict[str, Any], found: Plan) -> Table:
    step, link = found.chosen.prediction, result["link"]
    clock = f"{result['clock_mhz']:g} MHz"
    rows = [
        ("T1", "pack", step.pack, "measured on this machine"),
        ("T2", "write", step.write, f"{result['bytes_written']:,} bytes, {link['call_us']:g} us a call"),
        ("T3", "words in", step.words_in, f"at {clock}; at the same time as T4 and T5"),
        ("T4", "compute", step.compute, f"at {clock}"),
        ("T5", "words out", step.words_out, f"at {clock}"),
        ("", "T3 to T5 together", step.device, "counted clock cycles"),
        ("T6", "read", step.read, f"{result['bytes_read']:,} bytes, {link['call_us']:g} us a call"),
        ("T7", "unpack", step.unpack, "measured on this machine"),
        ("", "a step", step.total, f"{rate(step.rate)} steps/s, one step after the other"),
    ]
    grid = Table(title=f"{step.pe_num:,} PEs, {step.data_wl}-bit words")
    for heading in ("", "stage", "time", ""):
        grid.add_column(heading, justify="right" if heading == "time" else "left", no_wrap=bool(heading))
    for time, stage, seconds, why in rows:
        grid.add_row(time, stage, duration(seconds), why)
    return grid


def _reason(found: Plan, part: str) -> str:
    """Return why there are so many processing elements: what the next more would cost and save."""
    chosen, larger = found.chosen.prediction, found.larger
    reason = f"{chosen.pe_num:,} PEs"
    if larger is not None:
        less = max(0.0, 1 - larger.prediction.total / chosen.total)
        reason += f": with {larger.layout.pe_num:,} a step would take {100 * less:.1f} % less time"
        if larger.dsp:
            reason += f", and {larger.dsp:,} DSP{_of(part, 'dsp')} where these take {found.chosen.dsp:,}"
    return (
        f"{reason}. Computing takes {duration(chosen.device)} of a step, the link {duration(chosen.link)}: "
        f"the cores {'outrun' if chosen.device < chosen.link else 'do not outrun'} it."
    )


def _of(part: str, resource: str) -> str:
    """Return how much of a resource a part has, as words."""
    return f" of the {getattr(PARTS[part], resource):,} of a {part}" if part in PARTS else ""


def _sentences(result: dict[str, Any], found: Plan) -> list[str]:
    overlap, chosen, usage, part = found.overlap, found.chosen, found.usage, result["part"]
    sentences = [result["reason"]]
    if overlap is not None:
        sentences.append(
            f"Two half-batches in flight, on two devices of {overlap.half.n_envs:,} slots: "
            f"{rate(overlap.rate)} steps/s; what is busy longest is the {overlap.bottleneck}."
        )
    resources = f"Block RAM: {chosen.bram36:g} BRAM36{_of(part, 'bram36')}, by the shapes of the memories."
    if result["own_core"]:
        resources += (
            " DSP are those of random draws alone: what the environment's own core takes is not known."
        )
    if usage is None:
        resources += f" LUT and FF are known after: {escape(result['synthesise'])}"
    else:
        resources += (
            f" Synthesised: {usage.lut:,} LUT, {usage.ff:,} FF, {usage.bram36:g} BRAM36, {usage.dsp:,} DSP."
        )
        if part in PARTS and (lacks := PARTS[part].lacks(usage)):
            resources += f" [red]A {part} has fewer: {', '.join(lacks)}.[/red]"
    sentences += [resources, f"Link: {result['link']['source']}."]
    return sentences
