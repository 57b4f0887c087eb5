"""The checks of arguments: what they take, and the message that each refusal gives."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pearl_marl.checks import (
    checked_choice,
    checked_flag,
    checked_function,
    checked_integer,
    checked_number,
)
from pearl_marl.errors import ArgumentError


@pytest.mark.parametrize(
    ("call", "value"),
    [
        (lambda: checked_integer("n", np.int16(7)), 7),
        (lambda: checked_integer("n", 0, 0), 0),
        (lambda: checked_integer("n", -3, -3, -3), -3),
        (lambda: checked_number("x", 2), 2.0),
        (lambda: checked_number("x", np.float32(0.5), 0, 1), 0.5),
        (lambda: checked_number("x", 0, 0, below=1), 0.0),
        (lambda: checked_choice("way", np.str_("up"), ("up", "down")), "up"),
        (lambda: checked_choice("way", None, ("up", None)), None),
        (lambda: checked_flag("loud", True), True),
        (lambda: checked_function("f", len), len),
    ],
)
def test_possible(call: Callable[[], Any], value: Any) -> None:
    assert (result := call()) == value
    if isinstance(value, (int, float)):
        assert type(result) is type(value)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: checked_integer("n", 0), "n is 0; it must be an integer of at least 1"),
        (lambda: checked_integer("n", True), "n is True; it must be an integer of at least 1"),
        (lambda: checked_integer("n", 2.0), "n is 2.0; it must be an integer of at least 1"),
        (lambda: checked_integer("n", "3", 1, 4), "n is '3'; it must be an integer from 1 to 4"),
        (
            lambda: checked_integer("n", 1 << 20, 0, 65535),
            "n is 1048576; it must be an integer from 0 to 65,535",
        ),
        (
            lambda: checked_integer("n", -1, note=" or None"),
            "n is -1; it must be an integer of at least 1 or None",
        ),
        (
            lambda: checked_integer("n", 10**9999, 1, 2),
            "n is of the type int; it must be an integer from 1 to 2",
        ),
        (lambda: checked_number("x", float("nan")), "x is nan; it must be a finite number"),
        (lambda: checked_number("x", False), "x is False; it must be a finite number"),
        (lambda: checked_number("x", 0, above=0), "x is 0; it must be a number above 0"),
        (lambda: checked_number("x", 1, 0, below=1), "x is 1; it must be a number from 0 to below 1"),
        (lambda: checked_number("x", 1.5, 0, 1), "x is 1.5; it must be a number from 0 to 1"),
        (lambda: checked_number("x", 0, above=0, most=9), "x is 0; it must be a number above 0 to 9"),
        (lambda: checked_choice("way", "in", ("up", "down")), "way is 'in'; possible are 'up' and 'down'"),
        (lambda: checked_choice("way", [], {"up": 1}), "way is []; possible are 'up'"),
        (lambda: checked_choice("axis", False, (0, -1)), "axis is False; possible are 0 and -1"),
        (lambda: checked_choice("way", np.array(["up", "x"]), ("up",)), "way is array(['up', 'x']"),
        (lambda: checked_flag("loud", 1), "loud is 1; it must be True or False"),
        (lambda: checked_function("f", 3), "f is 3; it must be a function"),
    ],
)
def test_refused(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=f"^{re.escape(message)}"):
        call()
