"""Steps over reals as kernels and cores have them, against the same steps of Python's integers."""

from __future__ import annotations

import random
from typing import Any, NamedTuple

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from pearl_marl.compiler.core_graph import Output
from pearl_marl.compiler.lowering import lowered
from pearl_marl.compiler.targets import Target
from pearl_marl.golden import call_reference
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import in_order, values
from pearl_marl.layout import Real
from pearl_marl.spec import EnvSpec, Golden

from .test_classic_control import ENVIRONMENTS, inputs, posed, traced
from .test_straight_line import compiled

XC7 = Target("xc7", 150)


class State(NamedTuple):
    x: Real[-4.0, 4.0]
    y: Real[-4.0, 4.0]


def step(state: State, action: Any, draws: Any) -> Any:
    """Divide, and take roots and powers, where a condition says that it can be done."""
    x, y = state.x, state.y
    inverse = 1 / x if x > 0.25 else 0.0
    root = np.sqrt(y) if y >= 0 else -y
    if -4.0 < x < -0.5 and action:
        root = root - y / x
    elif y > 1:
        root, rest = divmod(root, 0.3)
        root = root // 0.25 * rest // (0.1 if action else 0.3)
    return State(inverse, root), 0, False


BRANCHES = EnvSpec(
    name="Branches",
    version=0,
    summary="What a branch says of reals",
    rewards=(0.0,),
    observation_space=Box(-4.0, 4.0, (2,)),
    action_space=Discrete(2),
    golden=Golden(State, lambda draws: State(0.0, 0.0), step, lambda state: state, view=State),
)
SPECS = {**ENVIRONMENTS, "Branches": BRANCHES}


@pytest.mark.parametrize("name", SPECS)
def test_kernels(name: str) -> None:
    spec, generator = SPECS[name], random.Random(0)
    found, fields = compiled(spec), inputs(spec)
    for _ in range(300):
        words = [f.dtype.type(word) for f, word in zip(fields, posed(spec, generator), strict=True)]
        due = call_reference(spec.positional.step, words)
        assert [int(x) for x in found["golden_step"](*words)] == [int(x) for x in due]
        seen = call_reference(spec.positional.observe, words[:-1])
        assert [int(x) for x in found["observe"](*words[:-1])] == [int(x) for x in seen]


@pytest.mark.parametrize("name", SPECS)
def test_cores(name: str) -> None:
    spec, generator = SPECS[name], random.Random(0)
    graph, fields = Graph(exact=False), inputs(spec)
    roots = traced(spec.positional.step, *fields)
    outputs = lowered(graph, [Output("state_o", f"{k}", 40, node) for k, node in enumerate(roots)], XC7)
    for _ in range(20):
        words = posed(spec, generator)
        given = {field.name: word for field, word in zip(fields, words, strict=True)}
        found = values([output.node for output in outputs], given)
        due = call_reference(spec.positional.step, words)
        assert all((found[o.node] - int(x)) % (1 << 40) == 0 for o, x in zip(outputs, due, strict=True))
    multipliers = sum(node.op == "mul" for node in in_order([output.node for output in outputs]))
    print(f"{name}: {multipliers} multipliers of 24 by 17 bits")
