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
        with the spec's options; or a function that takes the spec. Either returns one environment of the
        kind of Gymnasium, PettingZoo, jumanji, JaxMARL or dm_env.
    options
        The options that a maker takes. Without it, makers by ``"module:name"`` take all, and gymnax none.
    parameters
        The options that are parameters of gymnax's environment.
    actions
        Takes the spec and actions of all agents, an array of shape ``(n, ...)``, and returns them as the
        library takes them: one entry for each of its environments.
    choose
        Takes an environment and a ``random.Random``, and returns its next actions, where not all are legal.
    agents
        How many agents share one of its environments, where ours has another number.
    differs
        How it differs from ours, for the table.
    """

    make: str | Callable[[Any], Any]
    options: tuple[str, ...] | None = None
    parameters: tuple[str, ...] = ()
    actions: Callable[[Any, npt.NDArray[Any]], Any] | None = None
    choose: Callable[[Any, Any], Any] | None = None
    agents: int | None = None
    differs: str = ""
