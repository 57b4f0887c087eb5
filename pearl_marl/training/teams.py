"""Q-learning of teams: PQN by the value of a world's whole team, which a mixer makes of its agents' values.

Targets are lambda-returns of the team's reward. Agents act by their own values, as in PQN. An agent that
ended before its world has no part in the team's value.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec
from pearl_marl.training.action_values import ActionValues
from pearl_marl.training.mixers import MonotonicMixer, SumMixer
from pearl_marl.training.pqn import PQN, PQNSettings
from pearl_marl.training.rollout import RolloutBuffer
from pearl_marl.training.settings import WIDEST, choice, count


@dataclass(frozen=True, kw_only=True)
class VDNSettings(PQNSettings):
    """What a run of VDN depends on: PQN's settings, of which an agent's own rewards are none of a team."""

    rewards: str = choice("sum", "mean")  # the team's reward, of the rewards of its agents


@dataclass(frozen=True, kw_only=True)
class QMIXSettings(VDNSettings):
    """What a run of QMIX depends on: VDN's settings, and this."""

    mixer_width: int = count(32, most=WIDEST)  # of the mixer's hidden layer


class VDN(PQN):
    """A run of VDN: the value of a team is the sum of its agents'."""

    of_teams = True

    def __init__(self, spec: EnvSpec, device: Any, settings: VDNSettings) -> None:
        if spec.agents < 2:
            raise ArgumentError(f"{spec.name} has one agent in a world, and a team has several: use pqn")
        if spec.turns:
            raise ArgumentError(f"a team acts at once, and in {spec.name} agents take turns: use self-play")
        super().__init__(spec, device, settings)

    def made(self, spec: EnvSpec, settings: Any) -> ActionValues:
        """Return the model that is learned."""
        return ActionValues(spec, settings, SumMixer())

    def learn(self, samples: RolloutBuffer, rows: Tensor) -> None:
        """Learn from these rows, or chunks, of a rollout, and from those of their whole worlds."""
        super().learn(samples, torch.unique(rows // self.team))

    def autograd(self, samples: RolloutBuffer, minibatch: Tensor) -> Tensor:
        """Leave the gradients of the loss of some worlds with the parameters; return the loss."""

        def loss(worlds: Tensor) -> tuple[Tensor, Tensor]:
            rows = worlds[:, None] * self.team + torch.arange(self.team, device=self.where)
            outputs, _, batch = self.all_steps(samples, rows.flatten())
            mixer, state = self.model.mixer, batch.inputs.state
            acting = batch.loss_mask.view(-1, self.team)
            chosen = outputs.gather(1, batch.actions[:, None]).view_as(acting).masked_fill(~acting, 0)
            values = mixer(chosen, None if state is None else state[:: self.team])
            errors = values - batch.returns.view_as(acting)[:, 0]
            if self.policy.remembers:  # of other teams, somebody acts: see learn()
                errors = errors[acting.any(1)]
            mean = 0.5 * errors.square().mean()
            return mean, mean[None]

        return self.halves.find(minibatch, loss, partial(self.terms, samples))


class QMIX(VDN):
    """A run of QMIX: the value of a team rises with each agent's, as far as the state of the world says."""

    def made(self, spec: EnvSpec, settings: Any) -> ActionValues:
        """Return the model that is learned."""
        return ActionValues(spec, settings, MonotonicMixer(spec, settings.mixer_width))
