"""Proximal policy optimisation, one policy for all agents (Schulman et al., 2017, arXiv:1707.06347).

A batch is tens of thousands of agents wide and few steps deep, so a rollout is a handful of calls of
the network, and its noise is averaged away within a step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical, Normal

import pearl_marl
from pearl_marl.devices import BatchStep
from pearl_marl.episodes import EpisodeStatistics
from pearl_marl.spec import EnvSpec

from .policy import Network, Policy


@dataclass(frozen=True)
class Settings:
    """What a run of PPO depends on.

    Attributes
    ----------
    n_agents
        Agents that gather experience.
    depth
        Steps of each between updates.
    iterations
        Updates in all.
    epochs, minibatch
        How often an update goes through its experience, and in parts of how many steps.
    learning_rate
        Of Adam, at first; falls to 0 evenly.
    discount, trace
        Gamma and lambda of the advantages.
    clip
        How far a probability may move in an update, as a ratio.
    entropy
        Weight of the entropy in the loss.
    reward_scale
        What rewards are multiplied with before anything else.
    width
        Of the networks' layers.
    """

    n_agents: int = 1024
    depth: int = 32
    iterations: int = 60
    epochs: int = 4
    minibatch: int = 4096
    learning_rate: float = 3e-3
    discount: float = 0.98
    trace: float = 0.9
    clip: float = 0.2
    entropy: float = 0.0
    reward_scale: float = 1.0
    width: int = 64
    seed: int = 0


class PPO:
    """A run of PPO: :meth:`iterate` is one update, and :meth:`state` all that the next depends on."""

    def __init__(self, spec: EnvSpec, device: Any, settings: Settings) -> None:
        self.settings = settings
        torch.manual_seed(settings.seed)
        self.random = torch.Generator().manual_seed(settings.seed)
        self.env = pearl_marl.parallel_env(spec.name, settings.n_agents, device=device, **spec.options)
        self.continuous = not hasattr(spec.action_space, "n")
        self.policy = Policy(spec, "mean" if self.continuous else "logits", settings.width)
        encoder, width = self.policy.network.encoder, settings.width
        # Of a picture, most of the work is to see what is on it: actor and critic do that together.
        self.shared = encoder.kind == "picture"
        self.encoders = [encoder]
        self.critic: nn.Module = nn.Linear(width, 1)
        if not self.shared:
            network = Network(spec.observation_space, 1, width)
            self.encoders, self.critic = [encoder, network.encoder], network
        self.log_deviation = nn.Parameter(torch.full((1,), -0.5))
        self.parameters = [*self.policy.parameters(), *self.critic.parameters()]
        if self.continuous:
            self.parameters.append(self.log_deviation)
        self.optimiser = torch.optim.Adam(self.parameters, lr=settings.learning_rate, eps=1e-5, fused=True)
        self.evaluated = 1000
        self.statistics = EpisodeStatistics(settings.n_agents)
        self.obs = torch.from_numpy(self.env.reset_batch(settings.seed))
        self.done = 0

    @property
    def agent_steps(self) -> int:
        """Steps of single agents so far."""
        return self.done * self.settings.depth * self.settings.n_agents

    def judge(self, obs: Tensor) -> tuple[Tensor, Tensor]:
        """Return the policy's outputs, and the critic's values, shape ``(batch,)``."""
        if not self.shared:
            return self.policy(obs), self.critic(obs)[:, 0]
        features = self.policy.network.features(obs)
        return self.policy.network.output(features), self.critic(features)[:, 0]

    def distribution(self, outputs: Tensor) -> Categorical | Normal:
        """Return what actions are drawn from."""
        if self.continuous:
            return Normal(outputs, self.log_deviation.exp())
        return Categorical(logits=outputs, validate_args=False)

    def log_probabilities(self, chosen: Categorical | Normal, actions: Tensor) -> Tensor:
        """Return the logarithm of how probable each action was."""
        logs: Tensor = chosen.log_prob(actions)  # type: ignore[no-untyped-call]
        return logs.sum(1) if self.continuous else logs

    def iterate(self) -> dict[str, float | None]:
        """Gather experience and learn from it; return figures for the metrics."""
        settings = self.settings
        for group in self.optimiser.param_groups:
            group["lr"] = settings.learning_rate * (1 - self.done / settings.iterations)
        self.statistics.clear()
        rollout = self._gather()
        losses = [self._learn(*part) for part in self._minibatches(*rollout)]
        self.done += 1
        figures = np.mean(losses, 0)
        summary = self.statistics.summary()
        return {
            "train_return": summary["return_mean"],
            "train_length": summary["length_mean"],
            "episodes": summary["episodes"],
            "policy_loss": float(figures[0]),
            "value_loss": float(figures[1]),
            "entropy": float(figures[2]),
            "clipped": float(figures[3]),
        }

    @torch.no_grad()
    def _gather(self) -> tuple[Tensor, ...]:
        """Step all agents; return observations, actions, their log-probabilities, advantages and returns."""
        settings, depth, n = self.settings, self.settings.depth, self.settings.n_agents
        seen, taken, logs, rewards, ended, values = [], [], [], [], [], []
        for _ in range(depth):
            obs = self.obs
            for encoder in self.encoders:
                encoder.see(obs)
            outputs, value = self.judge(obs)
            if self.continuous:
                noise = torch.randn(outputs.shape, generator=self.random)
                actions = outputs + self.log_deviation.exp() * noise
                given = self.policy.within_bounds(actions)
            else:
                # Gumbel's trick: one draw an action, instead of cumulated probabilities.
                uniform = torch.rand(outputs.shape, generator=self.random).clamp_(1e-20)
                actions = given = (outputs - (-uniform.log()).log()).argmax(1)
            step = self.env.step_batch(given.numpy())
            self.statistics.add(step)
            seen.append(obs)
            taken.append(actions)
            logs.append(self.log_probabilities(self.distribution(outputs), actions))
            values.append(value)
            rewards.append(self._rewards(step))
            ended.append(torch.from_numpy(step.ended))
            self.obs = torch.from_numpy(step.obs)
        values.append(self.judge(self.obs)[1])

        advantages = torch.empty(depth, n)
        advantage = torch.zeros(n)
        for t in reversed(range(depth)):
            going_on = (~ended[t]).float()
            error = rewards[t] + settings.discount * values[t + 1] * going_on - values[t]
            advantage = error + settings.discount * settings.trace * going_on * advantage
            advantages[t] = advantage
        returns = advantages + torch.stack(values[:-1])
        flat = advantages.flatten()
        return torch.cat(seen), torch.cat(taken), torch.cat(logs), flat, returns.flatten()

    def _rewards(self, step: BatchStep) -> Tensor:
        """Return rewards; where only the time limit ended an episode, with the value of what was to come."""
        rewards = torch.from_numpy(step.rewards) * self.settings.reward_scale
        cut = np.flatnonzero(step.truncations & ~step.terminations)
        if cut.size:
            final = torch.from_numpy(step.final_obs[cut])
            rewards[cut] += self.settings.discount * self.judge(final)[1]
        return rewards

    def _minibatches(self, *rollout: Tensor) -> Iterator[tuple[Tensor, ...]]:
        size = len(rollout[0])
        for _ in range(self.settings.epochs):
            order = torch.randperm(size, generator=self.random)
            for chosen in torch.split(order, self.settings.minibatch):
                yield tuple(part[chosen] for part in rollout)

    def _learn(
        self, obs: Tensor, actions: Tensor, old_logs: Tensor, advantages: Tensor, returns: Tensor
    ) -> tuple[float, float, float, float]:
        """Take one step of gradient descent; return policy loss, value loss, entropy, share clipped."""
        clip = self.settings.clip
        outputs, values = self.judge(obs)
        chosen = self.distribution(outputs)
        ratio = (self.log_probabilities(chosen, actions) - old_logs).exp()
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        policy_loss = -torch.min(ratio * advantages, ratio.clamp(1 - clip, 1 + clip) * advantages).mean()
        value_loss = (values - returns).square().mean()
        entropy = chosen.entropy().mean()  # type: ignore[no-untyped-call]
        self.optimiser.zero_grad()
        (policy_loss + 0.5 * value_loss - self.settings.entropy * entropy).backward()
        nn.utils.clip_grad_norm_(self.parameters, 0.5)
        self.optimiser.step()
        clipped = ((ratio - 1).abs() > clip).float().mean()
        return policy_loss.item(), value_loss.item(), entropy.item(), clipped.item()

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on."""
        return {
            "done": self.done,
            "policy": self.policy.state_dict(),
            "critic": self.critic.state_dict(),
            "log_deviation": self.log_deviation.detach(),
            "optimiser": self.optimiser.state_dict(),
            "random": self.random.get_state(),
            "env": self.env.save_state(),
            "statistics": self.statistics,
        }

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        self.done = state["done"]
        self.policy.load_state_dict(state["policy"])
        self.critic.load_state_dict(state["critic"])
        self.log_deviation.data.copy_(state["log_deviation"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.random.set_state(state["random"])
        self.obs = torch.from_numpy(self.env.load_state(state["env"]))
        self.statistics = state["statistics"]
