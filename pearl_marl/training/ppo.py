"""Proximal policy optimisation, one policy for all agents (Schulman et al., 2017, arXiv:1707.06347).

A batch is tens of thousands of agents wide and few steps deep, so a rollout is a handful of calls of
the network, and its noise is averaged away within a step. Here is learned;
it is gathered by :mod:`pearl_marl.training.rollout`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from pearl_marl.errors import ArgumentError
from pearl_marl.policies.network import SHARING
from pearl_marl.spec import MAX_SLOTS, EnvSpec
from pearl_marl.training.actor_critic import ActorCritic, View
from pearl_marl.training.adam import Adam
from pearl_marl.training.dense_ppo import Learning, fits
from pearl_marl.training.rollout import TEAM, Experience, RolloutWorker, Trainer, seen_spec
from pearl_marl.training.settings import SEEDS, WIDEST, TrainerSettings, check_memory, choice, count, number
from pearl_marl.training.workers import RayWorkers


@dataclass(frozen=True)
class PPOSettings(TrainerSettings):
    """What a run of PPO depends on, each said beside its default.

    Agents are in blocks, which the policy sees one at a time, each with random numbers of its own. What is
    learned depends on them, and not on how many workers share them.
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
    reward_scale: float = number(1.0, above=True)  # what rewards are multiplied with before anything else
    width: int = count(64, most=WIDEST)  # of the networks' layers
    sharing: str = choice(*SHARING)  # what a world's agents share: all; all but being told who they are; none
    rewards: str = choice(*TEAM)  # what an agent wants: its own, or the mean or the sum of its world's
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
    """A run of PPO: :meth:`iterate` is one update. In worlds it is IPPO, as each agent goes by what it sees.

    Learned is where the device has its observations: with ``"cuda"``, on the GPU. This process gathers
    experience, or as many of Ray's as ``shards`` says; what is learned is the same.
    """

    central = False
    """Whether the critic is given the state of the world."""

    gathers: type[RolloutWorker] = RolloutWorker
    """What gathers experience in this process."""

    def __init__(self, spec: EnvSpec, device: Any, settings: PPOSettings, shards: int | None = None) -> None:
        # Of every step at least an observation, and six numbers of its experience.
        rows = settings.n_agents * settings.rollout_length
        check_memory(
            seen_spec(spec, device), settings, device, ("n_agents", "rollout_length"), rows, 6 * 4 * rows
        )
        torch.manual_seed(settings.seed)
        self.model = ActorCritic(spec, settings.width, settings.sharing, settings.temperature, self.central)
        self.worker: Any
        if shards is None:
            self.worker = self.gathers(spec, device, settings, self.model)
            agents = self.worker.agents
        else:
            agents = self.worker = RayWorkers(spec, device, settings, self.model, shards)
        super().__init__(settings, agents, self.worker.where)
        self.depth = settings.rollout_length
        self.model.to(self.where)
        self.policy = self.model.policy
        self.optimiser = Adam(self.model.parameters(), epsilon=1e-5, longest=0.5)
        self.learned = {"model": self.model, "optimiser": self.optimiser}
        self.losses = torch.zeros(4, device=self.where)

    def update(self) -> None:
        """Gather experience and learn from it."""
        experience = self.worker.gather(self.done)
        self.count(experience)
        view, rows = experience.view.flat(), experience.learned.flatten().nonzero()[:, 0]
        if len(rows):
            self.model.see(view if len(rows) == len(view.obs) else view.pick(rows))
            parts = [part.flatten(0, 1) for part in experience[1:5]]
            learn: Any = partial(self.learn_by_torch, view, parts)
            if fits(self.model):
                learn = Learning(self.model, view, parts, self.settings.clip, self.settings.entropy)
            rate = self.settings.learning_rate * (1 - self.done / self.settings.iterations)
            losses = []
            for some in self._minibatches(rows):
                losses.append(learn(some))
                self.optimiser.step(rate)
            self.losses = torch.stack(losses).mean(0)
            self.check(self.losses)
        self.done += 1

    def count(self, experience: Experience) -> None:
        """Count the episodes that ended."""
        self.episodes.add(experience.rewards, experience.ended)

    def figures(self) -> dict[str, float | None]:
        """Return figures for the metrics: of episodes since they were last asked for, and the last losses."""
        names = ("policy_loss", "value_loss", "entropy", "clipped")
        return {**super().figures(), **dict(zip(names, self.losses.tolist(), strict=True))}

    def _minibatches(self, rows: Tensor) -> Iterator[Tensor]:
        for _ in range(self.settings.epochs):
            order = torch.randperm(len(rows), generator=self.random, device=self.where)
            yield from torch.split(rows[order], self.settings.minibatch)

    def learn_by_torch(self, view: View, parts: list[Tensor], rows: Tensor) -> Tensor:
        """Find the gradients of some rows; return policy loss, value loss, entropy, share clipped."""
        clip, n = self.settings.clip, len(rows)
        actions, old_logs, advantages, returns = (part[rows] for part in parts)
        outputs, values = self.model(view.pick(rows))
        with torch.no_grad():
            logs, entropy, gradients = self.model.weigh(outputs, actions)
            ratio = (logs - old_logs).exp()
            if n > 1:  # one alone has no deviation
                deviation, mean = torch.std_mean(advantages)
                advantages = (advantages - mean) / (deviation + 1e-8)
            gains, clipped = ratio * advantages, ratio.clamp(1 - clip, 1 + clip) * advantages
            policy_loss = -torch.min(gains, clipped).mean()
            apart = values - returns
            # A ratio that has gone too far is not pulled further.
            by_logs = torch.where(gains <= clipped, gains, 0) / -n
            by = [(values, apart / n), *gradients(by_logs, -self.settings.entropy)]
        self.optimiser.backward(by)
        far = ((ratio - 1).abs() > clip).float().mean()
        return torch.stack((policy_loss, apart.square().mean(), entropy, far))


class MAPPO(PPO):
    """PPO whose critic is given the state of the whole world (Yu et al., 2022, arXiv:2103.01955).

    The policy is what PPO's is: each agent acts by what it observes.
    """

    central = True
