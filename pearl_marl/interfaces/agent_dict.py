"""What users read by agents' names: the names themselves, and lists, dicts and spaces by them.

Ten million names take seconds to write and a gigabyte to keep, and a plain dict of the observations of 43,008
agents takes a thousand times as long as their step. Most users never look at a single key. So names are made
when they are read, and a list or dict of many agents is filled by the first method that needs its
elements. To every such method it is an ordinary, mutable list or dict. One of few agents is filled at once.

:class:`Names` is what an environment and its dicts share, and never changes. :class:`AgentList` is the list
that users see and may change. An :class:`AgentDict` is backed by one array, :class:`AgentSpaces` by a world's
spaces.

Compiled code may read the memory of a list or dict and call no method: encoders of JSON, data frames. Until
one of many agents is filled it holds an entry there that no encoder takes, so that they fail aloud. To JAX
and PyTorch a subclass of ``dict`` is one leaf of a tree, until they are told; they make plain dicts of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial, wraps
from itertools import compress
from typing import Any, overload

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Space, Tuple

from pearl_marl.interfaces.importing import when_imported

FEW = 16
"""Up to so many elements a container is filled when it is made: that takes a few microseconds."""


class _Unread:
    """What a container holds until it is filled: neither a name nor a number to code that reads memory."""

    def __repr__(self) -> str:
        return "<not filled yet: take dict(...) or list(...) of the whole>"

    def __reduce__(self) -> str:
        raise TypeError(f"no result can be pickled while it is {self}")


UNREAD = _Unread()

PREFIX = "agent_"
MOST_CHARACTERS = 40
"""A name is shorter; Python refuses to read numbers of thousands of digits."""


class Names(Sequence[str]):
    """The names ``agent_0``, ``agent_1``, ... of so many agents; all of them are made at once, on first use.

    :meth:`of` has those of some of the agents.
    """

    def __init__(self, count: int) -> None:
        self._rows: Sequence[int] | npt.NDArray[np.intp] = range(count)
        self._among: tuple[Names, npt.NDArray[np.bool_]] | None = None
        self._made: tuple[str, ...] | None = None

    def of(self, present: npt.NDArray[np.bool_]) -> Names:
        """Return the names of the agents in a mask, ``bool`` of shape ``(n_agents,)``."""
        if present.all():
            return self
        some = Names(0)
        some._rows = np.flatnonzero(present)
        some._among = self, present
        return some

    def row(self, name: object) -> int:
        """Return the row of the agent of this name: the number in it.

        Raises
        ------
        KeyError
            It is none of them.
        """
        digits = name[len(PREFIX) :] if isinstance(name, str) and len(name) < MOST_CHARACTERS else ""
        # "007" is a number too, and so are digits of other scripts.
        if digits.isdecimal() and f"{PREFIX}{(row := int(digits))}" == name and self._has(row):
            return row
        raise KeyError(name)

    def _has(self, row: int) -> bool:
        if isinstance(self._rows, np.ndarray):
            i = int(np.searchsorted(self._rows, row))
            return i < len(self._rows) and int(self._rows[i]) == row
        return row in self._rows

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[str]:
        if self._made is None:
            if self._among is None:
                made = [f"{PREFIX}{row}" for row in self._rows]
            else:  # the same strings, whose hashes are known
                names, present = self._among
                made = list(compress(names, present.tolist()))
            self._made = tuple(made)
        return iter(self._made)

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> list[str]: ...
    def __getitem__(self, index: int | slice) -> str | list[str]:
        chosen = self._rows[index]
        if isinstance(index, slice):
            return [f"{PREFIX}{row}" for row in chosen]  # type: ignore[union-attr]
        return f"{PREFIX}{chosen}"

    def __contains__(self, name: object) -> bool:
        try:
            self.row(name)
        except KeyError:
            return False
        return True


def fill_first(unfilled: type[Any], plain: type[Any], *names: str) -> None:
    """Give a container that is not filled yet methods of a plain one that fill it, and its like, first.

    ``unfilled`` has a method ``fill``, which makes the object one of another class.
    """
    for name in names:
        setattr(unfilled, name, _filled_first(unfilled, getattr(plain, name)))


def _filled_first(unfilled: type[Any], plain: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(plain)
    def method(self: Any, *args: Any, **kwargs: Any) -> Any:
        for lazy in (self, *args):
            if isinstance(lazy, unfilled):
                lazy.fill()
        return plain(self, *args, **kwargs)

    return method


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


class AgentDict(dict[str, Any]):
    """Values by agent, made from an array on first use.

    Made by :meth:`of`. Called as a class it takes what ``dict`` takes, as code expects that makes another
    dict of the same type; such a one has no :attr:`array`.

    Notes
    -----
    Copies (``copy``, ``copy.copy``, ``copy.deepcopy``, ``|``) and pickles are plain dicts.
    """

    __slots__ = ("_agents", "_values", "array")

    _agents: Sequence[str]
    _values: Callable[[npt.NDArray[Any]], Sequence[Any]]
    array: npt.NDArray[Any]
    """The values as the device returned them; no copy is made."""

    @classmethod
    def of(
        cls,
        agents: Sequence[str],
        array: npt.NDArray[Any],
        values: Callable[[npt.NDArray[Any]], Sequence[Any]],
    ) -> AgentDict:
        """Return the dict of an array.

        Parameters
        ----------
        agents
            The keys, in order. Not to be changed afterwards.
        array
            What :attr:`array` gives: a row an agent, in the same order.
        values
            Makes the values from ``array``.
        """
        made = cls()
        made.array = array
        if len(agents) <= FEW:
            dict.update(made, zip(agents, values(array), strict=True))
        else:
            made._agents = agents
            made._values = values
            # C code asks a dict for its size without asking us: json.dumps takes size 0 for "{}".
            # One key present sends it to items(), which fills the dict.
            dict.__setitem__(made, UNREAD, UNREAD)  # type: ignore[misc]
            made.__class__ = _UnfilledAgentDict
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)

    def __copy__(self) -> dict[str, Any]:
        return dict(self)

    # Makes plain dicts too: it would call this class with no argument.
    fromkeys = staticmethod(dict.fromkeys)  # type: ignore[assignment]


class _UnfilledAgentDict(AgentDict):
    # Every method fills the dict and, with it, turns it into an AgentDict, whose methods are those
    # of dict itself: after the first call nothing is slower than in a plain one.
    __slots__ = ()

    def __new__(cls, *args: Any, **kwargs: Any) -> AgentDict:  # type: ignore[misc]
        # Called by code that makes another dict of the same type.
        return AgentDict(*args, **kwargs)

    def fill(self) -> None:
        # The values first: another thread may look as soon as the class says that they are there.
        dict.update(self, zip(self._agents, self._values(self.array), strict=True))
        dict.pop(self, UNREAD, None)  # type: ignore[misc]
        self.__class__ = AgentDict  # type: ignore[assignment]

    def __len__(self) -> int:
        return len(self._agents)

    # This also keeps dict(d), {**d} and f(**d) from copying the unfilled dict in C.
    def __iter__(self) -> Iterator[str]:
        self.fill()
        return iter(self)


fill_first(
    _UnfilledAgentDict,
    dict,
    *("__getitem__", "__setitem__", "__delitem__", "__contains__", "__reversed__", "__repr__"),
    *("__eq__", "__ne__", "__or__", "__ror__", "__ior__"),
    *("copy", "get", "keys", "values", "items", "pop", "popitem", "setdefault", "update", "clear"),
)


def _flat(container: dict[str, Any]) -> tuple[list[Any], tuple[str, ...]]:
    return list(container.values()), tuple(container)


def _flat_with_keys(
    key: Callable[[str], Any], container: dict[str, Any]
) -> tuple[list[tuple[Any, Any]], tuple[str, ...]]:
    return [(key(name), value) for name, value in container.items()], tuple(container)


def _plain(names: tuple[str, ...], values: Iterable[Any]) -> dict[str, Any]:
    return dict(zip(names, values, strict=True))


def _register_with_torch() -> None:
    from torch.utils import _pytree as trees

    with_keys = partial(_flat_with_keys, trees.MappingKey)
    for kind in (AgentDict, _UnfilledAgentDict):
        trees.register_pytree_node(
            kind, _flat, lambda values, names: _plain(names, values), flatten_with_keys_fn=with_keys
        )


def _register_with_jax() -> None:
    from jax import tree_util as trees

    for kind in (AgentDict, _UnfilledAgentDict):
        trees.register_pytree_with_keys(kind, partial(_flat_with_keys, trees.DictKey), _plain, _flat)


when_imported("torch", _register_with_torch)
when_imported("jax", _register_with_jax)


class AgentSpaces(Mapping[str, Space[Any]]):
    """The spaces of many agents by name: those of one world, which all worlds share.

    To look one up costs the same whatever their number; to go through all of them makes all their names.
    """

    def __init__(self, names: Names, spaces: Sequence[Space[Any]]) -> None:
        self._names, self._spaces = names, spaces

    @classmethod
    def of(cls, names: Names, spaces: Sequence[Space[Any]]) -> Mapping[str, Space[Any]]:
        """Return the spaces of agents, where each world has those of ``spaces`` in turn; of few a dict."""
        made = cls(names, spaces)
        return dict(made) if len(names) <= FEW else made

    def __getitem__(self, agent: str) -> Space[Any]:
        return self._spaces[self._names.row(agent) % len(self._spaces)]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self)} agents: {', '.join(map(str, self._spaces))}, in turn)"


def observations_in(space: Space[Any]) -> Callable[[npt.NDArray[Any]], list[Any]]:
    """Return a function that makes one agent's observation in ``space`` from each row of an array.

    NumPy scalars of a flat array, views of another; a tuple where ``space`` is one.
    """
    if isinstance(space, Tuple):
        return _tuples
    return list


def _tuples(array: npt.NDArray[Any]) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in array]


def ended_infos(
    final_obs: npt.NDArray[Any],
    observations: Callable[[npt.NDArray[Any], npt.NDArray[np.intp]], Sequence[Any]],
) -> Callable[[npt.NDArray[np.bool_]], list[dict[str, Any]]]:
    """Return a function that makes infos from an array that says which agents ended.

    ``observations`` makes the last observations of some agents from their rows of ``final_obs`` and their
    numbers.
    """

    def infos(ended: npt.NDArray[np.bool_]) -> list[dict[str, Any]]:
        result: list[dict[str, Any]] = [{} for _ in range(len(ended))]
        rows = np.flatnonzero(ended)
        for row, final in zip(rows.tolist(), observations(final_obs[rows], rows), strict=True):
            result[row]["final_obs"] = final
        return result

    return infos
