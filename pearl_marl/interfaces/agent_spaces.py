"""Spaces by agents' names, as some code takes them: PettingZoo's own environments have dicts of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gymnasium.spaces import Space

from pearl_marl.interfaces.filling import FEW
from pearl_marl.interfaces.names import Names


class AgentSpaces(Mapping[str, Space[Any]]):
    """The spaces of many agents by name, without an entry for each: a world's, which all worlds share.

    To look one up costs the same whatever their number; to go through all of them makes all their names.
    """

    def __init__(self, names: Names, spaces: Sequence[Space[Any]]) -> None:
        self._names, self._spaces = names, spaces

    @classmethod
    def of(cls, names: Names, spaces: Sequence[Space[Any]]) -> Mapping[str, Space[Any]]:
        """Return the spaces of agents, of whom each world has those of ``spaces`` in turn; of few a dict."""
        made = cls(names, spaces)
        return dict(made) if len(names) <= FEW else made

    def __getitem__(self, agent: str) -> Space[Any]:
        return self._spaces[self._names.slot(agent) % len(self._spaces)]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self)} agents: {', '.join(map(str, self._spaces))}, in turn)"
