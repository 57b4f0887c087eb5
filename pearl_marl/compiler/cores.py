"""The core of an environment or of a policy, generated for a target."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from pearl_marl.compiler.core_graph import CoreGraph, Output, act_graph, core_graph, show_graph
from pearl_marl.compiler.drawing import drawing
from pearl_marl.compiler.lowering import lowered
from pearl_marl.compiler.scheduling import Schedule, scheduled
from pearl_marl.compiler.targets import Target
from pearl_marl.compiler.verilog import system_verilog, view_system_verilog
from pearl_marl.golden import GoldenFunction
from pearl_marl.golden.tracing.nodes import in_order
from pearl_marl.spec import EnvSpec, snake_case

BACKBONE = "pearl"
"""The first word of the name of every module and package around a core."""


class Core(NamedTuple):
    """A generated core: its SystemVerilog, and what it takes."""

    text: str
    picture: Callable[[], str]
    """Draws its operations, as SVG."""
    latency: int
    """Cycles from an input to its result; an input can follow the other in every cycle."""
    register_bits: int
    multipliers: int
    levels: float
    """How many tables of the family the slowest stage takes one after the other, by estimate."""


def generated_core(spec: EnvSpec, target: Target, name: str | None = None) -> Core:
    """Return the core of an environment, with its options as constants.

    Parameters
    ----------
    spec, target
        What it is to do, and for which hardware at which clock.
    name
        Its module is ``<name>_pe`` and its package ``<name>_pkg``; :func:`core_name` by default.

    Raises
    ------
    ArgumentError
        The golden functions do what no hardware can; the message names the file and the line.
    """
    write = partial(system_verilog, spec, name or core_name(spec))
    return _core(spec, spec.name, core_graph(spec), target, write)


ACT = "pearl_act"
"""The module of a policy's core, and with ``_pkg`` its package: a build has one at most."""


def generated_act(spec: EnvSpec, act: GoldenFunction, draws: int, target: Target) -> Core:
    """Return the core of a policy, of what :func:`pearl_marl.compiler.core_graph.act_graph` takes."""
    write = partial(view_system_verilog, spec, draws, ACT)
    return _core(spec, f"A policy for {spec.name}", act_graph(spec, act, draws), target, write)


SHOW = "pearl_show"
"""The module that makes pictures of words, and with ``_pkg`` its package: a build has one at most."""


def generated_show(spec: EnvSpec, target: Target) -> Core:
    """Return the core of a spec's pictures, :func:`pearl_marl.compiler.core_graph.show_graph`."""
    write = partial(view_system_verilog, spec, None, SHOW)
    return _core(spec, f"A picture of {spec.name}", show_graph(spec), target, write)


def _core(
    spec: EnvSpec,
    title: str,
    graph: CoreGraph,
    target: Target,
    write: Callable[[list[Output], Schedule, str], str],
) -> Core:
    outputs = lowered(*graph, target)
    schedule = scheduled(outputs, target)
    options = ", ".join(f"{option}={value!r}" for option, value in spec.options.items())
    options = " ".join(options.encode("ascii", "backslashreplace").decode().split())  # it is a line's remark
    made_for = f"{target.name} at {target.mhz:g} MHz"
    return Core(
        text=write(outputs, schedule, f"// {spec.id}({options}), for {made_for}."),
        picture=partial(drawing, f"{title}, {made_for}", outputs, schedule),
        latency=schedule.latency,
        register_bits=schedule.register_bits,
        multipliers=sum(node.op == "mul" for node in schedule.order),
        levels=schedule.longest / target.family.level,
    )


def core_name(spec: EnvSpec) -> str:
    """Return what the names of an environment's module and package begin with.

    It is the environment's name, unless that begins as the names of the backbone do.
    """
    name = snake_case(spec.name)
    return f"env_{name}" if name.partition("_")[0] == BACKBONE else name


def multipliers(spec: EnvSpec, target: Target) -> int:
    """Return how many multipliers the core of :func:`generated_core` takes: known before it has stages."""
    outputs = lowered(*core_graph(spec), target)
    return sum(node.op == "mul" for node in in_order(o.node for o in outputs))
