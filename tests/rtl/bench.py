"""What the benches share."""

from __future__ import annotations

import functools
import itertools
import re
import sys
from collections.abc import Callable, Sequence
from importlib.util import module_from_spec, spec_from_file_location
from types import SimpleNamespace
from typing import Any

import cocotb
import harness
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles
from cocotbext.axi import AxiBus, AxiMaster

from pearl_marl.hardware import elaboration

_PACKAGE = elaboration.backbone_paths()[0].with_name("pearl_pkg.sv").read_text()
READ_LATENCY = int(re.findall(r" READ_LATENCY = (\d+);", _PACKAGE)[0])


def each_variant(**parameters: Sequence[Any]) -> Callable[[Any], Any]:
    """A test of every variant in the build: of its instance, and its arguments as ``given``.

    ``parameters`` are cocotb's own, as in ``cocotb.parametrize``.
    """

    def decorate(function: Any) -> Any:
        variants = harness.arguments()

        @functools.wraps(function)
        async def test(dut: Any, variant: str, **chosen: Any) -> None:
            await function(getattr(dut, variant), SimpleNamespace(**variants[variant]), **chosen)

        return cocotb.test(cocotb.parametrize(variant=list(variants), **parameters)(test))

    return decorate


async def start(dut: Any, **idle: int) -> None:
    """Start the clock, set inputs to their idle values and go through a reset."""
    # Its first edge comes when the inputs below are set.
    cocotb.start_soon(Clock(dut.clk_i, 10, unit="ns").start(start_high=False))
    for name, value in idle.items():
        getattr(dut, name).value = value
    # A master drives nothing before it is made, and what nobody drives starts at random.
    for channel in ("aw", "w", "ar"):
        if hasattr(dut, f"s_axi_{channel}valid"):
            getattr(dut, f"s_axi_{channel}valid").value = 0
    if hasattr(dut, "rst_ni"):
        await reset(dut)
    await ClockCycles(dut.clk_i, 2)


async def reset(dut: Any, cycles: int = 1) -> None:
    """Go through a reset, which takes one cycle, and let the pipeline drain."""
    dut.rst_ni.value = 0
    await ClockCycles(dut.clk_i, cycles)
    dut.rst_ni.value = 1
    await ClockCycles(dut.clk_i, 20)


TOYS = {
    **dict.fromkeys(("Meadow", "Nim"), "toy_world"),
    **dict.fromkeys(("Rover", "Glider", "Relay"), "toy_fields"),
}
"""Toy environments, and the modules that have them."""


def spec_of(name: str, options: dict[str, Any]) -> Any:
    """The spec that the pytest side means."""
    if name == "ShiftAdd":
        from shift_add import SPEC

        return SPEC.with_options(**options)
    if name in TOYS:
        # It stands outside of what a simulator looks for modules in.
        found = spec_from_file_location(TOYS[name], harness.HERE.parent / f"{TOYS[name]}.py")
        assert found is not None
        assert found.loader is not None
        module = sys.modules[TOYS[name]] = module_from_spec(found)
        found.loader.exec_module(module)
        return getattr(module, name.upper()).with_options(**options)
    if name == "Random":
        from random_steps import random_spec

        return random_spec(**options)
    if name == "Wide":
        from wide_steps import wide_spec

        return wide_spec(options["number"])
    from pearl_marl.envs import get_spec

    return get_spec(name).with_options(**options)


def axi_master(dut: Any, random: Any, idle: float) -> AxiMaster:
    """A master on the module's bus, with every channel idle in this share of cycles."""
    axi = AxiMaster(AxiBus.from_prefix(dut, "s_axi"), dut.clk_i, dut.rst_ni, reset_active_level=False)
    write, read = axi.write_if, axi.read_if
    for half in (write, read):
        # Every byte moved is logged otherwise, which takes longer than to move it.
        half.log.setLevel("WARNING")
    if idle:
        for channel in (write.aw_channel, write.w_channel, write.b_channel, read.ar_channel, read.r_channel):
            channel.set_pause_generator(pauses(random, idle))
    return axi


def pauses(random: Any, share: float) -> Any:
    """An endless idle pattern: pause in about this share of cycles."""
    return (random.random() < share for _ in itertools.count())
