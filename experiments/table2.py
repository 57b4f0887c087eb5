"""Table II: widths, word and processing elements of every environment, beside the paper's."""

from __future__ import annotations

from typing import Any

from pearl_marl.benchmark.paper import TABLE_2, TABLE_2_SOURCE
from pearl_marl.hardware import elaboration
from pearl_marl.memory_map import default_map
from pearl_marl.registry import get_spec, names
from pearl_marl.spec import word_bits

from .section import Progress, Row

TITLE = "Table II: environment parameters"
TEXT = (
    "Bits of state, action, observation and reward, bits of a word, and processing elements: of this "
    "package by default with 43,008 slots, and of the paper. Rewards are categories here, looked up on the "
    "host."
)
COLUMNS = {
    "environment": "environment",
    "state_bits": "STA_WL",
    "action_bits": "ACT_WL",
    "observation_bits": "OBS_WL",
    "reward_bits": "RWD_WL",
    "data_wl": "DATA_WL",
    "pe_num": "pe_num",
    "compute_cycles": "c_c, cycles",
    "compute_ns": "c_c, ns",
    "counts": "what is counted, or from where",
}
SEEDS = (0,)

N_ENVS = 43008


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Read every environment's spec; there is no smaller part of it."""
    rows: list[Row] = []
    for name in names():
        spec = get_spec(name)
        layout = default_map(spec, N_ENVS)
        rows.append(
            {
                "kind": "measured",
                "environment": name,
                "state_bits": word_bits(spec.state),
                "action_bits": spec.action.bits,
                "observation_bits": word_bits(spec.observation),
                "reward_bits": spec.reward.bits,
                "data_wl": layout.data_wl,
                "pe_num": layout.pe_num,
                "compute_cycles": elaboration.core_timing(spec).latency,
                "counts": f"counted: the design of {N_ENVS:,} slots",
            }
        )
        column = TABLE_2.get(name)
        if column is not None:
            rows.append(
                {
                    "kind": "quoted",
                    "environment": name,
                    "state_bits": column.state,
                    "action_bits": column.action,
                    "observation_bits": column.observation,
                    "reward_bits": column.reward,
                    "data_wl": column.data_wl,
                    "pe_num": column.pe_num,
                    "compute_ns": column.compute_ns,
                    "counts": TABLE_2_SOURCE,
                }
            )
    return rows


def draw(rows: list[Row]) -> Any:
    """Return nothing: it is a table."""
    return None
