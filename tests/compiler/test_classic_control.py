"""Gymnasium's classic control over reals: how near a step is to Gymnasium's, and what its graph takes."""

from __future__ import annotations

import functools
import math
import random
from typing import Any

import gymnasium
import numpy as np
import pytest
from pearl_marl.envs.cart_pole import step as cart_pole_step
from pearl_marl.envs.mountain_car import step as mountain_car_step
from pearl_marl.envs.pendulum import step as pendulum_step

from pearl_marl.errors import ArgumentError
from pearl_marl.reals import Real, admitted, stored
from pearl_marl.reals.numbers import constant
from pearl_marl.tracing.graph import Graph
from pearl_marl.tracing.nodes import Node, in_order, values
from pearl_marl.tracing.trace import trace
from pearl_marl.tracing.words import Word
from tests import classic_control
from tests.classic_control import ANGLE, CONTROLS, STAGE_1, STAGE_2, Control, dsdt, moved

IDS = {
    "CartPole": "CartPole-v1",
    "MountainCar": "MountainCar-v0",
    "Pendulum": "Pendulum-v1",
    "Acrobot": "Acrobot-v1",
}


def fielded(control: Control, results: Any) -> list[Any]:
    """The words of a step: of its fields, and of what else it returns."""
    bounds = [*control.bounds, *[(-64.0, 64.0)] * (len(results) - len(control.bounds))]
    return [stored(x, *ends, control.fraction) for x, ends in zip(results, bounds, strict=True)]


@functools.cache
def traced(name: str) -> list[Node]:
    """The words that an environment's step returns, of inputs that are within their fields."""
    control, graph = CONTROLS[name], admitted(Graph())

    def real(name: str, ends: tuple[float, float]) -> Real:
        node = graph.input(name, 32, signed=True)
        low, high = (constant(end, control.fraction) for end in ends)
        return Real(Word(graph, graph.within(node, low, high)), control.fraction)

    state = [real(f"s{k}", ends) for k, ends in enumerate(control.bounds)]
    action: Any
    if control.action:
        action = real("action", control.action)
    else:
        action = Word(graph, graph.within(graph.input("action", 2), 0, control.actions - 1))
    return [word.node for word in fielded(control, control.step(state, action))]


def posed(control: Control, generator: random.Random) -> tuple[list[int], int]:
    """A random state and an action, as words."""

    def word(ends: tuple[float, float]) -> int:
        return generator.randint(*(constant(end, control.fraction) for end in ends))

    action = word(control.action) if control.action else generator.randrange(control.actions)
    return [word(ends) for ends in control.bounds], action


def reference(control: Control, state: list[int], action: int) -> list[Any]:
    """What the step returns of Python's integers."""
    given = Real(action, control.fraction) if control.action else action
    return list(control.step([Real(word, control.fraction) for word in state], given))


@pytest.mark.parametrize("name", CONTROLS)
def test_a_step_is_the_same_traced(name: str) -> None:
    control, roots, generator = CONTROLS[name], traced(name), random.Random(0)
    for _ in range(40):
        state, action = posed(control, generator)
        inputs = {"action": action, **{f"s{k}": word for k, word in enumerate(state)}}
        found = values(roots, inputs)
        assert all(node.low <= value <= node.high and node.bits <= 64 for node, value in found.items())
        assert [found[root] for root in roots] == fielded(control, reference(control, state, action))


def gymnasiums(name: str, env: Any, state: list[float], action: Any) -> tuple[list[float], float, bool]:
    """The state, the reward and the end that Gymnasium's step makes of a state."""
    env.reset()
    env.unwrapped.state = tuple(state) if name == "MountainCar" else np.array(state)
    _, reward, terminated, *_ = env.unwrapped.step(action)
    return [float(x) for x in env.unwrapped.state], float(reward), terminated


MOST: dict[str, list[float]] = {
    "CartPole": [0.51, 0.6, 0.51, 2.0],
    "MountainCar": [1.1, 1.1],
    "Pendulum": [1.5, 1.5],
    "Acrobot": [50.0, 150.0, 1500.0, 10000.0],
}
"""The greatest error of a step from a random state, in units of the last place of the state's fields."""
MOST_REACHED = {**MOST, "Acrobot": [1.0, 1.0, 3.0, 5.0]}
"""The same from states that random play reaches: Acrobot's are slower."""


def compared(name: str, env: Any, words: list[int], action: int) -> list[float]:
    """Compare a step with Gymnasium's; return how far its fields are off, in units of their last place."""
    control = CONTROLS[name]
    scale = 2.0**control.fraction
    state = [word / scale for word in words]
    given = np.array([action / scale]) if control.action else action
    truth, reward, terminated = gymnasiums(name, env, state, given)
    results = reference(control, words, action)
    if name == "Pendulum":
        assert float(results[-1]) == pytest.approx(reward, abs=5e-8)
    else:
        assert results[-1] == terminated
    errors = []
    for x, y, ends in zip(results[: len(truth)], truth, control.bounds, strict=True):
        error = float(x) - y
        if ends == ANGLE:
            error = (error + math.pi) % (2 * math.pi) - math.pi
        errors.append(abs(error) * scale)
    return errors


def assert_near(name: str, errors: list[list[float]], most: list[float]) -> None:
    worst, scale = np.max(errors, 0), 2.0 ** CONTROLS[name].fraction
    told = ", ".join(f"{x / scale:.1e} ({x:.2f} ulp)" for x in worst)
    print(f"{name}, {len(errors)} states, {CONTROLS[name].fraction} fraction bits: {told}")
    print(f"    median {np.median(errors, 0)} ulp")
    assert (worst < most).all()


@pytest.mark.parametrize("name", CONTROLS)
def test_a_step_from_any_state_is_gymnasiums(name: str) -> None:
    generator, env, errors = random.Random(1), gymnasium.make(IDS[name]), []
    for _ in range(600):
        words, action = posed(CONTROLS[name], generator)
        if name != "Acrobot" or not beyond([word / 2**26 for word in words], action - 1):
            errors.append(compared(name, env, words, action))
    assert len(errors) > 500
    assert_near(name, errors, MOST[name])


@pytest.mark.parametrize("name", CONTROLS)
def test_a_step_from_a_state_that_is_reached_is_gymnasiums(name: str) -> None:
    control, generator, errors = CONTROLS[name], random.Random(2), []
    env, other = gymnasium.make(IDS[name]), gymnasium.make(IDS[name])
    for seed in range(4):
        env.reset(seed=seed)
        for _ in range(100):
            state = [float(x) for x in env.unwrapped.state]
            if name == "Pendulum":
                state[0] = (state[0] + math.pi) % (2 * math.pi) - math.pi
            words = fielded(control, [Real.of(x, control.fraction) for x in state])
            action = posed(control, generator)[1]
            errors.append(compared(name, other, words, action))
            given = np.array([action / 2**control.fraction]) if control.action else action
            if env.step(given)[2]:
                break
    assert_near(name, errors, MOST_REACHED[name])


def beyond(state: list[float], torque: float) -> bool:
    """Whether a step of Acrobot has speeds inside of it that its author binds."""
    k: tuple[float, ...] = (0.0,) * 4
    for dt in (0.0, 0.1, 0.1, 0.2):
        stage = moved(state, k, dt)
        if abs(stage[2]) > STAGE_1 or abs(stage[3]) > STAGE_2:
            return True
        k = dsdt(stage, torque)
    return False


def test_acrobot_has_to_bind_its_speeds_within_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(classic_control, "STAGE_1", 1e9)
    monkeypatch.setattr(classic_control, "STAGE_2", 1e9)
    with pytest.raises(
        ArgumentError, match=r"and reals end at 1\.374e\+11 here, .*; np.clip what it is made of"
    ):
        traced.__wrapped__("Acrobot")


def cost(roots: list[Node]) -> tuple[int, int, int]:
    """Nodes, multiplications and the widest node's bits."""
    order = in_order(roots)
    return len(order), sum(node.op == "mul" for node in order), max(node.bits for node in order)


def by_hand(function: Any, fields: int, *more: tuple[str, int]) -> list[Node]:
    graph = Graph()
    given = [graph.input(f"s{k}", 32, signed=True) for k in range(fields)]
    return trace(graph, function, [*given, *(graph.input(*word) for word in more)])


def test_what_steps_take_against_those_written_by_hand() -> None:
    hand = {
        "CartPole": by_hand(cart_pole_step.step, 4, ("action", 1)),
        "MountainCar": by_hand(mountain_car_step.step(0), 2, ("action", 2)),
        "Pendulum": by_hand(pendulum_step.step(pendulum_step.fall(10.0)), 3),
    }
    for name in CONTROLS:
        found = cost(traced(name))
        print(f"{name}: {found[0]} nodes, {found[1]} multiplications, up to {found[2]} bits")
        if name in hand:
            nodes, multiplications, _ = cost(hand[name])
            print(f"    by hand: {nodes} nodes, {multiplications} multiplications")
            assert found[0] <= 1.2 * nodes
            assert found[1] <= 1.34 * multiplications
