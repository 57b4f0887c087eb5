"""Deep Q-learning, one network for all agents (Mnih et al., 2015, doi:10.1038/nature14236).

With double estimation (van Hasselt et al., 2016, arXiv:1509.06461). All agents explore at once, each with its
own share of random actions, and the replay memory holds their last steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

import pearl_marl
from pearl_marl.episodes import EpisodeStatistics
from pearl_marl.spec import EnvSpec

from .policy import Policy


@dataclass(frozen=True)
class Settings:
    """What a run of DQN depends on.

    Attributes
    ----------
    n_agents
        Agents that gather experience.
    iterations
        Steps of every agent.
    memory
        How many of every agent's last steps are kept.
    warm_up
        Steps of every agent before the first update.
    updates, minibatch
        Updates after each step of all agents, and how many single steps each learns from.
    learning_rate
        Of Adam.
    discount
        Gamma.
    refresh
        Updates after which the target network becomes a copy of the network.
    explore_first, explore_last, exploring
        Share of random actions at first and at last, and the part of the run in which it falls.
    reward_scale
        What rewards are multiplied with before anything else.
    width
        Of the network's layers.
    seed
        Of everything random.
    """

    n_agents: int = 512
    iterations: int = 1000
    memory: int = 200
    warm_up: int = 10
    updates: int = 4
    minibatch: int = 256
    learning_rate: float = 2e-3
    discount: float = 0.99
    refresh: int = 50
    explore_first: float = 1.0
    explore_last: float = 0.02
    exploring: float = 0.2
    reward_scale: float = 1.0
    width: int = 64
    seed: int = 0


class DQN:
    """A run of DQN: :meth:`iterate` is a step of all agents with its updates."""

    def __init__(self, spec: EnvSpec, device: Any, settings: Settings) -> None:
        self.settings = settings
        torch.manual_seed(settings.seed)
        self.random = torch.Generator().manual_seed(settings.seed)
        n, depth = settings.n_agents, settings.memory
        self.env = pearl_marl.parallel_env(spec.name, n, device=device, **spec.options)
        self.policy = Policy(spec, "values", settings.width)
        self.target = Policy(spec, "values", settings.width)
        self.target.load_state_dict(self.policy.state_dict())
        self.optimiser = torch.optim.Adam(self.policy.parameters(), lr=settings.learning_rate, fused=True)
        self.evaluated = 1000
        self.statistics = EpisodeStatistics(n)
        self.obs = torch.from_numpy(self.env.reset_batch(settings.seed))
        one = self.obs.shape[1:]
        # A row a step: what was seen, done, got, where it led, and whether that was the end of it.
        self.memory = {
            "obs": torch.zeros((depth, n, *one), dtype=self.obs.dtype),
            "actions": torch.zeros((depth, n), dtype=torch.int64),
            "rewards": torch.zeros((depth, n)),
            "arrivals": torch.zeros((depth, n, *one), dtype=self.obs.dtype),
            "over": torch.zeros((depth, n), dtype=torch.bool),
        }
        self.done = self.updated = 0

    @property
    def agent_steps(self) -> int:
        """Steps of single agents so far."""
        return self.done * self.settings.n_agents

    def iterate(self) -> dict[str, float | None]:
        """Step all agents and learn; return figures for the metrics."""
        settings = self.settings
        self._step()
        losses = []
        if self.done > settings.warm_up:
            losses = [self._learn() for _ in range(settings.updates)]
        summary = self.statistics.summary()
        self.statistics.clear()
        return {
            "train_return": summary["return_mean"],
            "train_length": summary["length_mean"],
            "episodes": summary["episodes"],
            "loss": float(np.mean(losses)) if losses else None,
            "explored": self.explored,
        }

    @property
    def explored(self) -> float:
        """The share of actions that is random now."""
        settings = self.settings
        passed = min(1.0, self.done / (settings.exploring * settings.iterations))
        return settings.explore_first + passed * (settings.explore_last - settings.explore_first)

    def _step(self) -> None:
        settings, n = self.settings, self.settings.n_agents
        self.policy.network.encoder.see(self.obs)
        random = torch.rand(n, generator=self.random) < self.explored
        anything = torch.randint(self.policy.outputs, (n,), generator=self.random)
        actions = torch.where(random, anything, self.policy.best(self.obs))
        step = self.env.step_batch(actions.numpy())
        self.statistics.add(step)
        row = self.done % settings.memory
        for name, value in (
            ("obs", self.obs),
            ("actions", actions),
            ("rewards", torch.from_numpy(step.rewards) * settings.reward_scale),
            ("arrivals", torch.from_numpy(step.arrivals())),
            ("over", torch.from_numpy(step.terminations)),
        ):
            self.memory[name][row] = value
        self.obs = torch.from_numpy(step.obs)
        self.done += 1

    def _learn(self) -> float:
        settings = self.settings
        rows = min(self.done, settings.memory)
        chosen = torch.randint(rows * settings.n_agents, (settings.minibatch,), generator=self.random)
        obs, actions, rewards, arrivals, over = (
            part[:rows].reshape(-1, *part.shape[2:])[chosen] for part in self.memory.values()
        )
        with torch.no_grad():
            best = self.policy(arrivals).argmax(1, keepdim=True)
            later = self.target(arrivals).gather(1, best)[:, 0]
            wanted = rewards + settings.discount * later * ~over
        values: Tensor = self.policy(obs).gather(1, actions[:, None])[:, 0]
        loss = nn.functional.smooth_l1_loss(values, wanted)
        self.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.policy.parameters(), 10.0)
        self.optimiser.step()
        self.updated += 1
        if self.updated % settings.refresh == 0:
            self.target.load_state_dict(self.policy.state_dict())
        return loss.item()

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on."""
        return {
            "done": self.done,
            "updated": self.updated,
            "policy": self.policy.state_dict(),
            "target": self.target.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "memory": self.memory,
            "random": self.random.get_state(),
            "env": self.env.save_state(),
            "statistics": self.statistics,
        }

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        self.done, self.updated, self.statistics = state["done"], state["updated"], state["statistics"]
        self.policy.load_state_dict(state["policy"])
        self.target.load_state_dict(state["target"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.memory = state["memory"]
        self.random.set_state(state["random"])
        self.obs = torch.from_numpy(self.env.load_state(state["env"]))
