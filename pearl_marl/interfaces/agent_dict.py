"""A dict over agents that is backed by one array, and filled only when it is read.

A step of 43,008 agents takes some 20 microseconds; a plain dict of its observations takes a
thousand times that. Most users never look at a single key, so :class:`AgentDict` puts the keys
and values in when the first method that needs them is called. To every such method it is an
ordinary, mutable dict. A dict of few agents is filled at once.

Compiled code may read a dict's memory and call no method: encoders of JSON, data frames. Until a dict
of many agents is filled it holds one entry there that no encoder takes, so that they fail aloud.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Space, Tuple

from pearl_marl.interfaces.filling import FEW, UNREAD, fill_first
from pearl_marl.interfaces.trees import register_dict


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
register_dict(AgentDict)
register_dict(_UnfilledAgentDict)


def observations_in(space: Space[Any]) -> Callable[[npt.NDArray[Any]], list[Any]]:
    """Return the maker of one slot's observation in ``space`` from each row of an array.

    NumPy scalars of a flat array, views of another; a tuple where ``space`` is one.
    """
    if isinstance(space, Tuple):
        return _tuples
    return list


def _tuples(array: npt.NDArray[Any]) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in array]


def python_values(array: npt.NDArray[Any]) -> list[Any]:
    """Return the elements of a flat array as Python's own ``bool`` or ``float``."""
    values: list[Any] = array.tolist()
    return values


def ended_infos(
    final_obs: npt.NDArray[Any],
    observations: Callable[[npt.NDArray[Any], npt.NDArray[np.intp]], Sequence[Any]],
) -> Callable[[npt.NDArray[np.bool_]], list[dict[str, Any]]]:
    """Return the maker of an infos dict, whose array tells which agents ended.

    ``observations`` makes those of some agents, given the rows and whose they are.
    """

    def infos(ended: npt.NDArray[np.bool_]) -> list[dict[str, Any]]:
        result: list[dict[str, Any]] = [{} for _ in range(len(ended))]
        slots = np.flatnonzero(ended)
        for slot, final in zip(slots.tolist(), observations(final_obs[slots], slots), strict=True):
            result[slot]["final_obs"] = final
        return result

    return infos
