"""Steps over reals as kernels and cores have them, against the same steps of Python's integers."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from pearl_marl.compiler import straight_line
from pearl_marl.compiler.core_graph import Output
from pearl_marl.compiler.lowering import lowered
from pearl_marl.compiler.targets import Target
from pearl_marl.reals import Real, admitted
from pearl_marl.reals.numbers import constant
from pearl_marl.reals.words import noted
from pearl_marl.registry import get_spec
from pearl_marl.tracing.graph import Graph
from pearl_marl.tracing.nodes import Node, in_order, values
from pearl_marl.tracing.trace import trace
from pearl_marl.tracing.words import Word, node_of

from ..classic_control import CONTROLS, Control
from .test_classic_control import fielded, posed, reference, traced
from .test_straight_line import compiled

XC7 = Target("xc7", 150)


def of_words(control: Control) -> Callable[..., Any]:
    """The step as a golden function of today's specs: words in, words out."""

    def real(word: Any, ends: tuple[float, float]) -> Real:
        return Real(noted(word, *(constant(end, control.fraction) for end in ends)), control.fraction)

    def step(*words: Any) -> tuple[Any, ...]:
        *state, action = words
        given = real(action, control.action) if control.action else action
        state = [real(word, ends) for word, ends in zip(state, control.bounds, strict=True)]
        results = fielded(control, control.step(state, given))
        # A reward gets a fraction that fits its field, and an end is a real of 0 or 1 here.
        *state, last = results
        return (*state, last >> 4, 0) if control.action else (*state, 0, last >> control.fraction)

    return step


@pytest.mark.parametrize("name", ["CartPole", "MountainCar", "Pendulum"])
def test_kernels(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the fields of the environment that there is, and all but the step as it is there."""
    control = CONTROLS[name]
    spec, step = copy.copy(get_spec(name)), of_words(control)
    object.__setattr__(spec, "golden", spec.golden._replace(step=step))

    def traced_with_reals(
        graph: Graph, function: Callable[..., Any], arguments: Sequence[Node], *agent: int
    ) -> list[Node]:
        if function is not step:
            return trace(graph, function, arguments, *agent)
        return [node_of(graph, x) for x in step(*(Word(admitted(graph), node) for node in arguments))]

    monkeypatch.setattr(straight_line, "trace", traced_with_reals)
    kernel, generator = compiled(spec)["golden_step"], random.Random(0)
    fields = [*spec.state, *spec.each_agent(spec.action)]
    for _ in range(300):
        state, action = posed(control, generator)
        words = [field.dtype.type(word) for field, word in zip(fields, [*state, action], strict=True)]
        assert [int(x) for x in kernel(*words)] == [int(x) for x in step(*state, action)]


@pytest.mark.parametrize("name", CONTROLS)
def test_cores(name: str) -> None:
    control, roots, generator = CONTROLS[name], traced(name), random.Random(0)
    graph = Graph(exact=False)
    outputs = lowered(graph, [Output("state_o", f"{k}", 0, 40, node) for k, node in enumerate(roots)], XC7)
    for _ in range(20):
        state, action = posed(control, generator)
        inputs = {"action": action, **{f"s{k}": word for k, word in enumerate(state)}}
        found = values([output.node for output in outputs], inputs)
        due = fielded(control, reference(control, state, action))
        assert all((found[o.node] - x) % (1 << 40) == 0 for o, x in zip(outputs, due, strict=True))
    multipliers = sum(node.op == "mul" for node in in_order([output.node for output in outputs]))
    print(f"{name}: {multipliers} multipliers of 24 by 17 bits")
