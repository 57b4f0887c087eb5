"""pearl_patches against the arithmetic of Patches."""

from __future__ import annotations

from typing import Any

import numpy as np
from bench import each_variant, start
from bench_network import check_values, packed, write_policy

from pearl_marl.envs import get_spec
from pearl_marl.hardware.policy_words import filter_words
from pearl_marl.memory_map import Engine, Section
from pearl_marl.policies.integer_network import Patches

VALUE_BITS, WEIGHT_BITS = 12, 8


@each_variant()
async def inputs_equal_the_filters(dut: Any, given: Any) -> None:
    await start(dut, we_i=0, index_i=0, wdata_i=0, valid_i=0, last_i=0, elements_i=0)
    random = np.random.default_rng(23)
    shape = height, width, planes = given.height, given.width, given.planes
    engine = Engine("planes", products=given.products, filters=given.filters, weight_bits=WEIGHT_BITS)
    words = -(-given.filters // given.products)
    chunks = (height - 2) * (width - 2) * words
    # Fewer filters than there is room for, too: those that are missing are 0.
    for count, shift, limit in ((given.filters, 2, 100), (given.filters, 0, 2047), (1, 31, 1)):
        weights = random.integers(-128, 128, (count, 3, 3, planes)).astype(np.int16)
        bias = random.integers(-(1 << 10), 1 << 10, count).astype(np.int32)
        bias[0] = (1 << 31) - (1 << 20)
        # Only what a picture may have is asked of the environment.
        filters = filter_words(get_spec("Breakout"), Patches(shape, weights, bias, shift, limit), engine)
        await write_policy(dut, {Section.SETTINGS: [0, 0, limit, shift], Section.SCALINGS: filters})
        wanted: list[tuple[list[int], int]] = []
        sent, wait, groups = 0, 0, 12
        while sent < groups or wanted:
            valid = sent < groups and wait == 0 and random.random() < 0.8
            dut.valid_i.value = int(valid)
            if valid:
                pictures = random.integers(0, 2, (given.rows, *shape))
                dut.elements_i.value = packed(pictures, 1)
                last = int(random.integers(2))
                dut.last_i.value = last
                inputs = np.zeros((chunks // words, words * given.products, given.rows), np.int64)
                for patch, (y, x) in enumerate(np.ndindex(height - 2, width - 2)):
                    there = pictures[:, y : y + 3, x : x + 3]
                    sums = np.einsum("fabc,rabc->fr", weights.astype(np.int64), there) + bias[:, None]
                    inputs[patch, :count] = (sums >> shift).clip(0, limit)
                by_chunk = inputs.reshape(chunks, given.products, given.rows).swapaxes(1, 2)
                wanted += [(part.ravel().tolist(), last) for part in by_chunk]
                sent, wait = sent + 1, chunks
            wait = max(0, wait - 1)
            await check_values(dut, wanted, VALUE_BITS)
