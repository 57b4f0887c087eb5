"""The modules of fixed-point arithmetic against pearl_marl/fixed_point.py, an input every cycle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from bench import each_variant, start
from cocotb.triggers import FallingEdge

from pearl_marl import fixed_point
from pearl_marl.golden import call_reference, i32

Words = np.ndarray[Any, np.dtype[np.uint32]]


def corners() -> Words:
    """Random words, every power of two, and what is next to it and its negative."""
    powers = 1 << np.arange(33, dtype=np.int64)
    edges = [sign * powers + near for sign in (1, -1) for near in (-1, 0, 1)]
    random = np.random.default_rng(7).integers(0, 1 << 32, 3000)
    return np.concatenate([*edges, random]).astype(np.uint32)


def multiply(given: Any) -> tuple[dict[str, Words], dict[str, Any]]:
    words = corners()
    generator = np.random.default_rng(8)
    a = np.concatenate([words, words])
    b = np.concatenate([words[::-1], generator.permutation(words)])
    product = fixed_point.multiply(a.view(np.int32), b.view(np.int32), given.shift)
    return {"a_i": a, "b_i": b}, {"product_o": i32(product + i32(given.addend))}


def sine_cosine(given: Any) -> tuple[dict[str, Words], dict[str, Any]]:
    words = corners()
    sine, cosine = fixed_point.sine_cosine(words)
    return {"turns_i": words}, {"sine_o": sine, "cosine_o": cosine}


def reciprocal(given: Any) -> tuple[dict[str, Words], dict[str, Any]]:
    # Beyond 1 to 2 it is no reciprocal, but the same words all the same.
    inside = np.random.default_rng(9).integers(1 << 30, 1 << 31, 3000).astype(np.uint32)
    words = np.concatenate([corners(), inside])
    return {"x_i": words}, {"reciprocal_o": fixed_point.reciprocal(words.view(np.int32))}


CASES: dict[str, Callable[[Any], tuple[dict[str, Words], dict[str, Any]]]] = {
    "pearl_fixed_multiply": multiply,
    "pearl_sine_cosine": sine_cosine,
    "pearl_reciprocal": reciprocal,
}


@each_variant()
async def every_word_equals_the_function(dut: Any, given: Any) -> None:
    inputs, expected = call_reference(CASES[given.top], (given,))
    count = len(next(iter(inputs.values())))
    await start(dut, **dict.fromkeys(inputs, 0))
    await FallingEdge(dut.clk_i)
    for cycle in range(count + given.latency):
        if cycle >= given.latency:
            case = cycle - given.latency
            for port, words in expected.items():
                found = getattr(dut, port).value.to_signed()
                words_in = {name: int(word[case]) for name, word in inputs.items()}
                assert found == words[case], f"{port} of {words_in}: {found}, not {words[case]}"
        if cycle < count:
            for port, words in inputs.items():
                getattr(dut, port).value = int(words[cycle])
        await FallingEdge(dut.clk_i)
