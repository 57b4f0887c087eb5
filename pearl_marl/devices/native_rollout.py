"""Rollouts on the CPU: act, step, act, step, while a block of slots is in the processor's cache.

One loop is compiled for all environments and policies. It is given the addresses of what differs: of the
kernel ``step``, and of the policy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numba
import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.step import Observed
from pearl_marl.compiler import addresses
from pearl_marl.compiler.addresses import call_act, call_step
from pearl_marl.compiler.kernel_loops import BLOCK, STEP_ARGUMENTS
from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.devices import rollouts
from pearl_marl.devices.rollouts import Sums
from pearl_marl.golden import rng
from pearl_marl.golden.rebinding import rebound
from pearl_marl.golden.rng import CHAIN_A, CHAIN_B
from pearl_marl.policies import dense_policy, device_policy, golden_policy, integer_loops
from pearl_marl.policies.dense_policy import DenseNetwork
from pearl_marl.policies.device_policy import FIRST_DRAW, CompiledPolicy, DevicePolicy
from pearl_marl.policies.golden_policy import GoldenPolicy
from pearl_marl.policies.integer_loops import called, put, put_rows
from pearl_marl.policies.integer_network import AgentNetworks, IntegerNetwork

TICK, SEED_0, SEED_1, FIRST_SLOT, NEXT_STEP = map(
    STEP_ARGUMENTS.index, ("tick", "seed_0", "seed_1", "first_slot", "next_step")
)

_jit: Any = numba.njit(error_model="numpy")
key, draw = (rebound(function, finish=_jit) for function in (rng.key, rng.draw))


class StepArrays(NamedTuple):
    """What all agents are shown, do and get, as ``step`` names it; every step writes over it."""

    observations: Array  # uint8: the bytes of elements, agent after agent
    final_observations: Array  # the same, of what they are shown last in an episode
    action_masks: Array  # (n_agents, n_actions) int8; of no agents without masks
    alive: Array  # uint8
    actions: Array  # uint8: the bytes of the words of actions
    rewards: Array  # float32
    terminations: Array  # uint8
    truncations: Array  # uint8

    @classmethod
    def of(cls, config: BatchConfig, seen: Observed) -> StepArrays:
        """Return what agents are shown, and room for the rest."""
        elements, masks, present = seen
        n, spec = config.n_agents, config.spec
        size = len(spec.action_fields) * np.dtype(spec.action_dtype).itemsize
        return cls(
            elements.reshape(-1).view(np.uint8),
            np.empty(elements.nbytes, np.uint8),
            np.zeros((0, 0), np.int8) if masks is None else masks,
            present.view(np.uint8),
            np.zeros(n * size, np.uint8),
            np.empty(n, np.float32),
            np.empty(n, np.uint8),
            np.empty(n, np.uint8),
        )

    def put_into(self, arguments: Array) -> None:
        """Have the kernel ``step`` work on these arrays."""
        for name, array in self._asdict().items():
            if name != "actions":  # which are an argument by themselves
                arguments[STEP_ARGUMENTS.index(name)] = array.ctypes.data


@called
def _add(sums: Sums, batch: StepArrays, first: int, n: int, t: int, next_step: int) -> None:
    """Add a step of ``n`` agents to the sums; lengths are less by the steps before the present one."""
    rewards, terminations = batch.rewards[first : first + n], batch.terminations[first : first + n]
    truncations, waiting = batch.truncations[first : first + n], sums.waiting[first : first + n]
    running, present = sums.running[first : first + n], batch.alive[first : first + n]
    # Of unsigned indices none counts from the end, so that these loops are vectorised.
    for k in range(np.uint64(n)):
        running[k] += rewards[k] if waiting[k] == 0 else np.float32(0)
    for start in range(np.uint64(0), np.uint64(n), np.uint64(64)):
        end, some = min(start + np.uint64(64), np.uint64(n)), np.uint8(0)
        for k in range(start, end):
            some |= terminations[k] | truncations[k] | waiting[k]
        if not some:
            continue
        for i in range(np.int64(start), np.int64(end)):
            # All agents are present again when their world has ended.
            later = (2 if next_step else 0) if present[i] else 1
            if waiting[i]:
                waiting[i] = later if waiting[i] == 1 else 0
                sums.length[first + i] -= 1
            elif terminations[i] | truncations[i]:
                agent = first + i
                if sums.whole[agent] and sums.ended[agent] < sums.most[agent]:
                    total = running[i]
                    sums.returns[agent] += total
                    sums.squares[agent] += total * total
                    sums.lengths[agent] += sums.length[agent] + t + 1
                    sums.ended[agent] += 1
                    sums.truncated[agent] += 1 - terminations[i]
                running[i], sums.length[agent], sums.whole[agent] = 0.0, -t - 1, 1
                waiting[i] = later


@called
def _make_draws(arguments: Array, tick: Any, agents: int, b: int, draws: Array) -> None:
    seed_0, seed_1 = np.uint32(arguments[SEED_0]), np.uint32(arguments[SEED_1])
    count = draws.shape[1]
    for agent in range(agents):
        for d in range(count):
            index = np.uint32(FIRST_DRAW + agent * count + d)
            key_a = key(np.uint32(CHAIN_A), seed_0, seed_1, tick, index)
            key_b = key(np.uint32(CHAIN_B), seed_0, seed_1, tick, index)
            for i in range(len(draws) // agents):
                slot = np.uint32(arguments[FIRST_SLOT] + np.uint64(b + i))
                draws[i * agents + agent, d] = draw(slot, key_a, key_b)


def _rollout(act, policy, n_draws, step, arguments, table, batch, sums, record, agents, steps, lo, hi):  # type: ignore[no-untyped-def]
    rows, fields = BLOCK * agents, record.words.shape[2]
    n_agents = len(batch.rewards)
    row, size = len(batch.observations) // n_agents, len(batch.actions) // (n_agents * fields)
    masked, keep = len(batch.action_masks) > 0, len(record.rewards) > 0
    learns = record.present.shape[1] > 0
    draws = np.empty((rows, n_draws), np.uint32)
    words = np.empty((rows, fields), np.int64)
    logits = np.empty((rows if keep else 0, record.logits.shape[2]), np.int32)
    mine = arguments.copy()
    for b in range(lo, hi, BLOCK):
        e = min(b + BLOCK, hi)
        first, last = b * agents, e * agents
        n = last - first
        elements, masks = batch.observations[first * row : last * row], batch.action_masks[first:last]
        own, of_block = words[:n], draws[:n]
        flat, actions = own.reshape(-1), batch.actions[first * fields * size : last * fields * size]
        to_act, to_step = (policy, elements, masks, of_block, own, logits), (mine, batch.actions, table, b, e)
        for t in range(steps):
            tick = arguments[TICK] + np.uint64(t)
            mine[TICK] = tick
            if n_draws:
                _make_draws(arguments, tick, agents, b, of_block)
            if learns:
                noise = record.noise[t, first:last]
                call_act(act, (policy, elements, masks, noise, own, logits))
            else:
                call_act(act, to_act)
            if size == 1:
                put(flat, actions)
            elif size == 2:
                put(flat, actions.view(np.uint16))
            elif size == 4:
                put(flat, actions.view(np.uint32))
            else:
                put(flat, actions.view(np.int64))
            if keep:
                put_rows(elements.reshape((n, row)), record.observations[t, first:last])
                put_rows(own, record.words[t, first:last])
                put_rows(logits[:n], record.logits[t, first:last])
                if masked:
                    put_rows(masks, record.masks[t, first:last])
            if learns:
                put(batch.alive[first:last], record.present[t, first:last])
            call_step(step, to_step)
            _add(sums, batch, first, n, t, arguments[NEXT_STEP])
            if keep:
                put(batch.rewards[first:last], record.rewards[t, first:last])
                put(batch.terminations[first:last], record.terminations[t, first:last])
                put(batch.truncations[first:last], record.truncations[t, first:last])
            if learns:
                for i in range(first, last):
                    if batch.truncations[i]:
                        put(batch.final_observations[i * row : (i + 1) * row], record.final[t, i])
        for i in range(first, last):
            sums.length[i] += steps


compiled_rollout = compiled_loop(_rollout, addresses, device_policy, integer_loops, rollouts, rng)
"""Return the loop of a rollout.

It is called as ``rollout(*policy, step, arguments, table, batch, sums, record, agents, steps, lo, hi)`` for
the slots of a range. ``policy`` are the arguments of a :class:`CompiledPolicy`; ``step`` is the address of
the kernel of that name, which takes ``arguments`` and ``table``. ``record`` has bytes in the place of
observations.
"""


_COMPILED: Mapping[type, Callable[[Any, np.dtype[Any]], CompiledPolicy | None]] = {
    IntegerNetwork: integer_loops.compiled,
    AgentNetworks: integer_loops.compiled_apart,
    DenseNetwork: dense_policy.compiled,
    GoldenPolicy: golden_policy.compiled,
}


def compiled_policy(policy: DevicePolicy, elements: np.dtype[Any]) -> CompiledPolicy | None:
    """Return a policy compiled for elements of a dtype; ``None`` if it cannot be."""
    compiled = _COMPILED.get(type(policy))
    return None if compiled is None else compiled(policy, elements)
