"""Self-play: PPO against its past selves, for games with a winner.

From time to time the policy, as it is, joins the *league*, and stays there. In some worlds the learner plays
all sides, in the others one, against members of the league. So it cannot forget how to beat earlier policies.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call

from pearl_marl.errors import ArgumentError
from pearl_marl.policies.network import MASKED, masked
from pearl_marl.policies.policy_file import check_weights
from pearl_marl.policies.trained import NetworkPolicy
from pearl_marl.spec import EnvSpec
from pearl_marl.training import ppo
from pearl_marl.training.actor_critic import Inputs
from pearl_marl.training.restoring import whole
from pearl_marl.training.rollout import RolloutBuffer, RolloutWorker, seed_of
from pearl_marl.training.settings import count, number


@dataclass(frozen=True)
class SelfPlaySettings(ppo.PPOSettings):
    """What a run depends on: PPO's settings, and these."""

    join_every: int = count(10)  # iterations, after which the policy joins the league; and it does at first
    opponents: int = count(4)  # members of the league that are met in a rollout
    random_moves: float = number(0.1, most=1)  # share of moves, so that games differ; not learned from
    mirrored: float = number(0.5, most=1)  # share of worlds in which the learner plays all sides


class LeagueWorker(RolloutWorker):
    """Gathers with the learner among members of the ``league``, the weights of policies by iteration."""

    league: dict[int, dict[str, Tensor]]

    def __init__(self, spec: EnvSpec, device: Any, settings: Any, model: Any) -> None:
        super().__init__(spec, device, settings, model)
        n, agents, seat = len(self.agents.obs), spec.agents, self.agents.position
        world = torch.arange(n, device=self.where) // agents
        first = round(settings.mirrored * (n // agents))
        # The player of each row: 0 is the learner, k the k-th opponent. The learner has each seat as often.
        group = 1 + (world - first) // agents % settings.opponents
        self.players = torch.where((world < first) | (world % agents == seat), 0, group)
        self.met: list[int] = []
        self.random_moves = torch.zeros(settings.rollout_length, n, dtype=torch.bool, device=self.where)

    def gather(self, rollout: int) -> RolloutBuffer:
        """Step all agents, against members that the rollout's number decides; return the rollout."""
        settings = self.settings
        draw = np.random.default_rng(seed_of(settings.seed, rollout, 1))
        self.met = draw.choice(list(self.league), settings.opponents).tolist()
        random = torch.Generator(self.where).manual_seed(seed_of(settings.seed, rollout, 2))
        draws = torch.rand((settings.rollout_length, len(self.players)), generator=random, device=self.where)
        self.random_moves = draws < settings.random_moves
        return super().gather(rollout)

    def network_beside(self) -> None:
        """Return None: there are several policies."""

    def acting(self) -> Tensor:
        """Return which agents' next decisions are learned from: the learner's."""
        return self.agents.acting & (self.players == 0)

    def excluded(self) -> Tensor:
        """Return which moves are random."""
        return self.random_moves

    def decide(self, inputs: Inputs, step: int) -> Tensor:
        """Return the outputs of all players' policies; equal ones where the move is random."""
        policy, acting = self.model.policy, self.agents.acting
        outputs = torch.full((len(inputs.obs), policy.outputs), MASKED, device=self.where)
        for player, weights in enumerate([{}, *(self.league[k] for k in self.met)]):
            rows = (acting & (self.players == player)).nonzero()[:, 0]
            some = inputs.pick(rows)
            outputs[rows] = functional_call(policy, weights, (some.obs, some.masks, some.position))
        anything = masked(torch.zeros_like(outputs), inputs.masks)
        return torch.where(self.random_moves[step][:, None], anything, outputs)


class SelfPlay(ppo.PPO):
    """A run of self-play: :meth:`iterate` is one update."""

    gathers = LeagueWorker

    def __init__(self, spec: EnvSpec, device: Any, settings: SelfPlaySettings) -> None:
        if spec.agents < 2:
            raise ArgumentError(f"{spec.name} has one agent in a world, and self-play takes two: use ppo")
        if settings.memory != "none":
            raise ArgumentError("self-play learns no policies with memory: leave it out, or use ppo")
        super().__init__(spec, device, settings)
        self.league: dict[int, dict[str, Tensor]] = {}
        self.worker.league = self.league
        self._join()

    def update(self) -> None:
        """Gather a rollout and learn from it; join the league, if it is time."""
        super().update()
        if self.done % self.settings.join_every == 0:
            self._join()

    def count(self, rollout: RolloutBuffer) -> None:
        """Count the episodes that ended: the learner's against the league, as against itself it wins half."""
        players = self.worker.players.reshape(-1, self.worker.spec.agents)
        counted = ((players == 0) & (players != 0).any(1, keepdim=True)).flatten()
        self.episodes.add(rollout.rewards * counted, rollout.ended & counted)

    def _join(self) -> None:
        weights = self.policy.state_dict()
        self.league[self.done] = {name: tensor.detach().clone() for name, tensor in weights.items()}

    @property
    def past(self) -> dict[int, NetworkPolicy]:
        """The members of the league, by the iterations after which they joined."""
        members = {}
        for done, weights in self.league.items():
            members[done] = copy.deepcopy(self.policy)
            members[done].load_state_dict(weights)
        return members

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on."""
        return {**super().state(), "league": self.league}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        super().load(state)
        self.league.clear()
        if not state["league"]:
            raise ArgumentError("its league has no members")
        for done, weights in state["league"].items():
            if whole("number of iterations of a member of the league", done) > self.done:
                raise ArgumentError(f"its league has a member of iteration {done}, and {self.done} are done")
            check_weights(self.policy, weights, f"{self.policy.spec.name}'s member {done} of the league")
            self.league[done] = {name: tensor.to(self.where) for name, tensor in weights.items()}
