"""Agents' names, made when somebody reads them: ten million take seconds to write and a gigabyte to keep.

:class:`Names` is what an environment and its dicts share, and never changes. :class:`AgentList` is the list
that users see and may change.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import compress
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from pearl_marl.interfaces.filling import FEW, UNREAD, fill_first

PREFIX = "agent_"
MOST_CHARACTERS = 40
"""A name is shorter; Python refuses to read numbers of thousands of digits."""


class Names(Sequence[str]):
    """The names ``agent_0``, ``agent_1``, ... of so many agents; all of them are made at once, on first use.

    :meth:`of` has those of some of the agents.
    """

    def __init__(self, count: int) -> None:
        self._slots: Sequence[int] | npt.NDArray[np.intp] = range(count)
        self._among: tuple[Names, npt.NDArray[np.bool_]] | None = None
        self._made: tuple[str, ...] | None = None

    def of(self, live: npt.NDArray[np.bool_]) -> Names:
        """Return the names of those that ``live``, shape ``(n_agents,)``, says are there."""
        if live.all():
            return self
        some = Names(0)
        some._slots = np.flatnonzero(live)
        some._among = self, live
        return some

    def slot(self, name: object) -> int:
        """Return the number in one of these names.

        Raises
        ------
        KeyError
            It is none of them.
        """
        digits = name[len(PREFIX) :] if isinstance(name, str) and len(name) < MOST_CHARACTERS else ""
        # "007" is a number too, and so are digits of other scripts.
        if digits.isdecimal() and f"{PREFIX}{(slot := int(digits))}" == name and self._has(slot):
            return slot
        raise KeyError(name)

    def _has(self, slot: int) -> bool:
        if isinstance(self._slots, np.ndarray):
            place = int(np.searchsorted(self._slots, slot))
            return place < len(self._slots) and int(self._slots[place]) == slot
        return slot in self._slots

    def __len__(self) -> int:
        return len(self._slots)

    def __iter__(self) -> Iterator[str]:
        if self._made is None:
            if self._among is None:
                made = [f"{PREFIX}{slot}" for slot in self._slots]
            else:  # the same strings, whose hashes are known
                everybody, live = self._among
                made = list(compress(everybody, live.tolist()))
            self._made = tuple(made)
        return iter(self._made)

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> list[str]: ...
    def __getitem__(self, index: int | slice) -> str | list[str]:
        chosen = self._slots[index]
        if isinstance(index, slice):
            return [f"{PREFIX}{slot}" for slot in chosen]  # type: ignore[union-attr]
        return f"{PREFIX}{chosen}"

    def __contains__(self, name: object) -> bool:
        try:
            self.slot(name)
        except KeyError:
            return False
        return True


class AgentList(list[str]):
    """A list of agents' names that is filled when it is changed, or read from one end to the other.

    Its length, an element, a slice, and whether a name is in it need no filling. A list of few names is
    filled at once. Copies and pickles are plain lists. Of other names than :class:`Names` it is an ordinary
    list.
    """

    __slots__ = ("_names",)

    def __init__(self, names: Iterable[str] = ()) -> None:
        if not isinstance(names, Names) or len(names) <= FEW:
            super().__init__(names)
            return
        self._names = names
        # For compiled code that reads the list's memory: it would see none at all. As many of them as there
        # are names, since some code takes the length from there and the names from our iterator.
        self.append(UNREAD)  # type: ignore[arg-type]
        self *= len(names)
        self.__class__ = _UnfilledAgentList

    def __reduce_ex__(self, protocol: Any) -> tuple[Any, ...]:
        return list, (list(self),)

    def __copy__(self) -> list[str]:
        return list(self)


class _UnfilledAgentList(AgentList):
    # As in an AgentDict: every method that is not here fills the list, whose methods are then list's own.
    __slots__ = ()

    def __new__(cls, names: Iterable[str] = ()) -> AgentList:  # type: ignore[misc]
        return AgentList(names)

    def fill(self) -> None:
        # Replaces what another thread may have put in meanwhile.
        list.__setitem__(self, slice(None), self._names)
        self.__class__ = AgentList  # type: ignore[assignment]

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, index: Any) -> Any:
        try:
            return self._names[index]
        except IndexError:
            raise IndexError("list index out of range") from None

    def __contains__(self, name: object) -> bool:
        return name in self._names

    # This also has list(a), [*a], sorted(a) and numpy.array(a) fill it.
    def __iter__(self) -> Iterator[str]:
        self.fill()
        return iter(self)

    def __eq__(self, other: object) -> bool:
        if isinstance(other, _UnfilledAgentList) and other._names is self._names:
            return True
        if not isinstance(other, list):
            return NotImplemented
        if len(other) != len(self):
            return False
        self.fill()
        return self == (list(other) if isinstance(other, AgentList) else other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = None  # type: ignore[assignment]

    def __radd__(self, other: list[str]) -> list[str]:  # list's own + would see no element
        return [*other, *self] if isinstance(other, list) else NotImplemented


fill_first(
    _UnfilledAgentList,
    list,
    *("__setitem__", "__delitem__", "__reversed__", "__repr__", "__lt__", "__le__", "__gt__", "__ge__"),
    *("__add__", "__iadd__", "__mul__", "__rmul__", "__imul__"),
    *("append", "clear", "copy", "count", "extend", "index", "insert", "pop", "remove", "reverse", "sort"),
)
