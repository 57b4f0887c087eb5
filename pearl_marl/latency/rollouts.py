"""The clock cycles of a rollout in hardware: in closed form, from what happens in ``rtl/``."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from pearl_marl.compiler.targets import Target
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware import elaboration
from pearl_marl.latency.cycles import DRAW_LATENCY, FETCH
from pearl_marl.memory_map import Engine, MemoryMap
from pearl_marl.spec import EnvSpec

_READ_LATENCY = 2

_BETWEEN = 5
"""Cycles from when the sums of a step are complete to the first issue of the next one, without keys."""

_KEYS = 7
"""The same and what it takes to begin with the keys, if they are waited for."""


def batch_cycles(engine: Engine, sizes: Sequence[int]) -> int:
    """Return the cycles that a network's layers take for a batch: ``side * rounds`` groups.

    ``sizes`` are the widths of the network: its inputs, its hidden layers, its outputs. A layer takes a word
    of weights a cycle, ``rounds`` times. Between two layers the pipeline runs empty.
    """
    words = sum(-(-width // engine.products) * outputs for width, outputs in pairwise(sizes))
    gap = 2 * _READ_LATENCY + 6 + _levels(engine.products)
    return words * engine.rounds + (len(sizes) - 2) * gap + 1


def rollout_step_cycles(
    spec: EnvSpec, layout: MemoryMap, sizes: Sequence[int] = (), target: Target = elaboration.TARGET
) -> int:
    """Return the clock cycles by which a rollout is longer if it has one step more.

    It is what ``Rtl.cycles`` counts of a pipelined device. ``sizes`` are the widths of the network, as
    :func:`batch_cycles` takes them, with the inputs of :meth:`Engine.inputs`; other engines have none. Each
    step takes the groups past the cores twice, and begins when the last of the step before is in the sums.
    Where a batch is computed sooner than the next one comes in, it may be a few per cent too low.
    """
    if layout.engine is None:
        raise ArgumentError("the build has no policy engine; lay it out with one")
    timing, draws = elaboration.core_timing(spec, target), spec.reset_draws + spec.step_draws
    # From a group's issue to its results.
    depth = (DRAW_LATENCY if draws else FETCH) + timing.latency
    engine, interval, groups = layout.engine, timing.interval, layout.groups
    if engine.is_network:
        way = depth + _to_inputs(spec, engine, target)
        issued = _network_issues(spec, engine, way, interval, groups, sizes)
    else:
        issued = _issues(depth + _to_actions(spec, engine, target) + 1, interval, groups)
    counted = depth + _READ_LATENCY + 3 + _levels(layout.pe_num * spec.agents)
    keys = max(draws, spec.agents * engine.draws)
    return issued + counted + (DRAW_LATENCY * (1 + keys) + _KEYS if keys else _BETWEEN)


def _to_actions(spec: EnvSpec, engine: Engine, target: Target) -> int:
    """Return the cycles that a table or a golden function takes from what a group is shown to its actions."""
    if engine.kind == "golden":
        waits = DRAW_LATENCY if engine.draws else 1
        return waits + elaboration.act_core(spec, engine, target).latency
    lookup = 1 + _levels(len(spec.observation) + 1) + _READ_LATENCY
    return lookup + _choice(spec, engine)


def _issues(way: int, interval: int, groups: int) -> int:
    """Return the cycles from a step's first issue to its last one.

    Groups are observed until the first one's actions come, ``way`` cycles after its issue, and then stepped
    until there are no more actions.
    """
    together = -(-way // interval)
    full, rest = divmod(groups - 1, together)
    rest += 1
    return full * 2 * together * interval + max(way, rest * interval) + (rest - 1) * interval


def _to_inputs(spec: EnvSpec, engine: Engine, target: Target) -> int:
    """Return the cycles from what a group is shown to its first inputs, scaled or of patches."""
    if engine.kind != "planes":
        return _READ_LATENCY + 5
    sums = _levels(9 * spec.observation_shape[2])
    return elaboration.show_core(spec, target).latency + 5 + sums


def _network_issues(
    spec: EnvSpec, engine: Engine, way: int, interval: int, groups: int, sizes: Sequence[int]
) -> int:
    """Return the same with a network.

    The next batch comes in while one is computed, as soon as there is room for it; that is, when the one
    before that has been stepped.
    """
    layers, batch = batch_cycles(engine, sizes), engine.side * engine.rounds
    chunks = -(-engine.inputs(spec) // engine.products)
    observe = max(interval, chunks)
    # From the issue of a batch's last group to its first product; and from where the next one could
    # begin to the first actions.
    into = way + 2 + chunks
    out = _READ_LATENCY + 6 + _levels(engine.products) + _choice(spec, engine)
    begins: list[int] = []
    for first in range(0, groups, batch):
        count = min(batch, groups - first)
        if len(begins) < 2:
            ready = (first + count - 1) * observe + into
        else:
            ready = begins[-2] + layers + out + batch * interval + (count - 1) * observe + into
        begins.append(max(ready, begins[-1] + layers if begins else 0))
    return begins[-1] + layers + out + (count - 1) * interval


def _choice(spec: EnvSpec, engine: Engine) -> int:
    """Return the cycles from logits to actions."""
    actions = sum(spec.action_counts)
    if not engine.drawn:
        return actions
    return max(2 * actions + 2 + _READ_LATENCY, DRAW_LATENCY) + 4


def _levels(terms: int) -> int:
    return (terms - 1).bit_length()
