"""Policies against each other: wins and returns where agents of a world have different policies."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.batch.actions import random_actions
from pearl_marl.batch.step import BatchStep
from pearl_marl.checks import checked_integer
from pearl_marl.devices import Device
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation.run import Evaluation, acting, interval
from pearl_marl.golden.rng import checked_seed
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.policies.loading import Policy
from pearl_marl.spec import EnvSpec

OPENINGS = 4
"""Random steps with which games of turns begin, unless said otherwise."""


class Match(Evaluation):
    """An evaluation of a policy that plays one agent of each world, against another that plays all others.

    In world ``w`` it plays agent ``w % K``, so that it has every seat equally often. Every agent plays one
    episode. Other arguments are those of :class:`~pearl_marl.evaluation.Evaluation`, without ``episodes``.

    Parameters
    ----------
    openings
        With how many random steps every episode begins: where neither chance nor policies make a difference,
        all games would be the same. If not given, :data:`OPENINGS` in games of turns, else none.

    Attributes
    ----------
    seats
        Which agents are of the first policy, ``bool`` of shape ``(n,)``.
    elapsed
        How many steps the episode of each world has had.
    """

    def __init__(
        self,
        spec: EnvSpec,
        policy: Policy | DevicePolicy,
        against: Policy | DevicePolicy,
        n_agents: int,
        device: str | Device = "native",
        openings: int | None = None,
        *,
        seed: int = 0,
        max_cycles: int | None = None,
    ) -> None:
        if openings is None:
            openings = OPENINGS if spec.turns else 0
        if spec.agents < 2:
            raise ArgumentError(f"{spec.name} has one agent in a world, so policies cannot play each other")
        self._openings = checked_integer("openings", openings, 0)
        row = np.arange(n_agents)
        self.seats = np.asarray(row % spec.agents == row // spec.agents % spec.agents)
        rng = np.random.default_rng(checked_seed(seed))
        first, second = (acting(of, lambda: self.device) for of in (policy, against))
        alone = _are_one(policy, against)

        def choose(*observed: Array) -> Array:
            # Both policies get all rows: some choose by an agent's row.
            actions = np.asarray(first(*observed))
            if not alone:  # a second call would move its memory on by another step
                actions = np.where(_broadcast(self.seats, actions), actions, np.asarray(second(*observed)))
            if self.elapsed.min() < openings:
                drawn = random_actions(spec, rng, n_agents, *observed[1:])
                opening = np.repeat(self.elapsed < openings, spec.agents)
                actions = np.where(_broadcast(opening, actions), drawn, actions)
            return actions

        super().__init__(spec, choose, n_agents, device, seed=seed, max_cycles=max_cycles)
        self._players = (policy,) if alone else (policy, against)
        self.elapsed = np.zeros(self.config.n_envs, np.int64)

    def _count(self, step: BatchStep) -> int:
        ended, present = (flags.reshape(len(self.elapsed), -1) for flags in (step.ended, step.in_episode))
        self.elapsed = np.where(ended.any(1) & present.all(1), 0, self.elapsed + 1)
        return super()._count(step)

    def outcome(self) -> dict[str, Any]:
        """Return how it went for the first policy: wins, draws and losses, and the returns of both.

        A policy wins a world if its agent's return there is higher than that of each other agent.

        Raises
        ------
        ArgumentError
            Every game was over in its openings.
        """
        longest = self.lengths.max()
        if longest <= self._openings:
            raise ArgumentError(
                f"openings is {self._openings:,}, and no game went on for more than {longest:,} steps: "
                "neither policy chose anything, so take fewer"
            )
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
    spec: EnvSpec,
    policies: Mapping[str, Policy | DevicePolicy],
    n_agents: int,
    make_device: Callable[[], str | Device] = lambda: "native",
    **settings: Any,
) -> Iterator[dict[str, Any]]:
    """Yield the outcome of each pair of policies, and the digest of their games.

    Each match has a device of its own from ``make_device``; ``settings`` are other arguments of
    :class:`Match`.
    """
    for first, second in itertools.combinations(policies, 2):
        match = Match(spec, policies[first], policies[second], n_agents, make_device(), **settings)
        for _ in match.run():
            pass
        yield {"policy": first, "against": second, **match.outcome(), "digest": match.digest}


def _are_one(policy: Policy | DevicePolicy, against: Policy | DevicePolicy) -> bool:
    """Return whether two policies are one, or have one memory."""
    memories = [getattr(of, "forget", None) for of in (policy, against)]
    return policy is against or (memories[0] is not None and memories[0] == memories[1])


def _broadcast(flags: Array, actions: Array) -> Array:
    """Return flags of shape ``(n,)`` in a shape that broadcasts over the agents' actions."""
    return flags.reshape(-1, *(1,) * (actions.ndim - 1))
