"""Table II of the paper that the method is from: the words and the build of each of its environments.

The paper is *PEARL: FPGA-Based Reinforcement Learning Acceleration with Pipelined Parallel Environments*.
Its other figures are quoted by ``experiments/paper.py``; these are also what our own words are held against.
"""

from __future__ import annotations

from typing import NamedTuple


class PaperColumn(NamedTuple):
    """A column of the table: widths in bits, processing elements, and ``c_c`` in ns."""

    state: int
    action: int
    observation: int
    reward: int
    data_wl: int
    pe_num: int
    compute_ns: int

    @property
    def widths(self) -> tuple[int, int, int, int]:
        """Bits of state, action, observation and reward."""
        return self.state, self.action, self.observation, self.reward


TABLE_2 = {
    "CliffWalking": PaperColumn(8, 2, 8, 1, 1024, 256, 20),
    "Blackjack": PaperColumn(152, 1, 16, 2, 512, 256, 80),
    "CartPole": PaperColumn(128, 1, 128, 1, 32, 20, 800),
    "Pendulum": PaperColumn(64, 32, 96, 32, 32, 24, 960),
    "Seaquest": PaperColumn(736, 3, 512, 32, 1024, 16, 80),
}
TABLE_2_SOURCE = "the paper, Table II"
