"""The activity figure: what counts as a register's change."""

from __future__ import annotations

import importlib
from pathlib import Path

from pearl_marl import get_spec
from pearl_marl.latency import axi_cycles
from pearl_marl.memory_map import memory_map

activity = importlib.import_module("pearl_marl.experiments.activity")

WAVES = """$version by hand $end
$timescale 1ps $end
 $scope module TOP $end
  $var wire 1 ! clk_i $end
  $scope module u_core $end
   $var wire 4 a count_q [3:0] $end
   $var wire 2 b row_q12 [1:0] $end
   $var wire 2 c obs_o [1:0] $end
  $upscope $end
  $var wire 1 d last_q $end
  $var wire 8 e mem[0] [7:0] $end
  $var wire 2 f row_q2_2 [1:0] $end
 $upscope $end
$enddefinitions $end
#0
b0011 a
b11 b
1d
#20
1!
b0101 a
0d
#25
0!
#30
1!
b1010 a
b00 b
b11 c
b11111111 e
b11 f
1d
"""


def test_what_is_counted(tmp_path: Path) -> None:
    """Registers by their names, changes after the given time."""
    (tmp_path / "waves.vcd").write_text(WAVES)
    assert activity._count(tmp_path / "waves.vcd", 20) == (9, 4 + 2 + 2 + 1)
    assert activity._count(tmp_path / "waves.vcd", 0) == (9, 4 + 2 + 2 + 1 + 2 + 1)


def test_a_small_build() -> None:
    found, spec = activity.measure("CliffWalking", 7, 4, 32), get_spec("CliffWalking")
    assert found.cycles == axi_cycles(spec, memory_map(spec, 7, 4, 32))
    # A register of a pipeline changes every few cycles at most, and some never do.
    assert 0.01 < found.toggles / found.cycles / found.registers < 0.2
    assert found.toggles_per_slot == found.toggles / 7
    assert found == activity.measure("CliffWalking", 7, 4, 32), "the same every time"
