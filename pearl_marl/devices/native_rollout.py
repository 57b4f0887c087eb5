"""Rollouts on the CPU: act, step, act, step, while a block of slots is in the processor's cache."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np

from pearl_marl.base.machine_code import kept_code
from pearl_marl.compiler.kernel_loops import BLOCK, RESULTS, STEP_ARGUMENTS
from pearl_marl.compiler.kernels import Kernels
from pearl_marl.compiler.loading import load, with_callees
from pearl_marl.golden import rng
from pearl_marl.golden.rng import CHAIN_A, CHAIN_B
from pearl_marl.policies import device_policy, integer_loops, integer_network
from pearl_marl.policies.device_policy import FIRST_DRAW
from pearl_marl.policies.integer_loops import compiled_act

TICK, SEED_0, SEED_1, FIRST_SLOT, NEXT_STEP = map(
    STEP_ARGUMENTS.index, ("tick", "seed_0", "seed_1", "first_slot", "next_step")
)
OBSERVATIONS, REWARDS, TERMINATIONS, TRUNCATIONS, FINAL = map(STEP_ARGUMENTS.index, RESULTS)
MASKS, ALIVE = map(STEP_ARGUMENTS.index, ("action_masks", "alive"))

act: Any = None
step: Any = None
"""The policy and the kernel that a rollout is compiled with."""

_jit: Any = numba.njit(error_model="numpy")
key, draw = (with_callees(function, {}, _jit) for function in (rng.key, rng.draw))


def rollout(arguments, table, net, actions, elements, masks, in_episode, sums, record, agents, steps, lo, hi):  # type: ignore[no-untyped-def]
    """Roll out the slots of a range: see :func:`kernel`."""
    # Everything of a block lies in these, which every step writes over.
    rows, width = BLOCK * agents, elements.shape[1]
    shown, final = np.empty((rows, width), elements.dtype), np.empty((rows, width), elements.dtype)
    allowed = np.empty((rows if masks.shape[0] else 0, masks.shape[1]), masks.dtype)
    present = np.ones(rows, np.uint8)
    rewards = np.empty(rows, np.float32)
    terminations, truncations = np.empty(rows, np.uint8), np.empty(rows, np.uint8)
    draws = np.empty((rows, net.draws), np.uint32)
    words = np.empty((rows, actions.shape[1]), np.int64)
    keep = len(record.rewards) > 0
    logits = np.empty((rows if keep else 0, record.logits.shape[2]), np.int32)
    keys = np.empty((agents, max(net.draws, 1), 2), np.uint32)
    mine = arguments.copy()
    began = arguments[TICK]
    for b in range(lo, hi, BLOCK):
        e = min(b + BLOCK, hi)
        n, first = (e - b) * agents, b * agents
        for i in range(n):
            for k in range(width):
                shown[i, k] = elements[first + i, k]
            present[i] = in_episode[first + i]
            for k in range(allowed.shape[1]):
                allowed[i, k] = masks[first + i, k]
        # Kernels add to an address what lies before a block; so these begin before their arrays.
        mine[OBSERVATIONS] = np.uint64(shown.ctypes.data) - np.uint64(first * width * shown.itemsize)
        mine[FINAL] = np.uint64(final.ctypes.data) - np.uint64(first * width * shown.itemsize)
        mine[REWARDS] = np.uint64(rewards.ctypes.data) - np.uint64(first * 4)
        mine[TERMINATIONS] = np.uint64(terminations.ctypes.data) - np.uint64(first)
        mine[TRUNCATIONS] = np.uint64(truncations.ctypes.data) - np.uint64(first)
        if allowed.shape[1]:
            mine[MASKS] = np.uint64(allowed.ctypes.data) - np.uint64(first * allowed.shape[1])
        if agents > 1:
            mine[ALIVE] = np.uint64(present.ctypes.data) - np.uint64(first)
        for t in range(steps):
            tick = began + np.uint64(t)
            mine[TICK] = tick
            if net.draws:
                for agent in range(agents):
                    for d in range(net.draws):
                        index = np.uint32(FIRST_DRAW + agent * net.draws + d)
                        seed_0, seed_1 = np.uint32(arguments[SEED_0]), np.uint32(arguments[SEED_1])
                        keys[agent, d, 0] = key(np.uint32(CHAIN_A), seed_0, seed_1, tick, index)
                        keys[agent, d, 1] = key(np.uint32(CHAIN_B), seed_0, seed_1, tick, index)
                for i in range(n):
                    slot = np.uint32(arguments[FIRST_SLOT] + np.uint64(b + i // agents))
                    for d in range(net.draws):
                        draws[i, d] = draw(slot, keys[i % agents, d, 0], keys[i % agents, d, 1])
            act(net, shown[:n], allowed[: n * min(len(allowed), 1)], draws[:n], words[:n], logits)
            for i in range(n):
                for k in range(actions.shape[1]):
                    actions[first + i, k] = words[i, k]
            if keep:
                for i in range(n):
                    for k in range(width):
                        record.elements[t, first + i, k] = shown[i, k]
                    for k in range(allowed.shape[1]):
                        record.masks[t, first + i, k] = allowed[i, k]
                    for k in range(actions.shape[1]):
                        record.words[t, first + i, k] = words[i, k]
                    for k in range(logits.shape[1]):
                        record.logits[t, first + i, k] = logits[i, k]
            step(mine, actions.reshape(-1), table, b, e)
            for i in range(n):
                agent = first + i
                if sums.waiting[agent]:
                    sums.waiting[agent] = 1 - present[i]
                    continue
                sums.running[agent] += rewards[i]
                sums.length[agent] += 1
                if terminations[i] | truncations[i]:
                    if sums.whole[agent] and sums.ended[agent] < sums.most[agent]:
                        total = sums.running[agent]
                        sums.returns[agent] += total
                        sums.squares[agent] += total * total
                        sums.lengths[agent] += sums.length[agent]
                        sums.ended[agent] += 1
                        sums.truncated[agent] += 1 - terminations[i]
                    sums.running[agent], sums.length[agent], sums.whole[agent] = 0.0, 0, 1
                    sums.waiting[agent] = 1 if arguments[NEXT_STEP] else 1 - present[i]
            if keep:
                for i in range(n):
                    record.rewards[t, first + i] = rewards[i]
                    record.terminations[t, first + i] = terminations[i]
                    record.truncations[t, first + i] = truncations[i]


@cache
def kernel(kernels: Kernels) -> Callable[..., None]:
    """Return the rollout of some kernels, whose observations are elements.

    It is called as ``rollout(arguments, table, net, actions, elements, masks, in_episode, sums, record,
    agents, steps, lo, hi)`` for the slots of a range. ``arguments`` and ``table`` are what the kernel
    ``step`` takes, whose addresses of results are replaced; ``elements``, ``masks`` and ``in_episode`` are
    what agents are shown now; ``actions`` is written over; ``sums`` and ``record`` are
    :class:`~pearl_marl.devices.rollouts.Sums` and :class:`~pearl_marl.devices.rollouts.Record`.
    """
    texts = [
        inspect.getsource(part) for part in (rollout, integer_loops, integer_network, device_policy, rng)
    ]
    digest = hashlib.sha256(repr((kernels.path.name, texts, numba.__version__, np.__version__)).encode())
    name = f"rollout_{kernels.path.stem.rpartition('_')[0]}_{digest.hexdigest()[:16]}"
    known = {name: value for name, value in globals().items() if not name.startswith("__")}
    names = {**known, "act": compiled_act(), "step": kernels.step}
    loaded, _ = load(name, inspect.getsource(rollout), **names)
    return kept_code(numba.njit(nogil=True, error_model="numpy")(loaded.rollout), name)  # type: ignore[no-any-return]
