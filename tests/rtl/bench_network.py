"""pearl_network against IntegerNetwork.sums, in batches that are full and others, as fast as it says."""

from __future__ import annotations

from typing import Any

import numpy as np
from bench import each_variant, start
from cocotb.triggers import FallingEdge, ReadOnly
from random_policies import random_layers

from pearl_marl.envs import get_spec
from pearl_marl.hardware.policy_words import policy_words
from pearl_marl.latency.rollouts import batch_cycles
from pearl_marl.memory_map import Engine, Section
from pearl_marl.policies.integer_network import Head, IntegerNetwork, Scaling


def packed(values: Any, bits: int) -> int:
    """Numbers side by side, the first lowest."""
    mask = (1 << bits) - 1
    return sum((int(value) & mask) << (bits * k) for k, value in enumerate(np.ravel(values)))


def unpacked(word: int, bits: int, count: int) -> list[int]:
    """The inverse, of numbers with a sign."""
    found = [word >> (bits * k) & (1 << bits) - 1 for k in range(count)]
    return [value - (1 << bits) if value >> (bits - 1) else value for value in found]


async def check_values(dut: Any, due: list[tuple[list[int], int]], bits: int) -> None:
    """Go on by a cycle; values that are valid in it are the first that are due, with its ``last``."""
    await ReadOnly()
    if dut.valid_o.value == 1:
        numbers, last = due.pop(0)
        assert unpacked(int(dut.values_o.value), bits, len(numbers)) == numbers
        assert dut.last_o.value == last
    await FallingEdge(dut.clk_i)


async def write_policy(dut: Any, words: Any) -> None:
    """Write the sections of a policy, a number a cycle."""
    await FallingEdge(dut.clk_i)
    for section, numbers in words.items():
        dut.we_i.value = 1 << section
        for index, number in enumerate(numbers):
            dut.index_i.value, dut.wdata_i.value = index, int(number)
            await FallingEdge(dut.clk_i)
    dut.we_i.value = 0


@each_variant()
async def logits_equal_the_network(dut: Any, given: Any) -> None:
    await start(dut, we_i=0, index_i=0, wdata_i=0, valid_i=0, last_i=0, values_i=0)
    random = np.random.default_rng(21)
    engine = Engine("network", **given.engine)
    spec, limit, outputs = get_spec("CartPole"), (1 << engine.value_bits - 1) - 1, 2
    chunks, batch = -(-given.inputs // engine.products), engine.side * engine.rounds
    for _ in range(3):
        sizes = [given.inputs, *given.sizes, outputs]
        layers = random_layers(random, sizes, engine.weight_bits, engine.value_bits)
        # A network takes what its environment shows; here it is told the inputs themselves.
        count = len(spec.observation)
        inputs = Scaling(np.zeros(count, int), np.ones(count, int), np.zeros(count, int), limit)
        network = object.__new__(IntegerNetwork)
        parts = (spec, inputs, np.zeros((0, sizes[1]), np.int32), layers, Head((outputs,)))
        for name, part in zip(("spec", "inputs", "indicator", "layers", "head"), parts, strict=True):
            object.__setattr__(network, name, part)
        words = policy_words(network, engine)
        del words[Section.SCALINGS]
        await write_policy(dut, words)
        for groups in (1, batch, batch + 1, 3 * batch - 1):
            x = random.integers(-limit, limit + 1, (groups, given.group, given.inputs))
            wanted = _sums(network, x.reshape(-1, given.inputs)).reshape(groups, -1).tolist()
            padded = np.zeros((groups, given.group, chunks * engine.products), np.int64)
            padded[..., : given.inputs] = x
            sent, came, cycle = 0, 0, 0
            ends: list[int] = []
            while came < groups:
                assert cycle < 200 + 20 * groups * batch_cycles(engine, sizes)
                # No more than two batches are under way.
                valid = sent < groups * chunks and sent // chunks < (came // batch + 2) * batch
                dut.valid_i.value = int(valid)
                if valid:
                    group, chunk = divmod(sent, chunks)
                    row = padded[group, :, chunk * engine.products : (chunk + 1) * engine.products]
                    dut.values_i.value = packed(row, engine.value_bits)
                    dut.last_i.value = int(group == groups - 1)
                    sent += 1
                await ReadOnly()
                if dut.valid_o.value == 1:
                    found = unpacked(int(dut.logits_o.value), 32, given.group * outputs)
                    assert found == wanted[came], f"group {came} of {groups}"
                    came += 1
                    if came % batch == 0:
                        ends.append(cycle)
                cycle += 1
                await FallingEdge(dut.clk_i)
            # Where batches follow each other, each takes as long as the layers do.
            fast = batch * chunks + 20 < batch_cycles(engine, sizes)
            if fast and len(ends) > 1:
                assert np.diff(ends).tolist() == [batch_cycles(engine, sizes)] * (len(ends) - 1)


def _sums(network: Any, x: Any) -> Any:
    # As IntegerNetwork.sums has it, of inputs that are scaled already.
    for layer in network.layers:
        sums = x @ layer.weights.T.astype(np.int64) + layer.bias
        x = sums >> layer.shift
        if len(layer.activation):
            x = layer.activation[x.clip(-512, 511) + 512].astype(np.int64)
        else:
            x = x.clip(0, layer.limit)
    return sums
