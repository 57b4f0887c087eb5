"""Proximal policy optimisation, one policy for all agents (Schulman et al., 2017, arXiv:1707.06347).

A batch is tens of thousands of agents wide and few steps deep, so a rollout is a handful of calls of the
network, and its noise is averaged away within a step. :mod:`pearl_marl.training.rollout` gathers rollouts;
this module learns from them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from pearl_marl.spec import EnvSpec
from pearl_marl.training.actor_critic import ActorCritic
from pearl_marl.training.dense_ppo import PPOGradients, descend, fits, in_one_loop
from pearl_marl.training.on_policy import OnPolicyTrainer
from pearl_marl.training.rollout import RolloutBuffer
from pearl_marl.training.settings import BlockSettings, count, number


@dataclass(frozen=True, kw_only=True)
class PPOSettings(BlockSettings):
    """What a run of PPO depends on beside :class:`BlockSettings`, each said beside its default."""

    rollout_length: int = count(32, formerly="depth")
    epochs: int = count(4)  # how often an update goes through its experience
    minibatch: int = count(4096)  # steps of single agents to learn from at a time
    discount: float = number(0.98, most=1)  # gamma of the advantages
    gae_lambda: float = number(0.9, most=1, formerly="trace")  # of the advantages
    clip: float = number(0.2, above=True)  # how far a probability may move in an update, as a ratio
    entropy: float = number(0.0)  # its weight in the loss
    # Of the policy where it is used; 0 takes the most probable actions.
    temperature: float = number(0.0, formerly="chance")


class PPO(OnPolicyTrainer):
    """A run of PPO. In worlds it is IPPO: each agent goes by its observations."""

    central = False
    """Whether the critic is given the state of the world."""

    losses = ("policy_loss", "value_loss", "entropy", "clipped")
    max_grad_norm = 0.5

    @property
    def together(self) -> int:
        """See :class:`OnPolicyTrainer`."""
        # In games of turns, only one agent of a world learns from a step.
        apart = self.policy.remembers or self.policy.spec.turns
        return 1 if apart else self.model.agents_per_state

    def made(self, spec: EnvSpec, settings: PPOSettings) -> ActorCritic:
        """Return the model that is learned."""
        return ActorCritic(spec, settings, self.central)

    def loops(self, samples: RolloutBuffer) -> PPOGradients | None:
        """See :class:`OnPolicyTrainer`."""
        if not fits(self.model):
            return None
        return PPOGradients(self.model, samples, self.settings.clip, self.settings.entropy)

    def descend(self, samples: RolloutBuffer, rows: Tensor, rate: float) -> Tensor:
        """Learn from minibatches of these rows; where they and networks are small, in one compiled loop."""
        if not in_one_loop(self.model, self.minibatch):
            return super().descend(samples, rows, rate)
        minibatches = list(self.minibatches(rows))
        return descend(self.model, samples, minibatches, self.optimiser, rate, self.settings, self.threads)

    def autograd(self, samples: RolloutBuffer, minibatch: Tensor) -> Tensor:
        """Leave the gradients of a minibatch's loss with the parameters.

        Return the policy's loss, the critic's, the entropy, and the share of ratios that were clipped.
        """
        clip = self.settings.clip
        whole = samples.advantages
        if self.policy.remembers:
            whole = whole[:, minibatch][samples.loss_mask[:, minibatch]]
        else:
            whole = whole[minibatch]

        def loss(rows: Tensor) -> tuple[Tensor, Tensor]:
            outputs, values, batch = self.forward(samples, rows)
            log_probs, entropy = self.model.evaluate(outputs, batch.actions)
            ratio = (log_probs - batch.log_probs).exp()
            advantages = batch.advantages
            if len(whole) > 1:  # a single one has no deviation
                deviation, mean = torch.std_mean(whole)
                advantages = (advantages - mean) / (deviation + 1e-8)
            policy_loss = -torch.min(ratio * advantages, ratio.clamp(1 - clip, 1 + clip) * advantages).mean()
            value_loss = (values - batch.returns).square().mean()
            clipped = ((ratio - 1).abs() > clip).float().mean()
            figures = torch.stack((policy_loss, value_loss, entropy, clipped))
            return policy_loss + 0.5 * value_loss - self.settings.entropy * entropy, figures

        return self.halves.find(minibatch, loss, partial(self.terms, samples))


class MAPPO(PPO):
    """PPO whose critic is given the state of the whole world (Yu et al., 2022, arXiv:2103.01955).

    The policy is PPO's: each agent acts by its own observations.
    """

    central = True
