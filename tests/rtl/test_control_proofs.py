"""Proofs of what the host may do during a step; and of each property, that a fault refutes it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from test_proofs import FORMAL, Fault, check

from pearl_marl.hardware import elaboration

NAMES = ("pearl_pkg", "pearl_delay", "pearl_port", "pearl_registers", "pearl_sequencer")
CONTROL = [path for path in elaboration.backbone_paths() if path.stem in NAMES]
# Yosys is WebAssembly, which takes a minute to compile before it first runs.
pytestmark = pytest.mark.exhaustive

# Of induction, and within how many cycles a fault has to show.
DEPTHS = (6, 20)


def check_control(folder: Path, word: int, fault: Fault | None) -> str:
    files = [*CONTROL, FORMAL / "control_proof.sv"]
    return check(folder, "control_proof", files, [f"-G DATA_WL={word}"], fault, depths=DEPTHS)


# In the wider one, the word that resets also holds the tick.
@pytest.mark.parametrize("word", [32, 256])
def test_a_step_is_left_alone_and_a_reset_is_heard(word: int, tmp_path: Path) -> None:
    report = check_control(tmp_path, word, None)
    assert "DONE (PASS" in report, report


FAULTS = {
    "torn": (32, "pearl_registers.sv", "error_q.torn_read <= 1'b1;", "error_q.torn_read <= 1'b0;"),
    "spanned": (256, "pearl_port.sv", "we = busy || outdated_q ?", "we = busy ?"),
    "written": (32, "pearl_port.sv", "we = busy || outdated_q ?", "we = outdated_q ?"),
    "used": (32, "pearl_port.sv", "re = busy ? hit_q & SHARED : hit_q", "re = hit_q"),
    "reset": (32, "pearl_port.sv", "soft_reset_q    <= req", "soft_reset_q    <= |we"),
    "told": (32, "pearl_registers.sv", "'{reset: 1'b1, default: 1'b0}", "'{default: 1'b0}"),
}
"""By the property that they violate."""


@pytest.mark.parametrize("violated", FAULTS)
def test_broken_control_is_refuted(violated: str, tmp_path: Path) -> None:
    word, *fault = FAULTS[violated]
    report = check_control(tmp_path, word, (fault[0], fault[1], fault[2]))
    assert "DONE (FAIL" in report, report
    assert re.search(rf"Assert failed in control_proof: .*\b{violated}\b", report), report
