"""Which actions may be taken, decided here and nowhere else; and drawing random ones.

:class:`ActionRules` answers for a batch: for a device, which narrows actions to its words as they are
checked; for a batch some of whose agents have left; for a wrapper with a space of its own; and for one agent.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.base.machine_code import compiled
from pearl_marl.batch.step import on_host
from pearl_marl.errors import ActionError
from pearl_marl.golden import uniform_below
from pearl_marl.spec import EnvSpec
from pearl_marl.spec.elements import ActionSpace, bounds


class ActionRules:
    """Which actions the agents of a batch may take.

    Parameters
    ----------
    space, n
        One agent's action space (of roles, the widest), and how many agents there are.
    names
        The names of an action's fields, for messages.
    first_agent
        The number of the first agent, likewise.
    kinds
        The kinds of dtype that arrays of actions may have; by default those of the space.
    """

    def __init__(
        self,
        space: ActionSpace,
        n: int,
        names: Sequence[str] = (),
        first_agent: int = 0,
        kinds: str = "",
    ) -> None:
        self.space, self.shape, self.n = space, space.shape or (), n
        self.kinds = kinds or ("iuf" if isinstance(space, Box) else "iu")
        self._names, self._first = names, first_agent
        self._least = int(space.start) if isinstance(space, Discrete) else bounds(space)[0]

    @classmethod
    def of(cls, spec: EnvSpec, space: ActionSpace, n: int, first_slot: int = 0) -> ActionRules:
        """Return the rules of ``n`` agents of an environment; ``space`` is its action space, or a copy."""
        return cls(space, n, [field.name for field in spec.action_fields], first_slot * spec.agents)

    def are_actions(self, array: npt.NDArray[Any], count: int) -> bool:
        """Return whether an array has the shape and kind of dtype of so many actions."""
        return array.shape == (count, *self.shape) and array.dtype.kind in self.kinds

    def array(self, actions: Sequence[Any]) -> npt.NDArray[Any] | None:
        """Return an array of as many actions, one after the other; ``None`` where they do not make one."""
        try:
            array = np.array(actions)
        except ValueError:  # some are sequences of other lengths
            return None
        return array if self.are_actions(array, len(actions)) else None

    def possible(self, actions: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
        """Return which rows of an array of actions are in the action space, ``bool`` of shape ``(n,)``."""
        low, high = bounds(self.space)
        within: Any = (low <= actions) & (actions <= high)
        if actions.dtype.kind == "f" and not isinstance(self.space, Box):
            within &= actions == np.floor(actions)
        return np.asarray(within if within.ndim == 1 else within.reshape(self.n, -1).all(1))

    def with_idle(self, actions: Any, ignored: npt.NDArray[np.bool_], masks: Any = None) -> Any:
        """Return actions with possible ones where an agent's own is ignored, whatever that is.

        ``ignored`` has an element an action. Where ``masks`` are given, with a row an action, the first that
        they allow stands in. What has not as many actions is returned as it is, to be refused.
        """
        on_cpu = actions.cpu() if hasattr(actions, "cpu") else actions
        try:
            array = np.asarray(on_cpu)
        except (TypeError, ValueError):  # some are sequences of other lengths
            array = None
        idle: Any = self._least if masks is None else on_host(masks).argmax(1)
        if array is not None and self.are_actions(array, len(ignored)):
            if masks is not None:
                idle = idle.astype(array.dtype)
            return np.where(ignored.reshape(-1, *(1,) * len(self.shape)), idle, array)
        if isinstance(on_cpu, np.ndarray):
            fits = on_cpu.shape == (len(ignored), *self.shape)
        else:
            fits = isinstance(on_cpu, (list, tuple)) and len(on_cpu) == len(ignored)
        if not fits:
            return actions
        values = list(on_cpu)
        for row in np.flatnonzero(ignored).tolist():
            values[row] = idle if masks is None else idle[row]
        return values

    def check_one(
        self, row: int, action: Any, space: ActionSpace, masks: npt.NDArray[np.int8] | None = None
    ) -> None:
        """Refuse an action that the agent of a row may not take.

        ``space`` is its role's; ``masks`` are those of all agents, where masked actions are refused.
        """
        if why_not(action, space):
            raise self.refusal_of([f"agent_{self._first + row}"], [action], space)
        if masks is not None:
            refuse_masked(np.array([action]), masks[row : row + 1], self._first + row)

    def refusal(self, actions: Any) -> ActionError:
        """Return the error for a batch of actions that are not all possible."""
        n, whole = self.n, (self.n, *self.shape)
        if actions is None or isinstance(actions, (Mapping, str)):
            what = f"a {type(actions).__name__}" if actions is not None else "None"
            return ActionError(
                f"actions are {what}; {n} agents take an array of shape {whole}, or a dict by agent in "
                "step() of a parallel_env"
            )
        # What was given tells more than the array that NumPy made of it: [0, 1.5] becomes two floats.
        values = actions.tolist() if isinstance(actions, np.ndarray) else actions
        try:
            shape = np.shape(actions)
        except ValueError:  # a ragged list
            shape = (len(actions),)
        if shape != whole:
            return ActionError(f"actions have shape {shape}; {n} agents take {whole}: {limits(self.space)}")
        return self.refusal_of((f"agent_{self._first + i}" for i in range(n)), values)

    def refusal_of(
        self, agents: Iterable[str], actions: Iterable[Any], space: ActionSpace | None = None
    ) -> ActionError:
        """Return the error for actions of some agents that are not all in ``space``, by default that of all.

        It names the first that is not. Where all are, their dtype is what was wrong, and the first stands for
        it.
        """
        space = self.space if space is None else space
        pairs = list(zip(agents, actions, strict=True))
        agent, action = next((pair for pair in pairs if why_not(pair[1], space)), pairs[0])
        why = why_not(action, space, self._names) or "is of the wrong dtype"
        return ActionError(f"{agent}: action {action!r} {why}; {limits(space)}")


def encode(actions: Any, spec: EnvSpec, target: npt.NDArray[Any], first_slot: int = 0) -> npt.NDArray[Any]:
    """Return actions as the device's words: in ``target``, or as they are if they are words already.

    Of an agent with a role the action is in that role's space.

    Parameters
    ----------
    actions
        Integers of shape ``(n,)``, or ``(n, fields)`` where the action space has elements, in a ``Box``
        numbers: an array, or what ``numpy.asarray`` makes one of. A number goes to the nearest fixed-point
        word.
    spec, first_slot
        The environment; and the global number of the first slot, for the agents' names.
    target
        As :func:`room_for_words` makes it. Of no meaning after an error.

    Raises
    ------
    ActionError
        Names the first agent whose action is not in the action space, the action and, where there are
        several, the field.
    """
    words = _encode(actions, spec, target)
    if words is None:
        raise ActionRules.of(spec, spec.action_space, len(target), first_slot).refusal(actions)
    if spec.roles and isinstance(spec.action_space, Discrete):
        spaces = [role.action_space for role in spec.roles]
        most = np.array([space.n for space in spaces])  # type: ignore[union-attr]  # as the spec's is
        beyond = np.flatnonzero((words.reshape(-1, spec.agents) >= most).ravel())
        if beyond.size:
            i = int(beyond[0])
            agent = f"agent_{first_slot * spec.agents + i}"
            rules = ActionRules.of(spec, spec.action_space, len(target), first_slot)
            raise rules.refusal_of([agent], [int(words[i])], spaces[i % spec.agents])
    return words


def room_for_words(spec: EnvSpec, n: int) -> npt.NDArray[Any]:
    """Return an array for the words of ``n`` agents' actions, in ``spec.action_dtype``, a row an agent.

    Its shape is ``(n,)``; of actions with several fields ``(n, fields)``.
    """
    fields = len(spec.action_fields)
    return np.empty(n if fields == 1 else (n, fields), spec.action_dtype)


def are_words(actions: Any, target: npt.NDArray[Any]) -> bool:
    """Return whether actions are an array like ``target``, as a device takes it, of whatever words."""
    return (
        actions.__class__ is np.ndarray
        and actions.dtype is target.dtype
        and actions.shape == target.shape
        and actions.flags.carray
    )


def check_words(words: npt.NDArray[Any], spec: EnvSpec, room: npt.NDArray[Any], first_slot: int) -> None:
    """Raise ActionError for words that are none of actions in the action space; ``room`` is written over."""
    fractions = np.array([field.fraction for field in spec.action_fields])
    numbers = words.reshape(len(words), len(fractions)) * 2.0**-fractions
    space = spec.action_space
    actions = numbers if isinstance(space, Box) else words.reshape(len(words), *(space.shape or ()))
    encode(actions, spec, room, first_slot)


def refuse_masked(
    words: npt.NDArray[Any], masks: npt.NDArray[np.int8], first: int = 0, taking_turns: int = 1
) -> None:
    """Raise ActionError for the first agent, counted from ``first``, whose action is masked.

    An agent whose masks are all 0 may send anything. Of each ``taking_turns`` agents in a row, that is all
    but one; so no action is masked where as many are allowed as there are such groups.
    """
    if taking_turns > 1 and taking_turns * _allowed_count(words, masks) == len(words):
        return
    i = _first_masked(words, masks)
    if i < len(words):
        allowed = ", ".join(map(str, np.flatnonzero(masks[i])))
        raise ActionError(f"agent_{first + i}: action {words[i]} is masked; it may take {allowed}")


def _encode(actions: Any, spec: EnvSpec, target: npt.NDArray[Any]) -> npt.NDArray[Any] | None:
    """Do as :func:`encode` does, for agents that are all alike; ``None`` where not all are possible."""
    space = spec.action_space
    try:
        array = np.asarray(actions)
    except ValueError:  # a ragged list
        return None
    if isinstance(space, Discrete) and are_words(array, target):
        return array if _largest(array) < space.n else None
    fits = array.shape == (len(target), *(space.shape or ()))
    if not fits or array.dtype.kind not in ("iuf" if isinstance(space, Box) else "iu"):
        return None
    if isinstance(space, Box):
        if array.dtype not in _FLOATS or not array.flags.carray:
            array = np.array(array, np.float64 if array.dtype.itemsize > 4 else np.float32, order="C")
        ends = zip(space.low.tolist(), space.high.tolist(), spec.action_fields, strict=True)
        for numbers, words, (low, high, field) in zip(_columns(array), _columns(target), ends, strict=True):
            if not _fix(numbers, words, low, high, 2.0**field.fraction):
                return None
        return target
    if not array.flags.behaved:  # read-only or unaligned: to Numba other types, and so another compilation
        array = array.copy()
    if not array.dtype.isnative or not array.flags.c_contiguous:
        array = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    # Seen as unsigned, a negative number is a large one: one comparison does for both ends.
    unsigned = array.view(_UNSIGNED[array.itemsize]) if array.dtype.kind == "i" else array
    if isinstance(space, Discrete):  # which most are: a loop over columns would cost their steps more
        inside = _narrow(unsigned, target) < space.n
    else:
        columns = zip(_columns(unsigned), _columns(target), spec.action_counts, strict=True)
        inside = all(_narrow(numbers, words) < n for numbers, words, n in columns)
    return target if inside else None


def _columns(rows: npt.NDArray[Any]) -> Iterable[npt.NDArray[Any]]:
    """Return an array of one number a row for each number that a row has."""
    return (rows,) if rows.ndim == 1 else rows.T


def why_not(action: Any, space: ActionSpace, names: Sequence[str] = ()) -> str:
    """Return why one action is not in ``space``, in words; empty if it is."""
    if isinstance(space, Discrete):
        if isinstance(action, (bool, np.bool_)) or not isinstance(action, (int, np.integer)):
            return "is no integer"
        return "" if 0 <= action < space.n else "is out of range"
    box = isinstance(space, Box)
    try:
        array = np.asarray(action)
    except ValueError:
        return "is no array"
    if array.dtype.kind not in ("iuf" if box else "iu") or array.shape != space.shape:
        return f"is no {'number' if box else 'integers'} in an array of shape {space.shape}"
    low, high = bounds(space)
    inside = (low <= array) & (array <= high)
    if inside.all():
        return ""
    if array.size == 1:
        return "is out of range"
    k = int(inside.argmin())  # of one dimension, or a wrapper's
    name = names[k] if len(names) == array.size else f"element {k}"
    value, least, most = (numbers.ravel()[k] for numbers in (array, low, high))
    return f"is out of range: {name} is {value}, and {least} to {most} is possible"


def random_actions(
    spec: EnvSpec, rng: np.random.Generator, n: int, masks: npt.NDArray[np.int8] | None = None
) -> npt.NDArray[Any]:
    """Return independent uniform actions for ``n`` agents, in the form that costs a step least.

    Each is of its agent's role, where the first is agent 0 of a world; and one of those that its mask allows,
    where ``masks`` are given. An agent whose masks are all 0 takes action 0, which does nothing.
    """
    space = spec.action_space
    if masks is not None:
        return random_allowed(masks, rng.integers(1 << 32, size=n, dtype=np.uint32), spec.action_dtype)
    if isinstance(space, Box):
        return rng.uniform(space.low, space.high, (n, *space.shape)).astype(np.float32)
    if not isinstance(space, Discrete):
        return rng.integers(spec.action_counts, size=(n, *space.shape)).astype(spec.action_dtype)
    if spec.roles:
        most = np.array([role.action_space.n for role in spec.roles])  # type: ignore[union-attr]
        return rng.integers(np.resize(most, n)).astype(spec.action_dtype)
    return rng.integers(space.n, size=n, dtype=spec.action_dtype)


def random_numbers(space: ActionSpace, draws: npt.NDArray[np.uint32]) -> npt.NDArray[Any]:
    """Return an action for each uniform ``u32``, shape ``(n, *space.shape)``, in ``space.dtype``."""
    if isinstance(space, Discrete):
        numbers: npt.NDArray[Any] = uniform_below(draws, space.n).astype(np.int64) + space.start
        return numbers
    count = math.prod(space.shape)
    each = np.stack([_scattered(draws, k) for k in range(count)], -1).reshape(-1, *space.shape)
    if isinstance(space, Box):
        return (space.low + each / 2.0**32 * (space.high - space.low)).astype(space.dtype)
    low, high = bounds(space)
    integers: npt.NDArray[Any] = (uniform_below(each, high - low + 1) + low).astype(space.dtype)
    return integers


def _scattered(draws: npt.NDArray[np.uint32], k: int) -> npt.NDArray[np.uint32]:
    """Return draws for element ``k`` of an action that seem to be others; for element 0 they are the same."""
    if k == 0:
        return draws
    words = draws + np.uint32(k * 0x9E3779B9 & 0xFFFFFFFF)  # as MurmurHash3 ends
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        words = (words ^ words >> np.uint32(shift)) * np.uint32(factor)
    return words ^ words >> np.uint32(16)


def random_allowed(
    masks: npt.NDArray[np.int8], draws: npt.NDArray[np.uint32], dtype: npt.DTypeLike = np.int64
) -> npt.NDArray[Any]:
    """Return an action for each uniform ``u32`` that its masks allow; 0 where they allow none."""
    return _allowed(masks, draws, np.empty(len(masks), dtype))  # type: ignore[no-any-return]


def limits(space: ActionSpace) -> str:
    """Return in words what a space takes."""
    if isinstance(space, Discrete):
        return f"{space} takes integers from 0 to {space.n - 1}"
    kind = "numbers" if isinstance(space, Box) else "integers"
    low, high = (end.ravel()[0] if (end == end.ravel()[0]).all() else end.tolist() for end in bounds(space))
    return f"{space} takes arrays of shape {space.shape} with {kind} from {low} to {high}"


_FLOATS = (np.float32, np.float64)
_UNSIGNED: dict[int, np.dtype[Any]] = {size: np.dtype(f"u{size}") for size in (1, 2, 4, 8)}


@compiled
def _largest(source: Any) -> Any:
    largest = source.dtype.type(0)
    for i in range(source.size):
        largest = max(largest, source[i])
    return largest


@compiled
def _allowed_count(words: Any, masks: Any) -> Any:
    """Return how many rows there are whose action is allowed; no branch, as turns cannot be predicted."""
    flat, wide, count = masks.reshape(-1), np.uint64(masks.shape[1]), 0
    first = np.uint64(0)  # unsigned: Numba looks for indices below zero
    for i in range(words.size):
        count += flat[first + np.uint64(words[i])]
        first += wide
    return count


@compiled
def _first_masked(words: Any, masks: Any) -> Any:
    """Return the first row whose action is masked, and not all others too; else how many rows there are."""
    for i in range(words.size):
        if masks[i, words[i]] == 0:
            for k in range(masks.shape[1]):  # any() takes twice as long
                if masks[i, k]:
                    return i
    return words.size


@compiled
def _fix(source: Any, target: Any, low: float, high: float, scale: float) -> Any:
    """Round numbers to fixed point; return whether all are in range, which NaN is not."""
    inside = 0  # counted: a flag would be a branch, and the loop scalar
    for i in range(source.size):
        x = np.float64(source[i])
        inside += int((low <= x) & (x <= high))
        target[i] = target.dtype.type(math.floor(x * scale + 0.5))
    return inside == source.size


@compiled
def _narrow(source: Any, target: Any) -> Any:
    """Copy into a narrower array; return the largest number seen."""
    largest = source.dtype.type(0)
    for i in range(source.size):
        largest = max(largest, source[i])
        target[i] = target.dtype.type(source[i])
    return np.uint64(largest)


@compiled
def _allowed(masks: Any, draws: Any, target: Any) -> Any:
    """Write into each row of ``target`` one of the actions that its mask allows, by a uniform ``u32``."""
    n, size = masks.shape
    for i in range(n):
        count = 0
        for k in range(size):
            count += masks[i, k]
        rank = np.int64(draws[i]) * count >> 32
        # How many actions come before the one of this rank: without a branch, which would be a coin's toss.
        before, chosen = 0, 0
        for k in range(size):
            before += masks[i, k]
            chosen += before <= rank
        target[i] = target.dtype.type(chosen if count else 0)
    return target
