"""What other libraries call an environment, for benchmarks that time them beside ours."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy.typing as npt


class Peer(NamedTuple):
    """An environment as another library has it.

    Parameters
    ----------
    make
        The library's id of it, for EnvPool, gymnax and pgx. For others ``"module:name"``, which is called
        with the spec's options, or a function that takes the spec; it returns one environment: jumanji's or
        JaxMARL's for these libraries, else one of the kind of Gymnasium, PettingZoo or dm_env.
    options
        The options that the library takes. By default gymnax takes none, and ``"module:name"`` all.
    parameters
        The options that are parameters of gymnax's environment.
    actions
        Takes the spec and actions of all agents, an array of shape ``(n, ...)``, and returns them as EnvPool,
        jumanji or a library in Python takes them: one entry for each environment.
    choose
        Takes an environment of a library in Python and a ``random.Random``, and returns its next actions.
        Without it they are the same in every step. In games of turns they are legal by the masks.
    agents
        How many agents share one of EnvPool's environments, where ours has another number.
    differs
        How EnvPool's environment differs from ours, for the table.
    """

    make: str | Callable[[Any], Any]
    options: tuple[str, ...] | None = None
    parameters: tuple[str, ...] = ()
    actions: Callable[[Any, npt.NDArray[Any]], Any] | None = None
    choose: Callable[[Any, Any], Any] | None = None
    agents: int | None = None
    differs: str = ""
