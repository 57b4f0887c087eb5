"""Deep Q-learning, one network for all agents (Mnih et al., 2015, doi:10.1038/nature14236).

With double estimation (van Hasselt et al., 2016, arXiv:1509.06461). All agents explore at once, each with its
own share of random actions, and the replay memory holds their last steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from pearl_marl.policies.network import NetworkPolicy
from pearl_marl.spec import EnvSpec
from pearl_marl.training.rollout import Agents, Returns, go_on, kept
from pearl_marl.training.settings import (
    SEEDS,
    SLOTS,
    WIDEST,
    Checked,
    check_memory,
    count,
    number,
    observation_bytes,
)


@dataclass(frozen=True)
class Settings(Checked):
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

    n_agents: int = count(512, most=SLOTS)
    iterations: int = count(1000)
    memory: int = count(200)
    warm_up: int = count(10, least=0)
    updates: int = count(4)
    minibatch: int = count(256)
    learning_rate: float = number(2e-3, most=1, above=True)
    discount: float = number(0.99, most=1)
    refresh: int = count(50)
    explore_first: float = number(1.0, most=1)
    explore_last: float = number(0.02, most=1)
    exploring: float = number(0.2, most=1, above=True)
    reward_scale: float = number(1.0, above=True)
    width: int = count(64, most=WIDEST)
    seed: int = count(0, least=0, most=SEEDS)


class DQN:
    """A run of DQN: :meth:`iterate` is a step of all agents with its updates."""

    def __init__(self, spec: EnvSpec, device: Any, settings: Settings) -> None:
        n, depth = settings.n_agents, settings.memory
        # Of every step in memory two observations, action, reward and end; of those learned from, no less.
        needed = (n * depth + settings.minibatch) * (2 * observation_bytes(spec) + 13)
        check_memory(spec, settings, ("n_agents", "memory", "minibatch"), needed, device)
        self.settings = settings
        torch.manual_seed(settings.seed)
        self.policy = NetworkPolicy(spec, "values", settings.width)
        self.target = NetworkPolicy(spec, "values", settings.width)
        self.agents = Agents(spec, device, n, settings.seed)
        obs = self.agents.obs
        where = self.where = obs.device
        self.random = torch.Generator(where).manual_seed(settings.seed)
        self.policy.to(where)
        self.target.to(where)
        self.target.load_state_dict(self.policy.state_dict())
        self.optimiser = torch.optim.Adam(self.policy.parameters(), lr=settings.learning_rate, fused=True)
        self.evaluated = 1000
        self.episodes = Returns(n, where)
        self.losses: list[Tensor] = []
        one = obs.shape[1:]
        # A row a step: what was seen, done, got, where it led, and whether that was the end of it.
        self.memory = {
            "obs": torch.zeros((depth, n, *one), dtype=obs.dtype, device=where),
            "actions": torch.zeros((depth, n), dtype=torch.int64, device=where),
            "rewards": torch.zeros((depth, n), device=where),
            "arrivals": torch.zeros((depth, n, *one), dtype=obs.dtype, device=where),
            "over": torch.zeros((depth, n), dtype=torch.bool, device=where),
        }
        self.done = self.updated = 0

    @property
    def agent_steps(self) -> int:
        """Steps of single agents so far."""
        return self.done * self.settings.n_agents

    def iterate(self) -> None:
        """Step all agents and learn."""
        self._step()
        if self.done > self.settings.warm_up:
            self.losses = [self._learn() for _ in range(self.settings.updates)]

    def figures(self) -> dict[str, float | None]:
        """Return figures for the metrics: of episodes since they were last asked for, and the last losses."""
        loss = torch.stack(self.losses).mean().item() if self.losses else None
        return {**self.episodes.take(), "loss": loss, "explored": self.explored}

    @property
    def explored(self) -> float:
        """The share of actions that is random now."""
        settings = self.settings
        passed = min(1.0, self.done / (settings.exploring * settings.iterations))
        return settings.explore_first + passed * (settings.explore_last - settings.explore_first)

    def _step(self) -> None:
        settings, n, obs = self.settings, self.settings.n_agents, self.agents.obs
        self.policy.network.encoder.see(obs)
        random = torch.rand(n, generator=self.random, device=self.where) < self.explored
        anything = torch.randint(self.policy.outputs, (n,), generator=self.random, device=self.where)
        actions = torch.where(random, anything, self.policy.best(obs))
        step: Any = self.agents.step(actions)
        self.episodes.add(step.rewards[None], step.ended[None])
        row = self.done % settings.memory
        for name, value in (
            ("obs", obs),
            ("actions", actions),
            ("rewards", step.rewards * settings.reward_scale),
            ("arrivals", step.arrivals()),
            ("over", step.terminations),
        ):
            self.memory[name][row] = value
        self.done += 1

    def _learn(self) -> Tensor:
        settings = self.settings
        rows = min(self.done, settings.memory)
        chosen = torch.randint(
            rows * settings.n_agents, (settings.minibatch,), generator=self.random, device=self.where
        )
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
        return loss.detach()

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
            "agents": kept(self.agents),
            "episodes": self.episodes.state(),
        }

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        self.done, self.updated = state["done"], state["updated"]
        self.policy.load_state_dict(state["policy"])
        self.target.load_state_dict(state["target"])
        self.optimiser.load_state_dict(state["optimiser"])
        for name, rows in self.memory.items():
            rows.copy_(state["memory"][name])
        self.random.set_state(state["random"])
        go_on(self.agents, state["agents"])
        self.episodes.load(state["episodes"])
