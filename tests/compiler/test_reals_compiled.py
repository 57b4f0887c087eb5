"""Steps over reals as kernels and cores have them, against the same steps of Python's integers."""

from __future__ import annotations

import random

import pytest

from pearl_marl.compiler.core_graph import Output
from pearl_marl.compiler.lowering import lowered
from pearl_marl.compiler.targets import Target
from pearl_marl.golden import call_reference
from pearl_marl.tracing.graph import Graph
from pearl_marl.tracing.nodes import in_order, values

from .test_classic_control import ENVIRONMENTS, inputs, posed, traced
from .test_straight_line import compiled

XC7 = Target("xc7", 150)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_kernels(name: str) -> None:
    spec, generator = ENVIRONMENTS[name], random.Random(0)
    found, fields = compiled(spec), inputs(spec)
    for _ in range(300):
        words = [f.dtype.type(word) for f, word in zip(fields, posed(spec, generator), strict=True)]
        due = call_reference(spec.positional.step, words)
        assert [int(x) for x in found["golden_step"](*words)] == [int(x) for x in due]
        seen = call_reference(spec.positional.observe, words[:-1])
        assert [int(x) for x in found["observe"](*words[:-1])] == [int(x) for x in seen]


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_cores(name: str) -> None:
    spec, generator = ENVIRONMENTS[name], random.Random(0)
    graph, fields = Graph(exact=False), inputs(spec)
    roots = traced(spec.positional.step, *fields)
    outputs = lowered(graph, [Output("state_o", f"{k}", 0, 40, node) for k, node in enumerate(roots)], XC7)
    for _ in range(20):
        words = posed(spec, generator)
        given = {field.name: word for field, word in zip(fields, words, strict=True)}
        found = values([output.node for output in outputs], given)
        due = call_reference(spec.positional.step, words)
        assert all((found[o.node] - int(x)) % (1 << 40) == 0 for o, x in zip(outputs, due, strict=True))
    multipliers = sum(node.op == "mul" for node in in_order([output.node for output in outputs]))
    print(f"{name}: {multipliers} multipliers of 24 by 17 bits")
