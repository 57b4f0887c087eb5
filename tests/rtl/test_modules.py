"""Each module alone, over the product of its parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from bench import spec_of
from harness import core, module, run

from pearl_marl.hardware import elaboration

# Row and word: equal, dividing either way, sharing a factor, sharing none; wider and narrower rows.
RATIOS = [(32, 32), (8, 32), (96, 32), (64, 128), (48, 32), (24, 32), (42, 32), (7, 32), (99, 64), (1, 32)]
ROWS_RATIOS = [(13, row, word) for row, word in RATIOS] + [(1, 7, 32), (1, 96, 32)]


@pytest.mark.parametrize("draws", [1, 3])
def test_keys(draws: int, tmp_path: Path) -> None:
    run(module("pearl_rng", DRAWS=draws), "bench_rng", tmp_path, draws=draws)


@pytest.mark.parametrize(("pe_num", "draws"), [(1, 1), (3, 2)])
def test_draws(pe_num: int, draws: int, tmp_path: Path) -> None:
    design = module("pearl_draw_row", PE_NUM=pe_num, DRAWS=draws)
    run(design, "bench_draw_row", tmp_path, pe_num=pe_num, draws=draws)


@pytest.mark.parametrize("top", ["pearl_packer", "pearl_unpacker"])
@pytest.mark.parametrize(("rows", "row", "word"), ROWS_RATIOS)
def test_packing(top: str, rows: int, row: int, word: int, tmp_path: Path) -> None:
    # A last row that is all padding but for its first bit is the shortest stream of so many rows.
    words = -(-((rows - 1) * row + 1) // word)
    design = module(top, ROW_BITS=row, DATA_WL=word, WORDS=words)
    run(design, top.replace("pearl", "bench"), tmp_path, row=row, word=word, rows=rows, words=words)


@pytest.mark.parametrize(("rows", "row", "word"), [(1, 6, 32), (5, 32, 32), (4, 72, 32), (3, 160, 64)])
def test_row_memory(rows: int, row: int, word: int, tmp_path: Path) -> None:
    design = module("pearl_row_memory", ROWS=rows, ROW_BITS=row, DATA_WL=word)
    run(design, "bench_row_memory", tmp_path, rows=rows, row=row, word=word)


@pytest.mark.parametrize(("shift", "addend"), [(1, 0), (30, 0), (30, -(1 << 31)), (32, 86699678), (62, 0)])
def test_fixed_multiply(shift: int, addend: int, tmp_path: Path) -> None:
    parameters = {"SHIFT": shift, "ADDEND": addend}
    design = module("pearl_fixed_multiply", **parameters)
    run(design, "bench_fixed", tmp_path, top=design.top, latency=3, **parameters)


@pytest.mark.parametrize(("top", "latency"), [("pearl_sine_cosine", 17), ("pearl_reciprocal", 19)])
def test_fixed_point(top: str, latency: int, tmp_path: Path) -> None:
    run(module(top), "bench_fixed", tmp_path, top=top, latency=latency)


@pytest.mark.parametrize("depth", [2, 8])
def test_fifo(depth: int, tmp_path: Path) -> None:
    run(module("pearl_fifo", DEPTH=depth), "bench_fifo", tmp_path, depth=depth)


def test_axi_address(tmp_path: Path) -> None:
    run(module("pearl_axi_address"), "bench_axi_address", tmp_path)


@pytest.mark.parametrize("word", [32, 256, 1024])
def test_axi_slave(word: int, tmp_path: Path) -> None:
    design = module("axi_memory", DATA_WL=word, ADDR_BITS=14)
    run(design, "bench_axi_slave", tmp_path, word=word)


# The narrow address is that of a small map, the wide one that of a bus of 64 bits.
@pytest.mark.parametrize(("word", "words", "bits"), [(32, 3, 8), (128, 1, 60)])
def test_port(word: int, words: int, bits: int, tmp_path: Path) -> None:
    design = module("port_map", DATA_WL=word, REGION_WORDS=words, WORD_ADDR_BITS=bits)
    run(design, "bench_port", tmp_path, word=word, words=words, address_bits=bits)


@pytest.mark.parametrize("word", [32, 64, 128, 1024])
def test_registers(word: int, tmp_path: Path) -> None:
    design = module("pearl_registers", DATA_WL=word, ENV_HASH=0x1234)
    run(design, "bench_registers", tmp_path, word=word)


def test_sequencer(tmp_path: Path) -> None:
    run(module("pearl_sequencer"), "bench_sequencer", tmp_path)


@pytest.mark.parametrize(
    ("groups", "pe_num", "word", "ii", "obs", "reward"),
    [
        (10, 4, 32, 1, 6, 1),  # the core is the limit
        (10, 16, 32, 1, 6, 1),  # the observations' packer is
        (7, 8, 32, 1, 3, 13),  # the rewards' is
        (9, 4, 64, 4, 13, 5),  # a core that takes four cycles
        (1, 1, 1024, 1, 6, 1),
    ],
)
def test_group_reader(
    groups: int, pe_num: int, word: int, ii: int, obs: int, reward: int, tmp_path: Path
) -> None:
    design = module(
        "pearl_group_reader",
        GROUPS=groups,
        PE_NUM=pe_num,
        DATA_WL=word,
        II=ii,
        OBS_BITS=obs,
        REWARD_BITS=reward,
    )
    sizes = {"groups": groups, "pe_num": pe_num, "word": word, "ii": ii, "obs": obs, "reward": reward}
    run(design, "bench_group_reader", tmp_path, **sizes)


LAKE = {"desc": ["SFHSFGSF", "GHSFFFFH", "FSHFHSFF"]}


@pytest.mark.parametrize(
    ("env", "options", "latency", "ii"),
    [
        ("CliffWalking", {"is_slippery": False}, 2, 1),
        ("CliffWalking", {"is_slippery": True}, 2, 1),
        ("FrozenLake", {}, 3, 1),
        ("FrozenLake", {"map_name": "8x8", "success_rate": 0.8}, 3, 1),
        ("FrozenLake", {**LAKE, "is_slippery": False}, 3, 1),
        ("FrozenLake", {**LAKE, "success_rate": 0}, 3, 1),
        ("CartPole", {}, 56, 1),
        ("CartPole", {"sutton_barto_reward": True}, 56, 1),
        ("Pendulum", {}, 43, 1),
        ("Pendulum", {"g": -3.7}, 43, 1),
        ("MountainCar", {}, 29, 1),
        ("MountainCar", {"goal_velocity": 0.01}, 29, 1),
        ("Seaquest", {}, 9, 1),
        ("Seaquest", {"sticky_action_prob": 0.9, "difficulty_ramping": False}, 9, 1),
        ("Taxi", {}, 5, 1),
        ("Taxi", {"fickle_passenger": True, "fickle_probability": 0.5}, 5, 1),
        ("Taxi", {"fickle_passenger": True, "is_rainy": True}, 5, 1),
        ("Blackjack", {}, 17, 1),
        ("Blackjack", {"sab": False, "natural": True}, 17, 1),
        ("ShiftAdd", {}, 4, 4),
    ],
)
def test_core(env: str, options: dict[str, Any], latency: int, ii: int, tmp_path: Path) -> None:
    spec = spec_of(env, options)
    assert elaboration.core_timing(spec) == (latency, ii)
    run(
        core(spec),
        "bench_core",
        tmp_path,
        env=env,
        options=options,
        latency=latency,
        ii=ii,
        limit=25_000,
    )
