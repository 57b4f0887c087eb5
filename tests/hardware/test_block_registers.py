"""Which flip-flops become a block's own, and which do not."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from pearl_marl.hardware.block_registers import absorb, register_inputs

CLOCK, ENABLE, RESET = 2, 3, 4


def flip_flop(d: int, q: int) -> dict[str, Any]:
    return {
        "type": "TRELLIS_FF",
        "parameters": {"REGSET": "RESET", "CLKMUX": "CLK", "CEMUX": "CE"},
        "port_directions": {**dict.fromkeys(("CLK", "CE", "DI", "LSR"), "input"), "Q": "output"},
        "connections": {"CLK": [CLOCK], "CE": [ENABLE], "DI": [d], "Q": [q]},
    }


def memory() -> dict[str, Any]:
    """Two outputs of a block RAM, a flip-flop behind each, and what they drive; a third drives nothing."""
    outputs = {"DOB0": [10], "DOB1": [11], "DOB2": [12]}
    block = {
        "type": "DP16KD",
        "parameters": {"DATA_WIDTH_B": f"{18:b}", "REGMODE_B": "NOREG"},
        "port_directions": {"CLKB": "input", "OCEB": "input", **dict.fromkeys(outputs, "output")},
        "connections": {"CLKB": [CLOCK], "OCEB": ["1"], **outputs},
    }
    cells = {"block": block, "first": flip_flop(10, 20), "second": flip_flop(11, 21)}
    return {"cells": cells, "ports": {"clk_i": {"bits": [CLOCK]}, "q_o": {"bits": [20, 21]}}}


def test_registers_behind_every_output_are_absorbed() -> None:
    module = memory()
    assert absorb(module) == 1
    (block,) = module["cells"].values()
    assert block["parameters"] == {"DATA_WIDTH_B": f"{18:b}", "REGMODE_B": "OUTREG"}
    outputs = {"DOB0": [20], "DOB1": [21], "DOB2": [12]}
    assert block["connections"] == {"CLKB": [CLOCK], "OCEB": [ENABLE], **outputs}


def test_a_wide_word_leaves_a_memory_at_both_ports() -> None:
    module = memory()
    block = module["cells"]["block"]
    block["parameters"] = {"DATA_WIDTH_B": f"{36:b}"}
    block["connections"] = {"CLKA": [CLOCK], "CLKB": [CLOCK], "DOA0": [10], "DOB0": [11]}
    block["port_directions"] = {"CLKA": "input", "CLKB": "input", "DOA0": "output", "DOB0": "output"}
    assert absorb(module) == 1
    assert block["parameters"] == {"DATA_WIDTH_B": f"{36:b}", "REGMODE_A": "OUTREG", "REGMODE_B": "OUTREG"}
    assert block["connections"]["OCEA"] == block["connections"]["OCEB"] == [ENABLE]
    assert (block["connections"]["DOA0"], block["connections"]["DOB0"]) == ([20], [21])


def test_a_multiplier_is_clocked_then() -> None:
    module = memory()
    block = module["cells"]["block"]
    block["type"], block["parameters"] = "MULT18X18D", {}
    block["connections"] = {"P0": [10], "P1": [11]}
    block["port_directions"] = {"P0": "output", "P1": "output"}
    for name in ("first", "second"):
        module["cells"][name]["parameters"]["CEMUX"] = "1 "
    assert absorb(module) == 1
    assert block["parameters"]["REG_OUTPUT_CLK"] == "CLK0"
    ties = {"CLK0": [CLOCK], "CE0": ["1"], "RST0": ["0"]}
    assert block["connections"] == {"P0": [20], "P1": [21], **ties}
    assert set(ties) < set(block["port_directions"])


@pytest.mark.parametrize(
    "change",
    [
        lambda module: module["ports"]["q_o"]["bits"].append(10),  # an output is used unregistered, too
        lambda module: module["cells"]["second"].update(type="LUT4"),
        lambda module: module["cells"]["second"]["connections"].update(DI=[30], LSR=[11]),
        lambda module: module["cells"]["second"]["connections"].update(CLK=[31]),
        lambda module: module["cells"]["second"]["connections"].update(CE=[32]),
        lambda module: module["cells"]["second"]["connections"].update(LSR=[RESET]),
        lambda module: module["cells"]["second"]["parameters"].update(REGSET="SET"),
        lambda module: module["cells"]["second"]["parameters"].update(CLKMUX="INV"),
        lambda module: module["cells"]["second"]["parameters"].update(CEMUX="INV"),
        lambda module: module["cells"]["block"]["connections"].update(CLKB=[33]),
    ],
)
def test_what_a_block_cannot_do_stays(change: Any) -> None:
    module = memory()
    change(module)
    before = copy.deepcopy(module)
    assert absorb(module) == 0
    assert module == before


def product() -> dict[str, Any]:
    """A multiplier with flip-flops before one operand, each behind another one; the other is a constant."""
    block = {
        "type": "MULT18X18D",
        "parameters": {},
        "port_directions": {**dict.fromkeys(("A0", "A1", "B0", "CLK0"), "input"), "P0": "output"},
        "connections": {"A0": [20], "A1": [21], "B0": ["1"], "P0": [40]},
    }
    cells = {"block": block, "first": flip_flop(10, 20), "second": flip_flop(11, 21)}
    cells |= {"before first": flip_flop(8, 10), "before second": flip_flop(9, 11)}
    return {"cells": cells, "ports": {"p_o": {"bits": [40]}}}


def test_a_multipliers_words_take_their_last_stage_inside() -> None:
    module = product()
    module["ports"]["q_o"] = {"bits": [21]}  # a flip-flop that somebody else looks at stays as well
    assert absorb(module) == 1
    assert set(module["cells"]) == {"block", "second", "before first", "before second"}
    block = module["cells"]["block"]
    assert (block["connections"]["A0"], block["connections"]["A1"]) == ([10], [11])
    assert (block["connections"]["CLK0"], block["connections"]["CE0"]) == ([CLOCK], [ENABLE])
    assert block["parameters"]["REG_INPUTA_CLK"] == block["parameters"]["REG_INPUTB_CLK"] == "CLK0"


@pytest.mark.parametrize(
    "change",
    [
        lambda cells: cells["before first"].update(type="LUT4"),
        lambda cells: cells["second"]["connections"].update(LSR=[RESET]),
        lambda cells: cells["second"]["connections"].update(CE=[32]),
        lambda cells: cells["block"]["connections"].update(A1=[5]),
        lambda cells: cells["block"]["connections"].update(CLK0=[31]),
    ],
)
def test_what_a_multiplier_cannot_do_stays(change: Any) -> None:
    module = product()
    change(module["cells"])
    before = copy.deepcopy(module)
    assert absorb(module) == 0
    assert module == before


def test_inputs_are_registered_but_for_the_clock() -> None:
    behind = flip_flop(20, 30)
    inputs = {"clk_i": [CLOCK], "valid_i": [ENABLE], "word_i": [20, 21]}
    ports = {name: {"direction": "input", "bits": bits} for name, bits in inputs.items()}
    module = {"cells": {"behind": behind}, "ports": ports | {"q_o": {"direction": "output", "bits": [30]}}}
    register_inputs(module)
    assert module["ports"]["clk_i"]["bits"] == [CLOCK]
    assert module["ports"]["q_o"]["bits"] == [30]
    outside = [bit for name in ("valid_i", "word_i") for bit in ports[name]["bits"]]
    assert len(set(outside) - {CLOCK, ENABLE, RESET, 20, 21, 30}) == 3
    registers = [cell["connections"] for cell in module["cells"].values() if cell is not behind]
    made = [(register["DI"], register["Q"]) for register in registers]
    assert made == [([bit], [inside]) for bit, inside in zip(outside, (ENABLE, 20, 21), strict=True)]
    assert all(register["CLK"] == [CLOCK] for register in registers)
