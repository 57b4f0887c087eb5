"""An author's golden functions as functions of words in the order of fields, as hardware has them."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from pearl_marl.base.source_lines import source_line
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.golden.reals import Real, admitted
from pearl_marl.golden.reals.choices import Choice, stored
from pearl_marl.golden.reals.words import rounded
from pearl_marl.layout import Field, Layout, leaves


class Positional(NamedTuple):
    """The same functions over words.

    ::

        initial(*reset_draws)              -> *state
        step(*state, *actions, *step_draws) -> *next_state, *rewards, *terminated
        observe(*state[, agent])           -> *observation
        masks(*state[, agent])             -> a flag for each action
        unpack(*observation, row)

    Each but ``unpack`` returns a tuple.
    """

    initial: GoldenFunction
    step: GoldenFunction
    observe: GoldenFunction
    masks: GoldenFunction | None
    unpack: GoldenFunction | None


def initial_of(state: Layout, function: GoldenFunction) -> GoldenFunction:
    """Return ``initial(draws)`` as a function of draws."""
    flat, draws_of, fraction = state.flat, Draws, state.fraction

    def initial(*draws: Word) -> tuple[Word, ...]:
        return tuple(flat(function(draws_of(draws, fraction))))

    return _as(state.fraction, function, initial, "draws")


def step_of(
    state: Layout,
    function: GoldenFunction,
    agents: int,
    action: Sequence[Field],
    reward: Field,
    *,
    world: bool,
) -> GoldenFunction:
    """Return ``step(state, action, draws)`` as a function of words, given fields of actions and rewards."""
    call = _Step(state, agents, action, reward, world)

    def step(*words: Word) -> tuple[Word, ...]:
        return call.words(function(*call.arguments(words)))

    return _as(state.fraction, function, step, "state", "actions" if world else "action", "draws")


class _Step:
    """What a step takes and returns, made of words and into words."""

    def __init__(
        self, state: Layout, agents: int, action: Sequence[Field], reward: Field, world: bool
    ) -> None:
        self.state, self.agents, self.action, self.reward, self.world = state, agents, action, reward, world
        self.count, self.end = len(state.fields), len(state.fields) + agents * len(action)
        # Beside reals, a reward of their fraction is one: its integers are whole numbers, not parts.
        self.has_real_reward = state.fraction is not None and reward.fraction == state.fraction
        self.has_real_actions = state.fraction is not None and any(field.fraction for field in action)

    def arguments(self, words: Sequence[Word]) -> tuple[Any, Any, Draws]:
        """Return state, action or actions, and draws."""
        numbers, fields = list(words[self.count : self.end]), len(self.action)
        if self.has_real_actions:
            numbers = [self._number(word, self.action[k % fields]) for k, word in enumerate(numbers)]
        if fields > 1:
            numbers = [tuple(numbers[k : k + fields]) for k in range(0, len(numbers), fields)]
        draws = Draws(words[self.end :], self.state.fraction)
        return self.state.built(words[: self.count]), numbers if self.world else numbers[0], draws

    def words(self, result: Any) -> tuple[Word, ...]:
        """Return the words of a state, rewards and flags of termination."""
        if not isinstance(result, tuple) or len(result) != 3:
            shown = f"{len(result)} values" if isinstance(result, tuple) else "one value"
            raise ArgumentError(
                f"step() returns {shown}; it returns a state, a reward and whether it terminated"
            )
        after, *others = result
        if not self.world:
            others = [[other] for other in others]
        for what, values in zip(("rewards", "flags of termination"), others, strict=True):
            if not isinstance(values, (tuple, list)) or len(values) != self.agents:
                raise ArgumentError(
                    f"step() returns {values!r} for its {what}; there are {self.agents} agents"
                )
        rewards, ends = others
        return (*self.state.flat(after), *map(self._reward, rewards), *ends)

    def _number(self, word: Word, field: Field) -> Any:
        """Return an action's number: a real, where the field has a fraction."""
        fraction = self.state.fraction
        if fraction is None or not field.fraction:
            return word
        by = fraction - field.fraction
        return Real(word << by if by >= 0 else rounded(word, -by), fraction)

    def _reward(self, number: Any) -> Word:
        """Return the word of a reward; a real saturates."""
        field = self.reward
        if self.has_real_reward:
            return stored(number, field.low, field.high, field.fraction)
        if number.__class__ is int or not isinstance(number, (Real, Choice, float)):
            return number
        if isinstance(number, Real) or not field.fraction:
            raise ArgumentError(
                "step() returns a real for its reward, and the spec has integers there; "
                "reward=Real[low, high] takes reals"
            )
        return stored(number, field.low, field.high, field.fraction)


def view_of(
    state: Layout, function: GoldenFunction, agents: int, view: Layout | None = None, *, world: bool
) -> GoldenFunction:
    """Return ``observe(state[, agent])``, or ``masks``, as a function of words."""
    words_of = leaves if view is None or view.fraction is None else view.flat
    count, built, alone = len(state.fields), state.built, (0,) * (world and agents == 1)

    def observed(*words: Word) -> tuple[Word, ...]:
        return tuple(words_of(function(built(words[:count]), *words[count:], *alone)))

    return _as(state.fraction, function, observed, "state", *["agent"] * world)


def act_of(
    view: Layout | None, function: GoldenFunction, count: int, action: Sequence[Field], fraction: int | None
) -> GoldenFunction:
    """Return ``act(view, draws)`` as a function of an observation's ``count`` words and of draws."""
    call = _Act(view, count, action, fraction)

    def act(*words: Word) -> tuple[Word, ...]:
        return call.words(function(*call.arguments(words)))

    return _as(fraction, function, act, "view", "draws")


class _Act(NamedTuple):
    """What a policy takes and returns, made of words and into words."""

    view: Layout | None
    words_seen: int
    action: Sequence[Field]
    fraction: int | None

    def arguments(self, words: Sequence[Word]) -> tuple[Any, Draws]:
        """Return what is seen and draws."""
        return view_from(self.view, words[: self.words_seen]), Draws(words[self.words_seen :], self.fraction)

    def words(self, chosen: Any) -> tuple[Word, ...]:
        """Return the words of an action; a real saturates."""
        numbers = tuple(chosen) if isinstance(chosen, (tuple, list)) else (chosen,)
        if self.fraction is None or len(numbers) != len(self.action):  # which is refused
            return numbers
        return tuple(
            stored(number, field.low, field.high, field.fraction) if field.fraction else number
            for number, field in zip(numbers, self.action, strict=True)
        )


def view_from(view: Layout | None, words: Sequence[Word]) -> Any:
    """Return what ``act()`` is given: an object of the view, or without one the word, or a tuple of words."""
    if view is not None:
        return view.built(words)
    return words[0] if len(words) == 1 else tuple(words)


def takes_agent(observe: GoldenFunction) -> bool:
    """Return whether a function observes an agent of a world, even where it is the only one."""
    return inspect.isfunction(observe) and observe.__code__.co_argcount == 2


def unpack_of(view: type | None, function: GoldenFunction, words: Iterable[Field]) -> GoldenFunction:
    """Return ``unpack(view, row)``, which takes an object of a class, as a function of words and a row.

    Arrays are tuples there, as Numba wants them. What takes words already is returned as it is.
    """
    if not _unpacks_object(view, function):
        return _called_with(function, *(word.name for word in words), "row")
    assert view is not None
    scope: dict[str, Any] = {"function": function, "__name__": function.__module__}
    names = [f"word_{word.name}" for word in words]  # whatever else a field is named like
    written = _written(Layout(view).built(names), scope)
    exec(f"def unpack({', '.join(names)}, row):\n    function({written}, row)", scope)
    unpack: GoldenFunction = scope["unpack"]
    return unpack


def row_of(unpack: GoldenFunction, size: int) -> GoldenFunction:
    """Return ``unpack(*words, row)`` as a function of words that returns its row of so many elements."""
    names = ", ".join(f"word_{k}" for k in range(len(inspect.signature(unpack).parameters) - 1))
    scope: dict[str, Any] = {"function": unpack, "size": size, "__name__": unpack.__module__}
    lines = (
        f"def shown({names}):",
        "    row = [0] * size",
        f"    function({names}, row)",
        "    return tuple(row)",
    )
    exec("\n".join(lines), scope)
    shown: GoldenFunction = scope["shown"]
    return shown


UNPACKED_FRACTION = 16
"""Bits behind the binary point of the integers that :func:`in_fixed_point` makes of floats."""


def in_fixed_point(unpack: GoldenFunction, floats: np.dtype[Any]) -> GoldenFunction:
    """Return ``unpack`` for a row of integers as wide as the floats that it writes.

    They are in units of ``2**-UNPACKED_FRACTION``, rounded to the nearest. Floats beyond what fits are cut,
    and NaN becomes 0.
    """
    one = 2.0**UNPACKED_FRACTION
    most = 2.0 ** (8 * floats.itemsize - 1) / one - 1
    scope: dict[str, Any] = {
        "function": unpack,
        "floats_of": floats.type,
        "floor": math.floor,
        "one": one,
        "most": most,
        "__name__": unpack.__module__,
    }
    words = "".join(f"word_{k}, " for k in range(len(inspect.signature(unpack).parameters) - 1))
    # Floats are written in the row's own bytes, each of which its integer then takes.
    lines = (
        f"def unpack({words}row):",
        "    numbers = row.view(floats_of)",
        f"    function({words}numbers)",
        "    for k in range(len(row)):",
        "        number = numbers[k]",
        "        row[k] = floor(min(max(number, -most), most) * one + 0.5) if number == number else 0",
    )
    exec("\n".join(lines), scope)
    result: Any = scope["unpack"]
    original = getattr(unpack, "plain", unpack)

    @functools.wraps(unpack)  # it takes as many arguments
    def plain(*words: Any) -> None:
        numbers = np.empty(len(words[-1]), floats)
        original(*words[:-1], numbers)
        exact = np.nan_to_num(numbers.astype(np.float64), nan=0.0).clip(-most, most)
        words[-1][:] = np.floor(exact * one + 0.5)

    result.plain = plain
    return cast(GoldenFunction, result)


def plain_unpack_of(view: type | None, function: GoldenFunction) -> GoldenFunction:
    """Return what :func:`unpack_of` does without any generated code, for the device that checks that code."""
    plain: GoldenFunction = getattr(function, "plain", function)
    if not _unpacks_object(view, plain):
        return plain
    built = Layout(view).built  # type: ignore[arg-type]

    def unpack(*words: Any) -> None:
        plain(built(words[:-1]), words[-1])

    return unpack


def _unpacks_object(view: type | None, function: GoldenFunction) -> bool:
    """Return whether an author's ``unpack`` takes an object of the view's class rather than words."""
    return view is not None and len(inspect.signature(function).parameters) == 2


def _written(value: Any, scope: dict[str, Any]) -> str:
    """Return the expression that makes an object of the words that it holds the names of."""
    if isinstance(value, str):
        return value
    if isinstance(value, int):  # a word of no bits
        return str(value)
    kind = type(value)
    if not isinstance(value, (list, tuple)):
        raise ArgumentError(f"unpack() takes a {kind.__name__}; Numba knows NamedTuples only")
    parts = "".join(f"{_written(part, scope)}, " for part in value)
    if kind is list:
        return f"({parts})"
    name = f"class_{len(scope)}"
    scope[name] = kind
    return f"{name}({parts})"


def _as(
    fraction: int | None, function: GoldenFunction, wrapper: Callable[..., Any], *given: str
) -> GoldenFunction:
    """Return a wrapper that messages name like the function in it."""
    if not inspect.isfunction(function):
        raise ArgumentError(f"{function!r} is no plain Python function, and a golden function is one")
    _called_with(function, *given)
    wrapper.__name__, wrapper.__module__ = function.__name__, function.__module__
    wrapper.author = function  # type: ignore[attr-defined]
    if fraction is not None:
        wrapper.admits = admitted  # type: ignore[attr-defined]
    return wrapper


def _called_with(function: GoldenFunction, *given: str) -> GoldenFunction:
    """Return a function, which takes these arguments."""
    try:
        inspect.signature(function).bind(*given)
    except TypeError as error:
        code = getattr(function, "py_func", function).__code__
        raise ArgumentError(
            f"{source_line(code.co_filename, code.co_firstlineno)}: {function.__name__}() is called with "
            f"({', '.join(given)}): {error}"
        ) from None
    return function
