"""What the author of an environment is told when the spec is built, and where."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from random import randint
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from pearl_marl.errors import ArgumentError
from pearl_marl.golden import i8, u8, uniform_below
from pearl_marl.spec import EnvSpec, Field, Golden

POINTS = (0, 1, 3)


def initial(draw: Any) -> Any:
    return uniform_below(draw, 10), 0


def step(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return np.minimum(level + action, 10), debt, POINTS[0], level == 10


def observe(level: Any, debt: Any) -> Any:
    return level, debt


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
        state=(Field("level", 4), Field("debt", 8, signed=True)),
        action=Field("valve", 2),
        observation=(Field("level", 4), Field("debt", 8, signed=True)),
        reward=Field("points", 2),
        rewards=(0.0, 1.0, 5.0),
        observation_space=Box(-128, 127, (2,), np.int16),
        action_space=Discrete(4),
        golden=Golden(initial, step, observe),
        reset_draws=1,
        step_draws=1,
        **other,
    )


def test_a_good_one_is_accepted() -> None:
    assert spec().name == "Pump"


def branch(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    if level > 3:
        return 0, 0, 0, 0
    return level, debt, 0, 0


def floating(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return level, debt * 0.5, 0, 0


def a_word_too_few(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return level, debt, 0


def undefined(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return levle, debt, 0, 0  # type: ignore[name-defined]  # noqa: F821


def rolls(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return level, random.randint(0, 3), 0, 0


def rolls_by_name(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return level, randint(0, 3), 0, 0


def of_numpy(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return level, np.random.randint(3), 0, 0  # noqa: NPY002


def no_draw(level: Any, debt: Any, action: Any) -> Any:
    return level, debt, 0, 0


def overflowing(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return level + action, debt, 0, 0


def underflowing(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return level, debt - action, 0, 0


def of_a_byte(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return u8(level + action), i8(debt - 1), 0, 0


def rare(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return level + (draw == 123456789), debt, 0, 0


def never(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return (draw * draw + draw) % 2 * 16, debt, 0, 0


def beyond_the_table(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return level, debt, action, 0


def ended_twice(level: Any, debt: Any, action: Any, draw: Any) -> Any:
    return level, debt, 0, (level == 0) + (debt == 0)


WRONG: dict[Callable[..., Any], str] = {
    branch: "a word decides what Python does next",
    floating: "0.5 is a float; golden functions work on integers",
    undefined: "NameError: name 'levle' is not defined",
    rolls: "golden functions cannot use random.randint; random draws come as arguments",
    rolls_by_name: "golden functions cannot use randint; random draws come as arguments",
    of_numpy: "golden functions have no np.random",
    overflowing: "overflowing() returns 0 to 18 for level, and 4 bits hold 0 to 15; "
    "for example 16, where level is 13 and action is 3; "
    "np.clip keeps it in, and `& 15` lets it wrap around",
    underflowing: "underflowing() returns -131 to 127 for debt, and 8 bits hold -128 to 127; "
    "for example -129, where debt is -128 and action is 1; "
    "np.clip keeps it in, and `i8()` lets it wrap around",
    of_a_byte: "of_a_byte() returns 0 to 18 for level, and 4 bits hold 0 to 15",
    rare: "for example 16, where level is 15 and draw is 123456789;",
    never: "never() returns 0 to 16 for level, and 4 bits hold 0 to 15; trying found no example",
    beyond_the_table: "beyond_the_table() returns 0 to 3 for points, and the table of rewards lists 0 to 2; "
    "for example 3, where action is 3; add a reward, or change the category",
    ended_twice: "ended_twice() returns 0 to 2 for terminated, and 1 bit holds 0 to 1; "
    "for example 2, where level is 0 and debt is 0",
}


@pytest.mark.parametrize("function", WRONG, ids=lambda function: function.__name__)
def test_a_mistake_is_told_where_it_is(function: Callable[..., Any]) -> None:
    with pytest.raises(ArgumentError, match=re.escape(WRONG[function])) as found:
        spec(step=function)
    file, line = "tests/test_golden_checks.py", function.__code__.co_firstlineno
    assert str(found.value).startswith((f"{file}, line {line + 1}: ", f"{file}, line {line}: "))
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("functions", "words"),
    [
        (
            {"step": a_word_too_few},
            "a_word_too_few() returns 3 words, and the spec takes 4: level, debt, points and terminated",
        ),
        (
            {"step": no_draw},
            "no_draw() is called with 4 words, level, debt, action and draw_0: too many positional arguments",
        ),
        ({"observe": initial}, "initial() is called with 2 words, level and debt: too many positional"),
        ({"observe": lambda *state: state[0]}, "<lambda>() returns 1 word, and the spec takes 2: level and"),
        ({"initial": lambda draw: (draw, 0)}, "returns 0 to 4294967295 for level"),
        ({"initial": np.sin}, "<ufunc 'sin'> is no plain Python function"),
    ],
)
def test_what_does_not_suit_the_spec_is_told(functions: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape(words)):
        spec(**functions)


def test_an_option_that_goes_wrong_is_told() -> None:
    """Every choice of options is a spec of its own."""

    def configure(most: int = 10) -> EnvSpec:
        def step(level: Any, debt: Any, action: Any, draw: Any) -> Any:
            return np.minimum(level + action, most), debt, 0, 0

        return spec(step=step, options={"most": most}, configure=configure)

    assert configure().with_options(most=15).options == {"most": 15}
    with pytest.raises(
        ArgumentError, match=r"returns 0 to 16 for level.* where level is 1\d and action is \d"
    ):
        configure().with_options(most=16)
