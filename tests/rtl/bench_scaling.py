"""pearl_scaling against the arithmetic of Scaling."""

from __future__ import annotations

from typing import Any

import numpy as np
from bench import each_variant, start
from bench_network import check_values, packed, write_policy

from pearl_marl.hardware.policy_words import scaling_words
from pearl_marl.memory_map import Section
from pearl_marl.policies.integer_network import Scaling

VALUE_BITS = 12


@each_variant()
async def inputs_equal_the_scaling(dut: Any, given: Any) -> None:
    await start(dut, we_i=0, index_i=0, wdata_i=0, valid_i=0, last_i=0, elements_i=0)
    random = np.random.default_rng(22)
    chunks = -(-given.elements // given.products)
    for limit in (1280, 1, 2047):
        size = 1 << min(given.bits, 32) - 1
        offset = random.integers(-size, size, given.elements)
        multiplier = random.integers(0, 1 << 16, given.elements)
        shift = random.integers(0, given.bits + 17, given.elements)
        scalings = scaling_words(Scaling(offset, multiplier, shift, limit), given.products)
        await write_policy(dut, {Section.SETTINGS: [0, 0, limit], Section.SCALINGS: scalings})
        wanted: list[tuple[list[int], int]] = []
        sent, wait, groups = 0, 0, 30
        while sent < groups or wanted:
            valid = sent < groups and wait == 0 and random.random() < 0.8
            dut.valid_i.value = int(valid)
            if valid:
                edge = 1 << given.bits - 1
                elements = random.integers(-edge, edge, (given.rows, given.elements))
                dut.elements_i.value = packed(elements, given.bits)
                last = int(random.integers(2))
                dut.last_i.value = last
                inputs = ((elements - offset) * multiplier >> shift).clip(-limit, limit)
                padded = np.zeros((given.rows, chunks * given.products), np.int64)
                padded[:, : given.elements] = inputs
                for chunk in range(chunks):
                    part = padded[:, chunk * given.products : (chunk + 1) * given.products]
                    wanted.append((part.ravel().tolist(), last))
                sent, wait = sent + 1, chunks
            wait = max(0, wait - 1)
            await check_values(dut, wanted, VALUE_BITS)
