"""An author's golden functions as functions of words, one after the other, as hardware and kernels have them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from pearl_marl.errors import ArgumentError
from pearl_marl.fields import Field
from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Layout, leaves
from pearl_marl.places import place_of


class Positional(NamedTuple):
    """The same functions over words::

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
    flat, draws_of = state.flat, Draws

    def initial(*draws: Word) -> tuple[Word, ...]:
        return tuple(flat(function(draws_of(draws))))

    return _as(function, initial, "draws")


def step_of(state: Layout, function: GoldenFunction, agents: int, fields: int = 1) -> GoldenFunction:
    """Return ``step(state, action, draws)`` as a function of words; an action has so many fields."""
    count, flat, built, draws_of, taken = len(state.fields), state.flat, state.built, Draws, _outcome
    given = agents * fields

    def step(*words: Word) -> tuple[Word, ...]:
        own = words[count : count + given]
        actions = own if fields == 1 else [own[k : k + fields] for k in range(0, given, fields)]
        action = actions if agents > 1 else actions[0]
        result = function(built(words[:count]), action, draws_of(words[count + given :]))
        after, rewards, ends = taken(result, agents)
        return (*flat(after), *rewards, *ends)

    return _as(function, step, "state", "actions" if agents > 1 else "action", "draws")


def view_of(state: Layout, function: GoldenFunction, agents: int) -> GoldenFunction:
    """Return ``observe(state[, agent])``, or ``masks``, as a function of words."""
    count, built, words_of = len(state.fields), state.built, leaves

    def view(*words: Word) -> tuple[Word, ...]:
        return tuple(words_of(function(built(words[:count]), *words[count:])))

    return _as(function, view, "state", *["agent"] * (agents > 1))


def unpack_of(view: type | None, function: GoldenFunction, words: Iterable[Field]) -> GoldenFunction:
    """Return ``unpack(seen, row)``, which takes an object of a class, as a function of words and a row.

    Arrays are tuples there, as Numba wants them. What takes words already is returned as it is.
    """
    if view is None or len(inspect.signature(function).parameters) != 2:
        return _called_with(function, *(word.name for word in words), "row")
    scope: dict[str, Any] = {"function": function, "__name__": function.__module__}
    names = [f"word_{word.name}" for word in words]  # whatever else a field is named like
    seen = _written(Layout(view).built(names), scope)
    exec(f"def unpack({', '.join(names)}, row):\n    function({seen}, row)", scope)
    unpack: GoldenFunction = scope["unpack"]
    return unpack


def _written(value: Any, scope: dict[str, Any]) -> str:
    """Return the expression that makes an object of the words that it holds the names of."""
    if isinstance(value, str):
        return value
    kind = type(value)
    if not isinstance(value, (list, tuple)):
        raise ArgumentError(f"unpack() takes a {kind.__name__}; Numba knows NamedTuples only")
    parts = "".join(f"{_written(part, scope)}, " for part in value)
    if kind is list:
        return f"({parts})"
    name = f"class_{len(scope)}"
    scope[name] = kind
    return f"{name}({parts})"


def _outcome(result: Any, agents: int) -> tuple[Any, list[Word], list[Word]]:
    """Return state, rewards and ends of what a step returned."""
    if not isinstance(result, tuple) or len(result) != 3:
        shown = f"{len(result)} values" if isinstance(result, tuple) else "one value"
        raise ArgumentError(f"step() returns {shown}; it returns a state, a reward and whether it terminated")
    after, *others = result
    if agents == 1:
        return after, [others[0]], [others[1]]
    for what, values in zip(("rewards", "flags of termination"), others, strict=True):
        if not isinstance(values, (tuple, list)) or len(values) != agents:
            raise ArgumentError(f"step() returns {values!r} for its {what}; there are {agents} agents")
    return after, list(others[0]), list(others[1])


def _as(function: GoldenFunction, wrapper: Callable[..., Any], *given: str) -> GoldenFunction:
    """Return a wrapper that messages name like the function in it."""
    if not inspect.isfunction(function):
        raise ArgumentError(f"{function!r} is no plain Python function, and a golden function is one")
    _called_with(function, *given)
    wrapper.__name__, wrapper.__module__ = function.__name__, function.__module__
    wrapper.author = function  # type: ignore[attr-defined]
    return wrapper


def _called_with(function: GoldenFunction, *given: str) -> GoldenFunction:
    """Return a function, which takes these arguments."""
    try:
        inspect.signature(function).bind(*given)
    except TypeError as error:
        code = getattr(function, "py_func", function).__code__
        raise ArgumentError(
            f"{place_of(code.co_filename, code.co_firstlineno)}: {function.__name__}() is called with "
            f"({', '.join(given)}): {error}"
        ) from None
    return function
