"""Proofs of the policy engine by induction; and of each, that it refutes broken designs."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_proofs import FORMAL, Fault, check

from pearl_marl.hardware import elaboration

# Yosys is WebAssembly, which takes a minute to compile before it first runs.
pytestmark = pytest.mark.exhaustive

LANE = ("pearl_pkg", "pearl_delay", "pearl_memory", "pearl_ram", "pearl_sum", "pearl_lane")
READER = ("pearl_pkg", "pearl_rollout_reader")


def prove(folder: Path, top: str, names: tuple[str, ...], sizes: dict[str, int], fault: Fault | None) -> str:
    files = [path for path in elaboration.backbone_paths() if path.stem in names]
    arguments = [f"-G {name}={value}" for name, value in sizes.items()]
    return check(folder, top, [*files, FORMAL / f"{top}.sv"], arguments, fault, depths=(12, 20))


@pytest.mark.parametrize("products", [3, 4])
def test_a_lane_adds_up_all_products(products: int, tmp_path: Path) -> None:
    report = prove(tmp_path, "lane_proof", LANE, {"PRODUCTS": products}, None)
    assert "DONE (PASS" in report, report


READERS = {
    "network": {"GROUPS": 5, "CREDITS": 2},
    "slow": {"GROUPS": 5, "CREDITS": 3, "II": 2, "OBSERVE_II": 3},
    "alone": {"GROUPS": 1, "CREDITS": 4},
}


@pytest.mark.parametrize("name", READERS)
def test_a_rollout_steps_each_group_once_and_in_order(name: str, tmp_path: Path) -> None:
    report = prove(tmp_path, "rollout_reader_proof", READER, READERS[name], None)
    assert "DONE (PASS" in report, report


LANE_FAULTS = {
    "bias lost": ("pearl_lane.sv", "first_i ? bias_i : sum_q", "first_i ? '0 : sum_q"),
    "unsigned": ("pearl_lane.sv", "PRODUCT_BITS'($signed(values_i[i]))", "PRODUCT_BITS'(values_i[i])"),
    "odd term lost": ("pearl_sum.sv", "(BITS + 1)'($signed(terms[INPUTS-1]))", "'0"),
    "not cut": ("pearl_lane.sv", "shifted_q > limit", "1'b0"),
}
READER_FAULTS = {
    "too many": ("pearl_rollout_reader.sv", "&& credits_q != '0", ""),
    "again": ("pearl_rollout_reader.sv", "active_q       <= !last_o", "active_q       <= 1'b1"),
    "slot": ("pearl_rollout_reader.sv", "slots_q[observe_o] + 32'(PE_NUM)", "slots_q[observe_o] + 32'd1"),
}


@pytest.mark.parametrize("fault", LANE_FAULTS)
def test_a_broken_lane_is_refuted(fault: str, tmp_path: Path) -> None:
    report = prove(tmp_path, "lane_proof", LANE, {}, LANE_FAULTS[fault])
    assert "DONE (FAIL" in report, report


@pytest.mark.parametrize("fault", READER_FAULTS)
def test_a_broken_rollout_is_refuted(fault: str, tmp_path: Path) -> None:
    report = prove(tmp_path, "rollout_reader_proof", READER, READERS["network"], READER_FAULTS[fault])
    assert "DONE (FAIL" in report, report
