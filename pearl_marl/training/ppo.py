"""Proximal policy optimisation, one policy for all agents (Schulman et al., 2017, arXiv:1707.06347).

A batch is tens of thousands of agents wide and few steps deep, so a rollout is a handful of calls of the
network, and its noise is averaged away within a step. :mod:`pearl_marl.training.rollout` gathers rollouts;
this module learns from them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from pearl_marl.errors import ArgumentError
from pearl_marl.policies.network import SHARING
from pearl_marl.spec import MAX_SLOTS, EnvSpec
from pearl_marl.training.actor_critic import ActorCritic
from pearl_marl.training.adam import Adam
from pearl_marl.training.agents import TEAM, observed_spec
from pearl_marl.training.dense_ppo import CompiledGradients, fits
from pearl_marl.training.rollout import RolloutBuffer, RolloutWorker
from pearl_marl.training.settings import SEEDS, WIDEST, TrainerSettings, check_memory, choice, count, number
from pearl_marl.training.trainer import Trainer
from pearl_marl.training.workers import RayWorkers


@dataclass(frozen=True)
class PPOSettings(TrainerSettings):
    """What a run of PPO depends on, each said beside its default.

    Agents are in blocks, which the policy is given one at a time, each with random numbers of its own. The
    result depends on the number of blocks, and not on the number of workers that share them.
    """

    n_agents: int = count(1024, most=MAX_SLOTS)  # that gather experience
    rollout_length: int = count(32, formerly="depth")  # steps of each between updates
    iterations: int = count(60)  # updates in all
    epochs: int = count(4)  # how often an update goes through its experience
    minibatch: int = count(4096)  # steps of single agents to learn from at a time
    learning_rate: float = number(3e-3, most=1, above=True)  # of Adam, at first; falls to 0 evenly
    discount: float = number(0.98, most=1)  # gamma of the advantages
    gae_lambda: float = number(0.9, most=1, formerly="trace")  # of the advantages
    clip: float = number(0.2, above=True)  # how far a probability may move in an update, as a ratio
    entropy: float = number(0.0)  # its weight in the loss
    reward_scale: float = number(1.0, above=True)  # factor of rewards, before anything else
    width: int = count(64, most=WIDEST)  # of the networks' layers
    sharing: str = choice(*SHARING)  # of networks, among the agents of a world
    rewards: str = choice(*TEAM)  # an agent's own, or the mean or sum of its world's
    # Of the policy where it is used; 0 takes the most probable actions.
    temperature: float = number(0.0, formerly="chance")
    blocks: int = count(1, most=MAX_SLOTS)
    seed: int = count(0, least=0, most=SEEDS)  # of everything random

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.blocks > self.n_agents:
            raise ArgumentError(
                f"setting 'blocks' is {self.blocks}; it must be 1 to {self.n_agents}, the number of agents"
            )


class PPO(Trainer):
    """A run of PPO: :meth:`iterate` is one update. In worlds it is IPPO: each agent goes by its observations.

    It learns where the device has its observations: with ``"cuda"``, on the GPU. This process gathers
    rollouts, or as many of Ray's as ``shards`` says; the result is the same.
    """

    central = False
    """Whether the critic is given the state of the world."""

    gathers: type[RolloutWorker] = RolloutWorker
    """The class that gathers rollouts in this process."""

    def __init__(self, spec: EnvSpec, device: Any, settings: PPOSettings, shards: int | None = None) -> None:
        # Of every step at least an observation, and six numbers more.
        rows = settings.n_agents * settings.rollout_length
        names = "n_agents", "rollout_length"
        check_memory(observed_spec(spec, device), settings, device, names, rows, 6 * 4 * rows)
        torch.manual_seed(settings.seed)
        self.model = ActorCritic(spec, settings.width, settings.sharing, settings.temperature, self.central)
        self.worker: Any
        if shards is None:
            self.worker = self.gathers(spec, device, settings, self.model)
            agents = self.worker.agents
        else:
            agents = self.worker = RayWorkers(spec, device, settings, self.model, shards)
        super().__init__(settings, agents, self.worker.where)
        self.steps_per_iteration = settings.rollout_length
        self.model.to(self.where)
        self.policy = self.model.policy
        self.optimiser = Adam(self.model.parameters(), epsilon=1e-5, max_grad_norm=0.5)
        self.components = {"model": self.model, "optimiser": self.optimiser}
        self.losses = torch.zeros(4, device=self.where)

    def update(self) -> None:
        """Gather a rollout and learn from it."""
        rollout = self.worker.gather(self.done)
        self.count(rollout)
        samples = rollout.flat()
        rows = samples.loss_mask.nonzero()[:, 0]
        if len(rows):
            inputs = samples.inputs
            self.model.see(inputs if len(rows) == len(inputs.obs) else inputs.pick(rows))
            self.learn(samples, rows)
        self.done += 1

    def learn(self, samples: RolloutBuffer, rows: Tensor) -> None:
        """Learn from these rows of a rollout, whose steps and agents are one axis."""
        settings = self.settings
        gradients: Callable[[Tensor], Tensor] = partial(self.gradients, samples)
        if fits(self.model):
            gradients = CompiledGradients(self.model, samples, settings.clip, settings.entropy)
        rate = settings.learning_rate * (1 - self.done / settings.iterations)
        losses = []
        for minibatch in self._minibatches(rows):
            losses.append(gradients(minibatch))
            self.optimiser.step(rate)
        self.losses = torch.stack(losses).mean(0)
        self.check(self.losses)

    def gradients(self, samples: RolloutBuffer, minibatch: Tensor) -> Tensor:
        """Leave the gradients of a minibatch's loss with the parameters.

        Return the policy's loss, the critic's, the entropy, and the share of ratios that were clipped.
        """
        clip, n = self.settings.clip, len(minibatch)
        outputs, values = self.model(samples.inputs.pick(minibatch))
        log_probs, entropy = self.model.evaluate(outputs, samples.actions[minibatch])
        ratio = (log_probs - samples.log_probs[minibatch]).exp()
        advantages = samples.advantages[minibatch]
        if n > 1:  # a single one has no deviation
            deviation, mean = torch.std_mean(advantages)
            advantages = (advantages - mean) / (deviation + 1e-8)
        policy_loss = -torch.min(ratio * advantages, ratio.clamp(1 - clip, 1 + clip) * advantages).mean()
        value_loss = (values - samples.returns[minibatch]).square().mean()
        loss = policy_loss + 0.5 * value_loss - self.settings.entropy * entropy
        self.optimiser.zero_grad()
        loss.backward()
        clipped = ((ratio - 1).abs() > clip).float().mean()
        return torch.stack((policy_loss, value_loss, entropy, clipped)).detach()

    def count(self, rollout: RolloutBuffer) -> None:
        """Count the episodes that ended."""
        self.episodes.add(rollout.rewards, rollout.ended)

    def figures(self) -> dict[str, float | None]:
        """Return figures for the metrics: of episodes since they were last asked for, and the last losses."""
        names = ("policy_loss", "value_loss", "entropy", "clipped")
        return {**super().figures(), **dict(zip(names, self.losses.tolist(), strict=True))}

    def _minibatches(self, rows: Tensor) -> Iterator[Tensor]:
        for _ in range(self.settings.epochs):
            order = torch.randperm(len(rows), generator=self.random, device=self.where)
            yield from torch.split(rows[order], self.settings.minibatch)


class MAPPO(PPO):
    """PPO whose critic is given the state of the whole world (Yu et al., 2022, arXiv:2103.01955).

    The policy is PPO's: each agent acts by its own observations.
    """

    central = True
