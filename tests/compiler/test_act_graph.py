"""A policy's core does what its golden function does, as traced and as lowered for an FPGA."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.compiler.core_graph import Output, act_graph
from pearl_marl.compiler.lowering import lowered
from pearl_marl.compiler.targets import Target
from pearl_marl.golden.tracing.nodes import values
from pearl_marl.policies.golden_policy import GoldenPolicy
from pearl_marl.spec import EnvSpec

from ..policies.rules import balance, brake, catch, drive, up
from ..toy_world import MEADOW


def anywhere(view: Any, draws: Any) -> Any:
    return draws.below(5)


@pytest.mark.parametrize(
    ("spec", "act"),
    [
        (get_spec("CartPole"), balance),
        (get_spec("Pendulum"), brake),
        (get_spec("MountainCarContinuous"), drive),
        (get_spec("Catch"), catch),
        # Masks: four, and five, of which some forbid all.
        (get_spec("Game2048"), up),
        (MEADOW, anywhere),
    ],
    ids=lambda part: getattr(part, "name", ""),
)
def test_a_core_chooses_as_the_policy_does(spec: EnvSpec, act: Any) -> None:
    policy, random, n = GoldenPolicy(spec, act), np.random.default_rng(5), 60
    ranges = np.array([f.range for f in spec.observation])
    elements = random.integers(*ranges.T, (n, len(ranges)), endpoint=True)
    elements[:2] = ranges.T
    masks = random.random((n, len(spec.mask_fields))) < 0.4
    draws = random.integers(0, 1 << 32, (n, policy.draws), dtype=np.uint32)
    if masks.size:
        assert {0, masks.shape[1]} <= set(masks.sum(1).tolist()) | {masks.shape[1]}
    given = masks.astype(np.int8) if masks.size else None
    due = policy.choose(elements, np.zeros(n, int), given, draws).words
    graph, outputs = act_graph(spec, policy.of_words, policy.draws)
    for found in (outputs, *(lowered(graph, outputs, Target(*of)) for of in (("ecp5", 150), ("xc7", 250)))):
        for i in range(n):
            inputs = {f"rng_i[{k}]": int(draw) for k, draw in enumerate(draws[i])}
            shown = [*elements[i].tolist(), *masks[i].astype(int).tolist()]
            names = (f"obs_i.{f.name}" for f in spec.agent_fields)
            assert _words(spec, found, inputs | dict(zip(names, shown, strict=True))) == due[i].tolist()


def _words(spec: EnvSpec, outputs: list[Output], inputs: dict[str, int]) -> list[int]:
    numbers = values([output.node for output in outputs], inputs)
    words = []
    for output, field in zip(outputs, spec.action_fields, strict=True):
        word = numbers[output.node] & ((1 << output.bits) - 1)
        words.append(word - (1 << output.bits) if field.signed and word >> output.bits - 1 else word)
    return words
