"""Policies against each other: who beats whom, where the agents of a world are not of one policy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.devices import Device
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation.run import Evaluation, interval
from pearl_marl.policies.loading import Policy
from pearl_marl.spec import EnvSpec

Array = npt.NDArray[Any]


class Match(Evaluation):
    """An evaluation of a policy that plays one agent of each world, against another that plays all others.

    In world ``w`` it plays agent ``w % K``, so that it has every seat equally often. Every agent plays one
    episode. The arguments are those of :class:`~pearl_marl.evaluation.Evaluation`, without ``episodes``.

    Attributes
    ----------
    seats
        Which agents are of the first policy, ``bool`` of shape ``(n,)``.
    """

    def __init__(
        self,
        spec: EnvSpec,
        policy: Policy,
        against: Policy,
        n_agents: int,
        device: str | Device = "native",
        **given: Any,
    ) -> None:
        if spec.agents < 2:
            raise ArgumentError(
                f"{spec.name} has one agent in a world, which has nobody to play against: leave --against out"
            )
        self.seats = _seats(n_agents, spec.agents)

        def both(*seen: Array) -> Array:
            # Both are given everything: some policies go by which row an agent has.
            ours, theirs = np.asarray(policy(*seen)), np.asarray(against(*seen))
            chosen = self.seats.reshape(-1, *(1,) * (ours.ndim - 1))
            return np.where(chosen, ours, theirs)

        super().__init__(spec, both, n_agents, device, **given)

    def outcome(self) -> dict[str, Any]:
        """Return how it went for the first policy: wins, draws and losses, and the returns of both.

        A world is won by who has a higher return there than each of the others.
        """
        agents = self.config.spec.agents
        returns, seats = self.world_returns, self.seats.reshape(-1, agents)
        ours, theirs = returns[seats], returns[~seats].reshape(-1, agents - 1)
        most = theirs.max(1)
        games = len(ours)
        wins, losses = int((ours > most).sum()), int((ours < most).sum())
        return {
            "games": games,
            "wins": wins,
            "draws": games - wins - losses,
            "losses": losses,
            "return": interval(ours),
            "their_return": interval(theirs.mean(1)),
        }


def cross_table(
    spec: EnvSpec, policies: Mapping[str, Policy], n_agents: int, **given: Any
) -> Iterator[dict[str, Any]]:
    """Yield the outcomes of all policies, each against each of the others, a row a pair.

    ``given`` is what :class:`Match` takes.
    """
    names = list(policies)
    for k, first in enumerate(names):
        for second in names[k + 1 :]:
            match = Match(spec, policies[first], policies[second], n_agents, **given)
            for _ in match.run():
                pass
            yield {"policy": first, "against": second, **match.outcome()}


def _seats(n: int, agents: int) -> npt.NDArray[np.bool_]:
    row = np.arange(n)
    return np.asarray(row % agents == row // agents % agents)
