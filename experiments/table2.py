"""Table II: widths, word and processing elements of every environment, beside the paper's."""

from __future__ import annotations

from pearl_marl.benchmark.paper import TABLE_2, TABLE_2_SOURCE
from pearl_marl.envs import get_spec, names
from pearl_marl.hardware import elaboration
from pearl_marl.memory_map import default_map
from pearl_marl.spec import word_bits

from .section import QUICK_ENVS, Progress, Row, row_of

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

N_ENVS = 43008
WIDTHS = ("state_bits", "action_bits", "observation_bits", "reward_bits")


def collect(quick: bool, progress: Progress) -> list[Row]:
    """Read every environment's spec; with ``quick`` a few."""
    rows: list[Row] = []
    for name in QUICK_ENVS if quick else names():
        spec = get_spec(name)
        layout = default_map(spec, N_ENVS)
        words = spec.state, spec.action_fields, spec.observation, (spec.reward,)
        bits = [word_bits(fields) for fields in words]
        rows.append(
            row_of(
                "measured",
                f"counted: the design of {N_ENVS:,} slots",
                environment=name,
                **dict(zip(WIDTHS, bits, strict=True)),
                data_wl=layout.data_wl,
                pe_num=layout.pe_num,
                compute_cycles=elaboration.core_timing(spec).latency,
            )
        )
        if (column := TABLE_2.get(name)) is not None:
            rows.append(
                row_of(
                    "quoted",
                    TABLE_2_SOURCE,
                    environment=name,
                    **dict(zip(WIDTHS, column.widths, strict=True)),
                    data_wl=column.data_wl,
                    pe_num=column.pe_num,
                    compute_ns=column.compute_ns,
                )
            )
    return rows
