"""Choosing a build for rollouts: how many multipliers are for cores, and how many for the policy engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pearl_marl.compiler.targets import Target
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.elaboration import act_core, clocked
from pearl_marl.hardware.engines import with_engine
from pearl_marl.hardware.fitting import DRAW_DSP, Part, modelled_bram36, modelled_dsp
from pearl_marl.latency.planning import MAX_PE_NUM, NEAR
from pearl_marl.latency.rollouts import rollout_step_cycles
from pearl_marl.memory_map import Engine, MemoryMap, memory_map
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.policies.integer_network import IntegerNetwork
from pearl_marl.spec import EnvSpec

MOST_SIDE = 1024
"""The most groups that are computed side by side where no part sets a limit."""


@dataclass(frozen=True, slots=True)
class RolloutCandidate:
    """A build with an engine, and what a step of a rollout takes there."""

    layout: MemoryMap
    cycles: int
    rate: float
    """Policy steps of all agents per second."""
    core_dsp: int
    engine_dsp: int
    limit: str
    """What more of would make it faster: ``"cores"`` or ``"engine"``."""

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        engine = self.layout.engine
        assert engine is not None
        return {
            "pe_num": self.layout.pe_num,
            "data_wl": self.layout.data_wl,
            "engine": engine.as_json(),
            "cycles": self.cycles,
            "policy_steps_per_second": self.rate,
            "core_dsp": self.core_dsp,
            "engine_dsp": self.engine_dsp,
            "limit": self.limit,
        }


def engine_dsp(engine: Engine, spec: EnvSpec, pe_num: int, target: Target) -> int:
    """Return the DSPs of an engine.

    Of a network it is one a product, without those of drawn actions, and two for each element that is scaled
    at once; filters of planes take none. Of a golden function the multipliers of its cores and draws.
    """
    if engine.kind == "table":
        return 0
    if engine.kind == "golden":
        each = DRAW_DSP * engine.draws + act_core(spec, engine, target).multipliers
        return DRAW_DSP * (engine.draws > 0) + pe_num * spec.agents * each
    scaled = min(engine.products, len(spec.observation)) if engine.kind == "network" else 0
    return pe_num * (engine.side * engine.products + 2 * scaled)


def plan_rollouts(
    policy: DevicePolicy,
    n_envs: int,
    clock: float,
    part: Part | None = None,
    pe_num: int | None = None,
    data_wl: int | None = None,
) -> list[RolloutCandidate]:
    """Return builds for a policy that fit a part, one for each number of processing elements.

    The best comes first. It has the fewest elements of those that are nearly as fast as the fastest
    (:data:`NEAR`). An engine for a network gets all multipliers that the cores leave, as far as they help.

    Raises
    ------
    ArgumentError
        No engine takes the policy, or no build fits the part.
    """
    spec = policy.spec
    target = clocked("xc7", clock / 1e6)
    dsp = modelled_dsp(spec, target)
    layers = policy.layers if isinstance(policy, IntegerNetwork) else ()
    outputs = [len(layer.bias) for layer in layers]
    counts = [1 << k for k in range(MAX_PE_NUM.bit_length()) if 1 << k <= n_envs]

    def cycles(layout: MemoryMap, engine: Engine) -> int:
        own = memory_map(spec, layout.n_envs, layout.pe_num, layout.data_wl, engine)
        return rollout_step_cycles(spec, own, [engine.inputs(spec), *outputs], target)

    found = []
    for count in counts if pe_num is None else [pe_num]:
        plain = Build.of(spec, n_envs, count, data_wl)
        engine = with_engine(plain, policy).layout.engine
        assert engine is not None
        left = None if part is None else part.dsp - dsp(count)
        if engine.is_network:
            side = MOST_SIDE
            if left is not None:
                none = engine_dsp(engine._replace(side=0), spec, count, target)
                side = (left - none) // (engine.products * count)
            engine = engine._replace(side=max(1, min(side, -(-plain.layout.groups // engine.rounds))))
        taken = engine_dsp(engine, spec, count, target)
        if left is not None and (taken > left or modelled_bram36(plain.layout) > part.bram36):  # type: ignore[union-attr]
            continue
        took = cycles(plain.layout, engine)
        limit = "cores"
        if engine.is_network and cycles(plain.layout, engine._replace(side=2 * engine.side)) * NEAR < took:
            limit = "engine"
        layout = memory_map(spec, n_envs, count, plain.layout.data_wl, engine)
        rate = n_envs * spec.agents / took * clock
        found.append(RolloutCandidate(layout, took, rate, dsp(count), taken, limit))
    if not found:
        name = "any part" if part is None else f"the {part.name}"
        raise ArgumentError(
            f"no engine for this policy fits {name} beside {n_envs:,} slots of {spec.name}: take fewer "
            "slots, a smaller policy, or a larger part"
        )
    enough = max(candidate.rate for candidate in found) / NEAR
    best = next(candidate for candidate in found if candidate.rate >= enough)
    return [best, *(candidate for candidate in found if candidate is not best)]
