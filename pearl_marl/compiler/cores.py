"""The core of an environment, generated for a target."""

from __future__ import annotations

from typing import NamedTuple

from pearl_marl.compiler.core_graph import core_graph
from pearl_marl.compiler.lowering import lowered
from pearl_marl.compiler.scheduling import scheduled
from pearl_marl.compiler.targets import FAMILIES, Target
from pearl_marl.compiler.verilog import system_verilog
from pearl_marl.spec import EnvSpec, snake_case


class Core(NamedTuple):
    """A generated core: its SystemVerilog, and what it takes."""

    text: str
    latency: int
    register_bits: int
    multipliers: int


def generated_core(spec: EnvSpec, family: str = "ecp5", mhz: float = 125.0) -> Core:
    """Return the core of an environment under its options.

    Raises
    ------
    ArgumentError
        The golden functions do what no hardware can.
    """
    target = Target(FAMILIES[family], mhz)
    graph, outputs = core_graph(spec)
    outputs = lowered(graph, outputs, target)
    schedule = scheduled(outputs, target)
    about = [f"({spec.id}{''.join(f', {k}={v!r}' for k, v in spec.options.items())}) for {family} at {mhz:g} MHz."]
    text = system_verilog(spec, snake_case(spec.name), outputs, schedule, about)
    multipliers = sum(n.op == "mul" for n in schedule.order)
    return Core(text, schedule.latency, schedule.register_bits, multipliers)
