"""The output registers of an ECP5's block RAMs and multipliers, which Yosys leaves unused.

A flip-flop behind every output of a block, and nothing else behind it, becomes the block's own: that is what
a vendor's tool does. Out of a block RAM a word then comes 5 ns earlier.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class _Block:
    """How a kind of cell takes registers: what its outputs start with, and what is set and connected then."""

    outputs: tuple[str, ...]
    clocks: tuple[str, ...]
    enables: tuple[str, ...]
    parameters: dict[str, str]
    inputs: dict[str, str] = field(default_factory=dict)


# Memories are read at port B.
_MEMORY = _Block(("DOB",), ("CLKB",), ("OCEB",), {"REGMODE_B": "OUTREG"})
# A word of 36 bits takes the outputs of both ports.
_WIDE_MEMORY = _Block(
    ("DOA", "DOB"), ("CLKA", "CLKB"), ("OCEA", "OCEB"), {"REGMODE_A": "OUTREG", "REGMODE_B": "OUTREG"}
)
_MULTIPLIER = _Block(
    ("P",),
    ("CLK0",),
    ("CE0",),
    {"REG_OUTPUT_CLK": "CLK0", "REG_OUTPUT_CE": "CE0", "REG_OUTPUT_RST": "RST0", "CLK0_DIV": "ENABLED"},
    {"RST0": "0"},
)

_Sinks = dict[Any, list[tuple[str, str]]]


def absorb(module: dict[str, Any]) -> int:
    """Move flip-flops into the blocks in front of them; return how many.

    ``module`` is one of a netlist as Yosys writes it in JSON, mapped for an ECP5, and is changed in place.
    """
    cells, sinks = module["cells"], _sinks(module)
    absorbed = 0
    for cell, block in [(cell, block) for cell in cells.values() if (block := _block(cell))]:
        used = {
            port: sinks[bits[0]]
            for port, bits in cell["connections"].items()
            if port.rstrip("0123456789") in block.outputs and bits and bits[0] in sinks
        }
        registers = {port: _register(cells, behind) for port, behind in used.items()}
        controls = {_control(cells[name]) for name in registers.values() if name is not None}
        if None in registers.values() or len(controls) != 1:
            continue
        (clock, enable), connections = controls.pop(), cell["connections"]
        if any(connections.get(port, [clock]) != [clock] for port in block.clocks):
            continue
        cell["parameters"].update(block.parameters)
        controls_of = {**dict.fromkeys(block.clocks, clock), **dict.fromkeys(block.enables, enable)}
        for port, bit in {**block.inputs, **controls_of}.items():
            connections[port] = [bit]
            cell["port_directions"][port] = "input"
        for port, name in registers.items():
            connections[port] = cells.pop(name)["connections"]["Q"]
            absorbed += 1
    return absorbed


def _block(cell: dict[str, Any]) -> _Block | None:
    """Return how a cell takes registers; ``None`` if it has none."""
    if cell["type"] == "DP16KD":
        return _WIDE_MEMORY if int(cell["parameters"]["DATA_WIDTH_B"], 2) == 36 else _MEMORY
    return _MULTIPLIER if cell["type"] == "MULT18X18D" else None


def _sinks(module: dict[str, Any]) -> _Sinks:
    """Return what every net drives, as cells and their ports; a port of the module is a cell of no name."""
    sinks: _Sinks = defaultdict(list)
    for name, cell in module["cells"].items():
        for port, bits in cell["connections"].items():
            if cell["port_directions"][port] != "output":
                for bit in bits:
                    sinks[bit].append((name, port))
    for name, port in module["ports"].items():
        for bit in port["bits"]:
            sinks[bit].append(("", name))
    return dict(sinks)


def _register(cells: dict[str, Any], behind: list[tuple[str, str]]) -> str | None:
    """Return the flip-flop that is all that an output drives, if a block's own can replace it."""
    (name, port), *others = behind
    if others or port not in ("DI", "M") or cells[name]["type"] != "TRELLIS_FF":
        return None
    parameters, connections = cells[name]["parameters"], cells[name]["connections"]
    # A block's has no reset of its own net here, no inverted clock or enable, and starts at 0.
    plain = parameters.get("REGSET") == "RESET" and parameters.get("CLKMUX", "CLK") == "CLK"
    enabled = parameters.get("CEMUX", "1").strip() in ("1", "CE")
    return name if plain and enabled and connections.get("LSR", ["0"]) in ([], ["0"]) else None


def _control(register: dict[str, Any]) -> tuple[Any, Any]:
    """Return the nets of a flip-flop's clock and enable."""
    always = register["parameters"].get("CEMUX", "1").strip() == "1"
    connections = register["connections"]
    return connections["CLK"][0], "1" if always else connections["CE"][0]
