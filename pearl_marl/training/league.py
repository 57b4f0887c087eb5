"""Rollouts of the learner among its past selves, the members of its league, with memory and without.

Each agent is played by the same player in all rollouts: the learner, or one of some opponents. Which members
these are is drawn anew for each rollout, by its number. What an agent remembers is its player's: where it is
taken over by another member, its memory is emptied, also within an episode. The learner's agents remember
from one rollout to the next.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pearl_marl.policies.network import MASKED, masked
from pearl_marl.policies.trained import NetworkPolicy
from pearl_marl.training.actor_critic import Inputs
from pearl_marl.training.recurrent import RecurrentWorker, one_step
from pearl_marl.training.rollout import RolloutBuffer, RolloutWorker, seed_of


class League:
    """The learner's past selves, and who plays the agents of a rollout.

    Parameters
    ----------
    settings
        The run's.
    policy
        The learner's.
    position
        Of each agent in its world.

    Attributes
    ----------
    members
        Weights of policies, by the iterations after which they joined.
    players
        Who plays each agent: 0 is the learner, k the k-th opponent.
    opponents
        Those of the rollout under way.
    random_moves
        Which of its moves are random, a row for each step.
    """

    def __init__(self, settings: Any, policy: NetworkPolicy, position: Tensor) -> None:
        self.settings, self.policy = settings, policy
        n, agents = len(position), policy.spec.agents
        world = torch.arange(n, device=position.device) // agents
        first = round(settings.mirrored * (n // agents))
        # The learner has each seat as often.
        group = 1 + (world - first) // agents % settings.opponents
        self.players = torch.where((world < first) | (world % agents == position), 0, group)
        self.members: dict[int, dict[str, Tensor]] = {}
        self.opponents: list[NetworkPolicy] = []
        shape = settings.rollout_length, n
        self.random_moves = torch.zeros(shape, dtype=torch.bool, device=position.device)

    def join(self, done: int) -> None:
        """Take the learner in as it is after so many iterations."""
        weights = self.policy.state_dict()
        self.members[done] = {name: tensor.detach().clone() for name, tensor in weights.items()}

    def member(self, done: int) -> NetworkPolicy:
        """Return the member that joined after so many iterations."""
        policy = copy.deepcopy(self.policy)
        policy.load_state_dict(self.members[done])
        return policy

    def met(self, rollout: int) -> list[int]:
        """Return which members are the opponents of the rollout of that number."""
        joined = [done for done in self.members if done <= rollout]
        draw = np.random.default_rng(seed_of(self.settings.seed, rollout, 1))
        chosen: list[int] = draw.choice(joined, self.settings.opponents).tolist()
        return chosen

    def begin(self, rollout: int) -> None:
        """Draw the opponents and the random moves of the rollout of that number."""
        self.opponents = [self.member(done) for done in self.met(rollout)]
        where = self.random_moves.device
        random = torch.Generator(where).manual_seed(seed_of(self.settings.seed, rollout, 2))
        draws = torch.rand(self.random_moves.shape, generator=random, device=where)
        self.random_moves = draws < self.settings.random_moves

    def taken_over(self, rollout: int) -> Tensor:
        """Return which agents are played by another member than in the rollout before, if there was one."""
        before = self.met(rollout - 1) if rollout else [None] * self.settings.opponents
        pairs = zip(before, self.met(rollout), strict=True)
        changed = [False, *(one != other for one, other in pairs)]  # the learner stays
        return torch.tensor(changed, device=self.players.device)[self.players]

    def playing(self) -> Iterator[tuple[NetworkPolicy, Tensor]]:
        """Yield the policy of each player that has agents, the learner's first; and which are its agents."""
        for player, policy in enumerate([self.policy, *self.opponents]):
            theirs = self.players == player
            if theirs.any():
                yield policy, theirs

    def disturbed(self, outputs: Tensor, masks: Tensor | None, step: int) -> Tensor:
        """Return the outputs of a step's policies; equal ones where the move is random."""
        anything = masked(torch.zeros_like(outputs), masks)
        return torch.where(self.random_moves[step][:, None], anything, outputs)


class LeagueWorker(RolloutWorker):
    """Gathers with the learner among members of the ``league``."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        assert self.agents.position is not None  # self-play takes two
        self.league = League(self.settings, self.model.policy, self.agents.position)

    def gather(self, rollout: int) -> RolloutBuffer:
        """Step all agents, against members that the rollout's number decides; return the rollout."""
        self.league.begin(rollout)
        return super().gather(rollout)

    def network_beside(self) -> None:
        """Return None: there are several policies."""

    def acting(self) -> Tensor:
        """Return which agents' next decisions are learned from: the learner's."""
        return self.agents.acting & (self.league.players == 0)

    def excluded(self) -> Tensor:
        """Return which moves are random."""
        return self.league.random_moves

    def decide(self, inputs: Inputs, step: int) -> Tensor:
        """Return the outputs of all players' policies; equal ones where the move is random."""
        outputs = self.no_outputs(inputs)
        for policy, theirs in self.league.playing():
            rows = (self.agents.acting & theirs).nonzero()[:, 0]
            some = inputs.pick(rows)
            outputs[rows] = policy(some.obs, some.masks, some.position)
        return self.league.disturbed(outputs, inputs.masks, step)

    def no_outputs(self, inputs: Inputs) -> Tensor:
        """Return outputs of a policy that may do nothing, a row for each agent, to be filled in."""
        return torch.full((len(inputs.obs), self.model.policy.outputs), MASKED, device=self.where)


class RecurrentLeagueWorker(RecurrentWorker, LeagueWorker):
    """Does so with policies that remember, each what its own agents have seen.

    It gathers as :class:`RecurrentWorker` does; what is between is :class:`LeagueWorker`'s.
    """

    def gather(self, rollout: int) -> RolloutBuffer:
        """Step all agents, against members that the rollout's number decides; return the rollout."""
        self.memory = self.memory.masked_fill(self.league.taken_over(rollout)[:, None], 0)
        return super().gather(rollout)

    def decide(self, inputs: Inputs, step: int) -> Tensor:
        """Return the outputs of all players' policies, which remember also a step whose move is random."""
        return self.league.disturbed(super().decide(inputs, step), inputs.masks, step)

    def stepped(self, inputs: Inputs, memory: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return outputs, values and the memories after a step of all agents, each by its player.

        Opponents have no critic: the values of their agents are 0, and their memories are shorter.
        """
        outputs, after = self.no_outputs(inputs), torch.zeros_like(memory)
        values = torch.zeros(len(memory), device=self.where)
        for policy, theirs in self.league.playing():
            rows = theirs.nonzero()[:, 0]
            some = one_step(inputs.pick(rows), memory[rows])
            if policy is self.model.policy:
                outputs[rows], values[rows], (after[rows],) = self.model.unrolled(some)
                continue
            size = policy.about["width"]
            flat, recall = some.recall()
            recall = recall._replace(memory=recall.memory[:, :size])
            made = policy.unrolled(flat.obs, flat.masks, flat.position, recall)
            outputs[rows], (after[rows, :size],) = made
        return outputs, values, after
