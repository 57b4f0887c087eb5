"""Gymnasium's classic control over reals: how near a step is to Gymnasium's, and what its graph takes."""

from __future__ import annotations

import functools
import math
import random
from typing import Any
from unittest import mock

import gymnasium
import numpy as np
import pytest

from pearl_marl import envs
from pearl_marl.envs import get_spec
from pearl_marl.envs.acrobot import step as acrobot
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import GoldenFunction, call_reference
from pearl_marl.golden.reals.numbers import constant
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node, in_order, values
from pearl_marl.golden.tracing.trace import trace
from pearl_marl.spec import EnvSpec, Field

with mock.patch.dict(envs._specs):
    from examples.reals import SPECS

ENVIRONMENTS = {spec.name.removeprefix("Real"): spec for spec in SPECS}
ENVIRONMENTS |= {name: get_spec(name) for name in ("Acrobot", "MountainCarContinuous")}
EXAMPLES = [name for name, spec in ENVIRONMENTS.items() if spec in SPECS]
"""Those whose accuracy is measured here; `tests/envs` measures the others'."""


def inputs(spec: EnvSpec) -> list[Field]:
    """Return the fields of what a step takes."""
    return [*spec.state, *spec.action_fields]


@functools.cache
def traced(function: GoldenFunction, *fields: Field) -> list[Node]:
    """Return the words that a function makes of inputs within these fields."""
    graph = Graph()
    return trace(graph, function, [graph.input(f.name, f.bits, f.signed, *f.range) for f in fields])


def posed(spec: EnvSpec, generator: random.Random) -> list[int]:
    """Return the words of a random state and of an action."""
    ends = [field.range for field in inputs(spec)]
    if spec.action_counts:
        ends[-1] = (0, spec.action_counts[0] - 1)
    return [generator.randint(*pair) for pair in ends]


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_functions_are_the_same_traced(name: str) -> None:
    spec, generator = ENVIRONMENTS[name], random.Random(0)
    for function, fields in (
        (spec.positional.step, inputs(spec)),
        (spec.positional.observe, list(spec.state)),
    ):
        roots = traced(function, *fields)
        for _ in range(40):
            words = posed(spec, generator)[: len(fields)]
            found = values(roots, {f.name: word for f, word in zip(fields, words, strict=True)})
            assert all(node.low <= value <= node.high and node.bits <= 64 for node, value in found.items())
            assert [found[root] for root in roots] == list(call_reference(function, words))


STARTS = {
    "CartPole": [(-0.05, 0.05)] * 4,
    "MountainCar": [(-0.6, -0.4), (0.0, 0.0)],
    "MountainCarContinuous": [(-0.6, -0.4), (0.0, 0.0)],
    "Pendulum": [(-math.pi, math.pi), (-1.0, 1.0)],
    "Acrobot": [(-0.1, 0.1)] * 4,
}
"""Gymnasium's ranges of what an episode begins with."""


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_episodes_begin_as_gymnasiums(name: str) -> None:
    spec = ENVIRONMENTS[name]
    for end, draw in enumerate((0, (1 << 32) - 1)):
        words = call_reference(spec.positional.initial, [draw] * spec.reset_draws)
        for word, field, ends in zip(words, spec.state, STARTS[name], strict=True):
            assert abs(word - constant(ends[end], field.fraction)) <= 1


def gymnasiums(
    spec: EnvSpec, env: Any, state: list[float], action: Any
) -> tuple[list[float], float, bool, Any]:
    """Return the state, the reward, the end and the observation that Gymnasium's step makes of a state."""
    env.reset()
    env.unwrapped.state = tuple(state) if spec.oracle == "MountainCar-v0" else np.array(state)
    obs, reward, terminated, *_ = env.unwrapped.step(action)
    return [float(x) for x in env.unwrapped.state], float(reward), terminated, obs


MOST: dict[str, list[float]] = {
    "CartPole": [0.51, 0.6, 0.51, 2.0],
    "MountainCar": [1.1, 1.1],
    "Pendulum": [1.5, 1.5],
}
"""The greatest error of a step from a random state, in units of the last place of the state's fields."""


def number(word: int, field: Field) -> float:
    return int(word) / 2.0**field.fraction


def compared(name: str, env: Any, words: list[int]) -> list[float]:
    """Compare a step with Gymnasium's; return how far its fields are off, in units of their last place."""
    spec = ENVIRONMENTS[name]
    *state, action = [number(word, field) for word, field in zip(words, inputs(spec), strict=True)]
    given = int(action) if spec.action_counts else np.array([action])
    truth, reward, terminated, obs = gymnasiums(spec, env, state, given)
    *after, found, end = call_reference(spec.positional.step, words)
    assert end == terminated
    found = number(found, spec.reward) if spec.rewards is None else spec.rewards[found]
    assert found == pytest.approx(reward, abs=5e-8)
    errors, near = [], True
    for word, y, field in zip(after, truth, spec.state, strict=True):
        if field.name == "th":
            error = (number(word, field) - y + math.pi) % (2 * math.pi) - math.pi
        else:
            low, high = (number(end, field) for end in field.range)
            near &= low <= y <= high
            error = number(word, field) - min(max(y, low), high)
        errors.append(abs(error) * 2.0**field.fraction)
    if near:
        words_seen = call_reference(spec.positional.observe, after)
        seen = [number(word, field) for word, field in zip(words_seen, spec.observation, strict=True)]
        assert seen == pytest.approx(obs.tolist(), abs=1e-6)
    return errors


def assert_near(name: str, errors: list[list[float]]) -> None:
    worst, fraction = np.max(errors, 0), ENVIRONMENTS[name].layout.fraction
    assert fraction is not None
    text = ", ".join(f"{x / 2.0**fraction:.1e} ({x:.2f} ulp)" for x in worst)
    print(f"{name}, {len(errors)} states, {fraction} fraction bits: {text}")
    print(f"    median {np.median(errors, 0)} ulp")
    assert (worst < MOST[name]).all()


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_step_from_any_state_is_gymnasiums(name: str) -> None:
    spec, generator, errors = ENVIRONMENTS[name], random.Random(1), []
    env = gymnasium.make(str(spec.oracle))
    for _ in range(600):
        errors.append(compared(name, env, posed(spec, generator)))
    assert_near(name, errors)


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_step_from_a_state_that_is_reached_is_gymnasiums(name: str) -> None:
    spec, generator, errors = ENVIRONMENTS[name], random.Random(2), []
    env: Any = gymnasium.make(str(spec.oracle))
    other = gymnasium.make(str(spec.oracle))
    for seed in range(4):
        env.reset(seed=seed)
        for _ in range(100):
            state = [float(x) for x in env.unwrapped.state]
            if name == "Pendulum":
                state[0] = (state[0] + math.pi) % (2 * math.pi) - math.pi
            words = [constant(x, field.fraction) for x, field in zip(state, spec.state, strict=True)]
            action = posed(spec, generator)[-1]
            errors.append(compared(name, other, [*words, action]))
            real = np.array([number(action, spec.action_fields[0])])
            if env.step(action if spec.action_counts else real)[2]:
                break
    assert_near(name, errors)


def test_acrobot_has_to_bind_its_speeds_within_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = ENVIRONMENTS["Acrobot"]
    monkeypatch.setattr(acrobot, "STAGE_1", 1e9)
    monkeypatch.setattr(acrobot, "STAGE_2", 1e9)
    says = r"acrobot/step\.py, line \d+: .* and reals end at 1\.374e\+11 here, .*; np.clip what it is made of"
    with pytest.raises(ArgumentError, match=says):
        traced.__wrapped__(spec.positional.step, *inputs(spec))


def cost(spec: EnvSpec) -> tuple[int, int, int]:
    """Return the nodes of a step, its multiplications and the bits of its widest node."""
    order = in_order(traced(spec.positional.step, *inputs(spec)))
    return len(order), sum(node.op == "mul" for node in order), max(node.bits for node in order)


def test_what_steps_take_against_those_written_by_hand() -> None:
    for name, spec in ENVIRONMENTS.items():
        found = cost(spec)
        print(f"{name}: {found[0]} nodes, {found[1]} multiplications, up to {found[2]} bits")
        if spec is not get_spec(name):
            nodes, multiplications, _ = cost(get_spec(name))
            print(f"    by hand: {nodes} nodes, {multiplications} multiplications")
            assert found[0] <= 1.2 * nodes
            assert found[1] <= 1.34 * multiplications
