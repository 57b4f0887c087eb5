"""Names that authors give reach the hardware: none of them is one too many there."""

from __future__ import annotations

import keyword
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench import spec_of
from harness import whole
from linters import lint
from pyslang.parsing import TokenKind
from wide_steps import renamed, spec_with

from pearl_marl.compiler import verilog
from pearl_marl.compiler.cores import BACKBONE, core_name, generated_core
from pearl_marl.compiler.expressions import KEYWORDS, TAKEN, identifier
from pearl_marl.compiler.targets import Target
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware import boards, elaboration
from pearl_marl.hardware.build import Build
from pearl_marl.spec import EnvSpec, Field

OTHERS = """
    clk rst clk_i rst_ni state state_i state_o action action_i draw rng_i reward reward_o hold first valid_q
    state_t unused LATENCY II STATE_BITS sum sum_1 sum_12 sum_45 same_3 TABLE_0 TABLE_1 TABLE_2 word_7 word_q1
    wide_pe wide_pkg pearl pearl_pkg pearl_core_pkg pearl_top u_core v0 std root unit mod_1 ROW Row row row_
    row_q1 row_q2 soft_ soft__ parameter_ __x x__ a__DOT__b _ _1 LUT6 DSP48E1 TRELLIS_FF SB_DFF GND VCC
    int8_t uint64_t bool true false char double float short long unsigned_ template namespace operator private
    delete friend mutable volatile inline goto sizeof typename nullptr main errno stdin NULL EOF linux unix
    vlSelf vlSymsp TOP Vtop entity architecture signal process downto library_ specify_ wreal
""".split()  # noqa: SIM905
"""Names of ports and of cores' own; what tools, C++ and VHDL know; names that nearly agree."""

NAMES = sorted({*KEYWORDS, *OTHERS})


def test_keywords_are_all_that_there_are() -> None:
    known = {kind.removesuffix("Keyword").lower() for kind in dir(TokenKind) if kind.endswith("Keyword")}
    assert {word.replace("_", "") for word in KEYWORDS} == known - {"onestep"}  # no word of its own: 1step


def test_names_stay_apart() -> None:
    names = {name + "_" * k for name in NAMES for k in range(3)}
    made = {identifier(name) for name in names}
    assert len(made) == len(names)
    assert not made & KEYWORDS


def test_names_that_every_core_has_are_known() -> None:
    texts = verilog.TEMPLATE, verilog.CORE_PACKAGE, verilog.CORE_PORTS, verilog.ACT_PACKAGE, verilog.ACT_PORTS
    code = re.sub(r"//.*|\{\w+\}\w*", "", " ".join(texts))
    used = {name for name in re.findall(r"[A-Za-z]\w*", code) if identifier(name) == name}
    assert used <= TAKEN


def fields_named(names: list[str]) -> EnvSpec:
    """Return an environment with fields of these names, each of which moves to the next."""
    count = len(names)
    moved = ", ".join(f"state.w{k} ^ (action & 1)" for k in range(1, count))
    zeros = ", ".join("0" for _ in names)
    text = f"def step(state, action, draws): return State({moved}, state.w0), state.w1, state.w2 & 1\n"
    text += f"def initial(draws): return State({zeros})\ndef observe(state): return state.w0, state.w1\n"
    spec = spec_with(text, [Field(f"w{k}", 3) for k in range(count)], Field("reward", 3))
    return renamed(spec, names)


def variables_named(names: list[str]) -> EnvSpec:
    """Return an environment whose step has variables of these names."""
    names = [name for name in names if not keyword.iskeyword(name) and name not in ("np", "x")]
    lines, last = [], "action"
    for name in names:
        lines.append(f"    {name} = ((x >> 3) + {last} * 3) & 0xFFFF")
        lines.append(f"    x = (x ^ {name}) + FOUR[x & 3]")
        last = name
    text = "def step(state, action, draws):\n    x = state.x\n" + "\n".join(lines)
    text += f"\n    return State(x & 0xFFFF), {last} & 7, 0\n"
    text += "def initial(draws): return State(draws.bits(3))\ndef observe(state): return state.x, 1\n"
    return spec_with(text, [Field("x", 16)], Field("reward", 3))


@pytest.mark.parametrize("make", [fields_named, variables_named])
def test_any_name_works(make: Any, tmp_path: Path) -> None:
    for k in range(0, len(NAMES), 64):
        spec = make(NAMES[k : k + 64])
        path = tmp_path / f"wide_{k}_pe.sv"
        path.write_text(generated_core(spec, Target("xc7", 40.0), path.stem.removesuffix("_pe")).text)
        lint(path.stem, [path], off=("UNUSEDPARAM",))


def test_the_backbone_has_a_first_word_of_its_own() -> None:
    """So an environment of any name can stand in it: see :func:`core_name`."""
    folder = elaboration.backbone_paths()[0].parent
    texts = [path.read_text() for path in (*folder.rglob("*.sv"), folder / f"{elaboration.WRAPPER}.in")]
    declared = re.compile(r"^ *(?:module|package|interface|program)\s+(\w+)", re.MULTILINE)
    found = {name for text in texts for name in declared.findall(text)} | {Path(boards.SIZES).stem}
    assert len(found) > 30
    ours = {name for name in found if name.partition("_")[0] == BACKBONE}
    assert {name.isupper() for name in found - ours} <= {True}  # a vendor's


@pytest.mark.parametrize("name", ["Pearl", "PearlCore", "PearlMap", "PearlBuild", "PearlTop", "Env"])
def test_environments_named_like_the_backbone(name: str) -> None:
    spec = replace(spec_of("CliffWalking", {}), name=name)
    design = whole(Build.of(spec, 7, 4, 32))
    assert len({path.name for path in design.sources}) == len(design.sources)
    lint(design.top, design.sources, design.parameters)


def test_a_core_of_ones_own_named_like_the_backbone() -> None:
    spec = replace(spec_of("ShiftAdd", {}), name="PearlCore")
    with pytest.raises(ArgumentError, match=r"its own core would be the module pearl_core_pe, and names"):
        elaboration.sources(spec)


def test_every_operation_of_a_core_is_drawn() -> None:
    """Also a word that is kept together for a multiplier, as xc7's cores have them."""
    picture = generated_core(spec_of("Taxi", {}), Target("xc7", 150)).picture()
    assert "{ }" in picture


def test_remarks_are_one_line_of_ascii(tmp_path: Path) -> None:
    """An option's text may go over lines, as an array's does, and have any letters."""
    options = {"map": np.zeros((3, 30), int), "name": "\u00e9\nendmodule\u2028\\"}
    spec = replace(fields_named(["row", "column", "place"]), options=options)
    text = generated_core(spec, Target("xc7", 40.0)).text
    assert text.isascii()
    path = tmp_path / "wide_pe.sv"
    path.write_text(text)
    lint(path.stem, [path], off=["UNUSEDPARAM"])
    assert core_name(spec) == "wide"
