"""The registers of an ECP5's block RAMs and multipliers, which Yosys leaves unused.

A flip-flop behind every output of a block, and nothing else behind it, becomes the block's own, as a vendor's
tool does it: out of a block RAM a word then comes 5 ns earlier. So does one in front of every input of a
multiplier, if what comes before that is a flip-flop too: on its way to a multiplier a word then takes its
last stage inside, which leaves it 3 ns more for the way.
"""

from __future__ import annotations

import itertools
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

_OPERAND_REGISTERS = {
    **{f"REG_INPUT{word}_{what}": f"{what}0" for word in "AB" for what in ("CLK", "CE", "RST")},
    "CLK0_DIV": "ENABLED",
}

_Sinks = dict[Any, list[tuple[str, str]]]


def absorb(module: dict[str, Any]) -> int:
    """Move flip-flops into the blocks beside them; return how many blocks have them now.

    ``module`` is one of a netlist as Yosys writes it in JSON, mapped for an ECP5, and is changed in place.
    """
    return _absorb_behind(module) + _absorb_before(module)


def register_inputs(module: dict[str, Any]) -> None:
    """Put a flip-flop behind every input of ``module`` but its clock, ``clk_i``."""
    cells, ports = module["cells"], module["ports"]
    nets = [bits for cell in cells.values() for bits in cell["connections"].values()]
    nets += [port["bits"] for port in ports.values()]
    free = itertools.count(1 + max(bit for bits in nets for bit in bits if isinstance(bit, int)))
    (clock,) = ports["clk_i"]["bits"]
    for name, port in ports.items():
        if port["direction"] != "input" or name == "clk_i":
            continue
        inside, port["bits"] = port["bits"], [next(free) for _ in port["bits"]]
        for i, (bit, behind) in enumerate(zip(port["bits"], inside, strict=True)):
            cells[f"{name}_{i}_register"] = {
                "type": "TRELLIS_FF",
                # A text of digits has a space at its end, or it would be a number.
                "parameters": {"CEMUX": "1 ", "CLKMUX": "CLK", "GSR": "DISABLED"},
                "attributes": {},
                "port_directions": {"CLK": "input", "DI": "input", "Q": "output"},
                "connections": {"CLK": [clock], "DI": [bit], "Q": [behind]},
            }


def _absorb_behind(module: dict[str, Any]) -> int:
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


def _absorb_before(module: dict[str, Any]) -> int:
    cells, sources = module["cells"], _sources(module)
    absorbed = 0
    passed: set[str] = set()
    for cell in [cell for cell in cells.values() if cell["type"] == "MULT18X18D"]:
        connections = cell["connections"]
        registers = {
            port: sources.get(bits[0], "")
            for port, bits in connections.items()
            if port.rstrip("0123456789") in ("A", "B") and bits and bits[0] not in ("0", "1", "x")
        }
        if not all(_follows_another(cells, sources, name) for name in registers.values()):
            continue
        controls = {_control(cells[name]) for name in registers.values()}
        if len(controls) != 1:
            continue
        clock, enable = controls.pop()
        if connections.get("CLK0", [clock]) != [clock] or connections.get("CE0", [enable]) != [enable]:
            continue
        cell["parameters"].update(_OPERAND_REGISTERS)
        for port, bit in {"CLK0": clock, "CE0": enable, "RST0": "0"}.items():
            connections[port] = [bit]
            cell["port_directions"][port] = "input"
        for port, name in registers.items():
            connections[port] = [_input(cells[name])]
        passed.update(registers.values())
        absorbed += 1
    used = _sinks(module)
    for name in passed:
        if cells[name]["connections"]["Q"][0] not in used:
            del cells[name]
    return absorbed


def _follows_another(cells: dict[str, Any], sources: dict[Any, str], name: str) -> bool:
    """Return whether a cell is a flip-flop that does nothing but delay another one."""
    if not _is_plain(cells.get(name)):
        return False
    before = cells.get(sources.get(_input(cells[name]), ""))
    return before is not None and before["type"] == "TRELLIS_FF"


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


def _sources(module: dict[str, Any]) -> dict[Any, str]:
    """Return the cell that drives each net."""
    return {
        bit: name
        for name, cell in module["cells"].items()
        for port, bits in cell["connections"].items()
        if cell["port_directions"][port] == "output"
        for bit in bits
    }


def _register(cells: dict[str, Any], behind: list[tuple[str, str]]) -> str | None:
    """Return the flip-flop that is all that an output drives, if a block's own can replace it."""
    (name, port), *others = behind
    return name if not others and port in ("DI", "M") and _is_plain(cells[name]) else None


def _is_plain(cell: dict[str, Any] | None) -> bool:
    """Return whether a cell is a flip-flop that a block's own can replace."""
    if cell is None or cell["type"] != "TRELLIS_FF":
        return False
    parameters, connections = cell["parameters"], cell["connections"]
    # A block's has no reset of its own net here, no inverted clock or enable, and starts at 0.
    plain = parameters.get("REGSET") == "RESET" and parameters.get("CLKMUX", "CLK") == "CLK"
    enabled = parameters.get("CEMUX", "1").strip() in ("1", "CE")
    return plain and enabled and connections.get("LSR", ["0"]) in ([], ["0"])


def _input(register: dict[str, Any]) -> Any:
    """Return the net that a flip-flop takes."""
    connections = register["connections"]
    return (connections.get("DI") or connections["M"])[0]


def _control(register: dict[str, Any]) -> tuple[Any, Any]:
    """Return the nets of a flip-flop's clock and enable."""
    always = register["parameters"].get("CEMUX", "1").strip() == "1"
    connections = register["connections"]
    return connections["CLK"][0], "1" if always else connections["CE"][0]
