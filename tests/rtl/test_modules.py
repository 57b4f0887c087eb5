"""Each module alone, over the product of its parameters.

The variants of a module are one build and one simulation, which the first test of them starts. Each is a test
of its own all the same: if one fails, even by an assertion that ends the simulation, the others are tried.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from harness import Variant, checked, module, run_variants

from tests import sampling

# Row and word: equal, dividing either way, sharing a factor, sharing none; wider and narrower rows.
RATIOS = [(32, 32), (8, 32), (96, 32), (64, 128), (48, 32), (24, 32), (42, 32), (7, 32), (99, 64), (1, 32)]
ROWS_RATIOS = [(13, row, word) for row, word in RATIOS] + [(1, 7, 32), (1, 96, 32)]


def variant(top: str, parameters: Mapping[str, int], /, **arguments: Any) -> Variant:
    """One with these parameters, of which the bench is told what is among ``arguments``."""
    name = "-".join(map(str, (top.removeprefix("pearl_"), *parameters.values())))
    return Variant(name, module(top, **parameters), arguments)


def packing(top: str, rows: int, row: int, word: int) -> Variant:
    # A last row that is all padding but for its first bit is the shortest stream of so many rows.
    words = -(-((rows - 1) * row + 1) // word)
    parameters = {"ROW_BITS": row, "DATA_WL": word, "WORDS": words}
    return variant(top, parameters, row=row, word=word, rows=rows, words=words)


def axi_memory(word: int) -> Variant:
    plain = variant("axi_memory", {"DATA_WL": word, "ADDR_BITS": 14}, word=word)
    return dataclasses.replace(plain, design=checked(plain.design))


def group_reader(groups: int, pe_num: int, word: int, ii: int, obs: int, reward: int) -> Variant:
    parameters = {
        "GROUPS": groups,
        "PE_NUM": pe_num,
        "DATA_WL": word,
        "II": ii,
        "OBS_BITS": obs,
        "REWARD_BITS": reward,
    }
    sizes = {"groups": groups, "pe_num": pe_num, "word": word, "ii": ii, "obs": obs, "reward": reward}
    return variant("pearl_group_reader", parameters, **sizes)


def network(
    group: int,
    side: int,
    rounds: int,
    inputs: int,
    hidden: tuple[int, ...],
    products: int,
    weight: int,
    value: int,
) -> Variant:
    shape = {"products": products, "side": side, "rounds": rounds, "weight_bits": weight, "value_bits": value}
    parameters = {name.upper(): number for name, number in shape.items()}
    parameters |= {
        "GROUP": group,
        "INPUTS": inputs,
        "HIDDEN": max(hidden, default=1),
        "LAYERS": len(hidden) + 1,
    }
    engine = {**shape, "hidden": max(hidden, default=1), "layers": len(hidden) + 1}
    return variant("pearl_network", parameters, group=group, inputs=inputs, sizes=hidden, engine=engine)


MODULES = {
    "rng": [variant("pearl_rng", {"DRAWS": draws}, draws=draws) for draws in (1, 3)],
    "draw_row": [
        variant("pearl_draw_row", {"PE_NUM": pe_num, "DRAWS": draws}, pe_num=pe_num, draws=draws)
        for pe_num, draws in ((1, 1), (3, 2))
    ],
    "packer": [packing("pearl_packer", *sizes) for sizes in ROWS_RATIOS],
    "input_bank": [packing("pearl_input_bank", *sizes) for sizes in ROWS_RATIOS],
    "row_memory": [
        variant(
            "pearl_row_memory",
            {"ROWS": rows, "ROW_BITS": row, "DATA_WL": word},
            rows=rows,
            row=row,
            word=word,
        )
        for rows, row, word in (
            (1, 6, 32),
            (5, 32, 32),
            (4, 72, 32),
            (3, 160, 64),
            # Deep ones: in slices, and in a part of slices and a rest; in two parts and a rest.
            (2048, 40, 32),
            (3075, 40, 32),
        )
    ],
    "fifo": [variant("pearl_fifo", {"DEPTH": depth}, depth=depth) for depth in (2, 8)],
    "axi_address": [variant("pearl_axi_address", {})],
    "axi_slave": [axi_memory(word) for word in (32, 256, 1024)],
    # The narrow address is that of a small map, the wide one that of a bus of 64 bits.
    "port": [
        variant(
            "port_map",
            {"DATA_WL": word, "REGION_WORDS": words, "WORD_ADDR_BITS": bits},
            word=word,
            words=words,
            address_bits=bits,
        )
        for word, words, bits in ((32, 16, 10), (128, 4, 60))
    ],
    "registers": [
        variant(
            "pearl_registers",
            {"DATA_WL": word, "ENV_HASH": 0x1234, "ENGINE": engine},
            word=word,
            engine=engine,
        )
        for word, engine in ((32, 0), (32, 2), (64, 0), (128, 1), (1024, 0))
    ],
    "sequencer": [variant("pearl_sequencer", {})],
    "group_reader": [
        group_reader(10, 4, 32, 1, 6, 1),  # the core is the limit
        group_reader(10, 16, 32, 1, 6, 1),  # the observations' packer is
        group_reader(7, 8, 32, 1, 3, 13),  # the rewards' is
        group_reader(9, 4, 64, 4, 13, 5),  # a core that takes four cycles
        group_reader(1, 1, 1024, 1, 6, 1),
    ],
    "network": [
        network(*sizes)
        for sizes in (
            (2, 2, 2, 4, (8, 6), 4, 8, 12),
            # Less inputs than products, a batch of one round; no hidden layer; words of weights of 48 bits.
            (1, 3, 1, 3, (5,), 8, 6, 9),
            (3, 1, 3, 7, (), 2, 16, 12),
            (1, 2, 2, 5, (4, 9, 3), 3, 16, 10),
        )
    ],
    "scaling": [
        variant(
            "pearl_scaling",
            {"ROWS": rows, "ELEMENTS": elements, "ELEMENT_BITS": bits, "PRODUCTS": products},
            rows=rows,
            elements=elements,
            bits=bits,
            products=products,
        )
        for rows, elements, bits, products in ((2, 4, 32, 4), (1, 7, 6, 3), (3, 2, 33, 8))
    ],
    "patches": [
        variant(
            "pearl_patches",
            {
                "ROWS": rows,
                "HEIGHT": height,
                "WIDTH": width,
                "PLANES": planes,
                "FILTERS": filters,
                "PRODUCTS": products,
            },
            rows=rows,
            height=height,
            width=width,
            planes=planes,
            filters=filters,
            products=products,
        )
        for rows, height, width, planes, filters, products in (
            (2, 4, 5, 2, 4, 2),
            # Filters that do not fill their words; one patch of one plane.
            (1, 5, 3, 3, 5, 3),
            (1, 3, 3, 1, 2, 4),
            (3, 6, 7, 4, 6, 2),
        )
    ],
    "choice": [
        variant(
            "pearl_choice",
            {"ROWS": rows, "ACTIONS": actions, "LOGIT_BITS": bits, "DRAWN": drawn},
            rows=rows,
            actions=actions,
            bits=bits,
            drawn=drawn,
        )
        for rows, actions, bits, drawn in ((2, 4, 32, 1), (1, 2, 6, 1), (3, 6, 32, 0), (1, 6, 16, 1))
    ],
}
"""By the bench that tests them."""

if not sampling.exhaustive:  # the others are the same at more sizes
    MODULES = {name: variants[:2] for name, variants in MODULES.items()}


@pytest.mark.parametrize(
    ("name", "number"),
    [(name, number) for name, variants in MODULES.items() for number in range(len(variants))],
    ids=[f"{name}-{variant.name}" for name, variants in MODULES.items() for variant in variants],
)
def test_module(name: str, number: int, once: Any) -> None:
    def simulate(folder: Path) -> None:
        logs = run_variants(MODULES[name], f"bench_{name}", folder)
        (folder / "logs.json").write_text(json.dumps(logs))

    log = json.loads((once(f"rtl-{name}", simulate) / "logs.json").read_text())[number]
    assert not log, log
