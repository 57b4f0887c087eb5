"""Self-play: PPO against its past selves, for games with a winner.

From time to time the policy, as it is, joins the *league*, and stays there. In some worlds the learner plays
all sides, in the others one, against members of the league. So it cannot forget how to beat earlier policies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pearl_marl.errors import ArgumentError
from pearl_marl.policies.policy_file import check_weights
from pearl_marl.policies.trained import NetworkPolicy
from pearl_marl.spec import EnvSpec
from pearl_marl.training import ppo
from pearl_marl.training.league import League, LeagueWorker, RecurrentLeagueWorker
from pearl_marl.training.restoring import whole
from pearl_marl.training.rollout import RolloutBuffer
from pearl_marl.training.settings import count, number


@dataclass(frozen=True, kw_only=True)
class SelfPlaySettings(ppo.PPOSettings):
    """What a run depends on: PPO's settings, and these."""

    join_every: int = count(10)  # iterations, after which the policy joins the league; and it does at first
    opponents: int = count(4)  # members of the league that are met in a rollout
    random_moves: float = number(0.1, most=1)  # share of moves, so that games differ; not learned from
    mirrored: float = number(0.5, most=1)  # share of worlds in which the learner plays all sides


class SelfPlay(ppo.PPO):
    """A run of self-play: :meth:`iterate` is one update."""

    gathers = LeagueWorker, RecurrentLeagueWorker

    def __init__(self, spec: EnvSpec, device: Any, settings: SelfPlaySettings) -> None:
        if spec.agents < 2:
            raise ArgumentError(f"{spec.name} has one agent in a world, and self-play takes two: use ppo")
        super().__init__(spec, device, settings)
        self.league: League = self.worker.league
        self.league.join(0)

    def update(self) -> None:
        """Gather a rollout and learn from it; join the league, if it is time."""
        super().update()
        if self.done % self.settings.join_every == 0:
            self.league.join(self.done)

    def count(self, rollout: RolloutBuffer) -> None:
        """Count the episodes that ended: the learner's against the league, as against itself it wins half."""
        players = self.league.players.reshape(-1, self.worker.spec.agents)
        counted = ((players == 0) & (players != 0).any(1, keepdim=True)).flatten()
        self.episodes.add(rollout.rewards * counted, rollout.ended & counted)

    @property
    def past(self) -> dict[int, NetworkPolicy]:
        """The members of the league, by the iterations after which they joined."""
        return {done: self.league.member(done) for done in self.league.members}

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on."""
        return {**super().state(), "league": self.league.members}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        super().load(state)
        if 0 not in state["league"]:
            raise ArgumentError("its league lacks the member of iteration 0, which is the first to join")
        members = self.league.members
        members.clear()
        for done, weights in state["league"].items():
            if whole("number of iterations of a member of the league", done) > self.done:
                raise ArgumentError(f"its league has a member of iteration {done}, and {self.done} are done")
            check_weights(self.policy, weights, f"{self.policy.spec.name}'s member {done} of the league")
            members[done] = {name: tensor.to(self.where) for name, tensor in weights.items()}
