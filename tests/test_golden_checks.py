"""What the author of an environment is told when the spec is built, and where."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from random import randint
from typing import Any, NamedTuple

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from pearl_marl.errors import ArgumentError
from pearl_marl.golden import Draws, call_reference, i8, u8
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import values
from pearl_marl.golden.tracing.trace import trace
from pearl_marl.layout import Bits, Real, Signed
from pearl_marl.spec import EnvSpec, Field, Golden

POINTS = (0, 1, 3)


class State(NamedTuple):
    level: Bits[4]
    debt: Signed[8]


def initial(draws: Draws) -> State:
    return State(draws.below(10), 0)


def step(state: State, action: Any, draws: Draws) -> Any:
    level = min(state.level + action, 10)
    return State(level, state.debt), POINTS[0], level == 10


def observe(state: State) -> State:
    return state


def spec(
    initial: Callable[..., Any] = initial,
    step: Callable[..., Any] = step,
    observe: Callable[..., Any] = observe,
    **other: Any,
) -> EnvSpec:
    """Return an environment with the golden functions that a test gives."""
    return EnvSpec(
        name="Pump",
        version=0,
        summary="Fill a tank",
        action=Field("valve", 2),
        reward=Field("points", 2),
        rewards=(0.0, 1.0, 5.0),
        observation_space=Box(-128, 127, (2,), np.int16),
        action_space=Discrete(4),
        golden=Golden(State, initial, step, observe, view=State),
        **other,
    )


def test_a_good_one_is_accepted() -> None:
    assert spec().name == "Pump"


def floating(state: State, action: Any, draws: Draws) -> Any:
    return State(state.level, state.debt * 0.5), 0, 0


def undefined(state: State, action: Any, draws: Draws) -> Any:
    return State(state.levle, state.debt), 0, 0  # type: ignore[attr-defined]


def rolls(state: State, action: Any, draws: Draws) -> Any:
    return State(state.level, random.randint(0, 3)), 0, 0


def rolls_by_name(state: State, action: Any, draws: Draws) -> Any:
    return State(state.level, randint(0, 3)), 0, 0


def of_numpy(state: State, action: Any, draws: Draws) -> Any:
    return State(state.level, np.random.randint(3)), 0, 0  # noqa: NPY002


def overflowing(state: State, action: Any, draws: Draws) -> Any:
    return State(state.level + action, state.debt), 0, 0


def underflowing(state: State, action: Any, draws: Draws) -> Any:
    return State(state.level, state.debt - action), 0, 0


def of_a_byte(state: State, action: Any, draws: Draws) -> Any:
    return State(u8(state.level + action), i8(state.debt - 1)), 0, 0


def rare(state: State, action: Any, draws: Draws) -> Any:
    return State(state.level + (draws.bits() == 123456789), state.debt), 0, 0


def never(state: State, action: Any, draws: Draws) -> Any:
    draw = draws.bits()
    return State((draw * draw + draw) % 2 * 16, state.debt), 0, 0


def beyond_the_table(state: State, action: Any, draws: Draws) -> Any:
    return State(state.level, state.debt), action, 0


def rewarded_by_half(state: State, action: Any, draws: Draws) -> Any:
    return State(state.level, state.debt), 0.5, 0


def ended_twice(state: State, action: Any, draws: Draws) -> Any:
    return State(state.level, state.debt), 0, (state.level == 0) + (state.debt == 0)


WRONG: dict[Callable[..., Any], str] = {
    floating: "0.5 is a float; golden functions work on integers",
    undefined: "AttributeError: 'State' object has no attribute 'levle'",
    rolls: "golden functions cannot use random.randint; ask `draws` for random numbers",
    rolls_by_name: "golden functions cannot use randint; ask `draws` for random numbers",
    of_numpy: "golden functions of integers have no np.random",
    overflowing: "overflowing() returns 0 to 18 for level, and 4 bits hold 0 to 15; "
    "for example 16, where level is 13 and action is 3; "
    "`min` and `max` keep it in, and `& 15` lets it wrap around",
    underflowing: "underflowing() returns -131 to 127 for debt, and 8 bits hold -128 to 127; "
    "for example -129, where debt is -128 and action is 1; "
    "`min` and `max` keep it in, and `i8()` lets it wrap around",
    of_a_byte: "of_a_byte() returns 0 to 18 for level, and 4 bits hold 0 to 15",
    rare: "for example 16, where level is 15 and draw_0 is 123456789;",
    never: "never() returns 0 to 16 for level, and 4 bits hold 0 to 15; trying found no example",
    beyond_the_table: "beyond_the_table() returns 0 to 3 for points, and the table of rewards lists 0 to 2; "
    "for example 3, where action is 3; add a reward, or change the category",
    rewarded_by_half: "step() returns a real for its reward, and the spec has integers there; reward=Real",
    ended_twice: "ended_twice() returns 0 to 2 for terminated, and 1 bit holds 0 to 1; "
    "for example 2, where level is 0 and debt is 0",
}


@pytest.mark.parametrize("function", WRONG, ids=lambda function: function.__name__)
def test_a_mistake_is_told_where_it_is(function: Callable[..., Any]) -> None:
    with pytest.raises(ArgumentError, match=re.escape(WRONG[function])) as found:
        spec(step=function)
    file, line = "tests/test_golden_checks.py", function.__code__.co_firstlineno
    assert str(found.value).startswith(tuple(f"{file}, line {line + k}: " for k in range(3)))
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("functions", "words"),
    [
        (
            {"step": lambda state, action, draws: (state, 0)},
            "step() returns 2 values; it returns a state, a rew",
        ),
        (
            {"step": lambda state, action, draws: action},
            "step() returns one value; it returns a state, a reward",
        ),
        ({"step": lambda state, action, draws: ((0, 0), 0, 0)}, "a State is due, and a tuple of 2"),
        (
            {"step": lambda state, action: (state, 0, 0)},
            "is called with (state, action, draws): too many positi",
        ),
        ({"observe": initial}, "'State' object has no attribute 'below'"),
        (
            {"observe": lambda state: state.level},
            "<lambda>() returns 1 word, and the spec takes 2: level and",
        ),
        ({"initial": lambda draws: State(draws.bits(), 0)}, "returns 0 to 4294967295 for level"),
        ({"initial": lambda draws: State([0], 0)}, "State.level is a list of 1; it must be one word"),
        ({"initial": np.sin}, "<ufunc 'sin'> is no plain Python function"),
    ],
)
def test_what_does_not_suit_the_spec_is_told(functions: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape(words)):
        spec(**functions)


def test_an_option_that_goes_wrong_is_told() -> None:
    """Every choice of options is a spec of its own."""

    def configure(most: int = 10) -> EnvSpec:
        def step(state: State, action: Any, draws: Draws) -> Any:
            return State(min(state.level + action, most), state.debt), 0, 0

        return spec(step=step, options={"most": most}, configure=configure)

    assert configure().with_options(most=15).options == {"most": 15}
    with pytest.raises(
        ArgumentError, match=r"returns 0 to 16 for level.* where level is 1\d and action is \d"
    ):
        configure().with_options(most=16)


class Cart(NamedTuple):
    x: Real[-4, 4]


def pushed(state: Cart, action: Any, draws: Draws) -> Any:
    if action == 1:
        return Cart(1), 1, 0
    if action == 2:
        return Cart(state.x), action, 0
    return Cart(action), state.x, 0


def test_integers_are_numbers_where_reals_are_due() -> None:
    """Not the words of such: 1 is 1.0, in a state and for a reward, whether others are reals or not."""
    cart = EnvSpec(
        name="Cart",
        version=0,
        summary="Push a cart",
        observation_space=Box(-4, 4, (1,), np.float32),
        action_space=Discrete(4),
        rewards=None,
        reward=Real[-4, 4],
        golden=Golden(Cart, lambda draws: Cart(1), pushed, lambda state: state, view=Cart),
    )
    one, graph = 1 << 28, Graph()
    assert [int(word) for word in call_reference(cart.positional.initial, ())] == [one]
    step = cart.positional.step
    nodes = trace(graph, step, [graph.input("x", 32, True), graph.input("action", 2)])
    due = [[0, 7, 0], [one, one, 0], [7, 2 * one, 0], [3 * one, 7, 0]]
    for action, words in enumerate(due):
        found = values(nodes, {"x": 7, "action": action})
        assert [found[node] for node in nodes] == words
        assert [int(word) for word in call_reference(step, (7, action))] == words
