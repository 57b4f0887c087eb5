"""Tabular Q-learning (Watkins and Dayan, 1992, doi:10.1007/BF00992698), one table for all agents.

All agents explore at once and write into one table. A step's updates are averaged for each entry, so that
one step of all agents is one update of the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import pearl_marl
from pearl_marl.episodes import EpisodeStatistics
from pearl_marl.spec import EnvSpec

from .policy import Table


@dataclass(frozen=True)
class Settings:
    """What a run of Q-learning depends on.

    Attributes
    ----------
    n_agents
        Agents that share the table.
    iterations
        Steps of every agent.
    epsilon
        Share of random actions at first; falls evenly to 0 at 80 % of the run.
    rate
        How far an entry moves towards the mean of its targets, at its first update.
    fading
        After as many updates of an entry, it moves half as far; 0 for always as far.
    discount
        Gamma.
    seed
        Of everything random.
    """

    n_agents: int = 43008
    iterations: int = 300
    epsilon: float = 0.2
    rate: float = 0.5
    fading: float = 0.0
    discount: float = 1.0
    seed: int = 0


EXPLORING = 0.8


class QLearning:
    """A run of Q-learning: :meth:`iterate` is a step of all agents and an update of the table."""

    def __init__(self, spec: EnvSpec, device: Any, settings: Settings) -> None:
        self.settings = settings
        n = settings.n_agents
        self.env = pearl_marl.parallel_env(spec.name, n, device=device, **spec.options)
        self.policy = Table(spec)
        self.random = np.random.default_rng(settings.seed)
        self.statistics = EpisodeStatistics(n)
        self.rows = self.policy.rows(self.env.reset_batch(settings.seed))
        self.updates = np.zeros(self.policy.values.shape)
        self.done = 0

    @property
    def agent_steps(self) -> int:
        """Steps of single agents so far."""
        return self.done * self.settings.n_agents

    def iterate(self) -> dict[str, float | None]:
        """Step all agents and update the table; return figures for the metrics."""
        settings, values, rows = self.settings, self.policy.values, self.rows
        n, n_actions = settings.n_agents, values.shape[1]
        explored = max(0.0, settings.epsilon * (1 - self.done / (EXPLORING * settings.iterations)))
        random = self.random.random(n, np.float32) < explored
        actions = np.where(random, self.random.integers(n_actions, size=n), values.argmax(1)[rows])
        step = self.env.step_batch(actions)
        # Where the step itself led; in its place there may be the next episode's start already.
        later = values.max(1)[self.policy.rows(step.arrivals())]
        targets = step.rewards + settings.discount * later * ~step.terminations
        entries = rows * n_actions + actions
        visits = np.bincount(entries, minlength=values.size).reshape(values.shape)
        sums = np.bincount(entries, targets, minlength=values.size).reshape(values.shape)
        visited = visits > 0
        rate = settings.rate / (1 + settings.fading * self.updates)
        values[visited] += (rate * (sums / np.maximum(visits, 1) - values))[visited]
        self.updates += visited
        self.statistics.add(step)
        self.rows = self.policy.rows(step.obs)
        self.done += 1
        summary = self.statistics.summary()
        self.statistics.clear()
        return {
            "train_return": summary["return_mean"],
            "train_length": summary["length_mean"],
            "episodes": summary["episodes"],
            "explored": explored,
        }

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on."""
        return {
            "done": self.done,
            "values": self.policy.values,
            "updates": self.updates,
            "random": self.random.bit_generator.state,
            "env": self.env.save_state(),
            "statistics": self.statistics,
        }

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        self.done, self.updates, self.statistics = state["done"], state["updates"], state["statistics"]
        self.policy.values[:] = state["values"]
        self.random.bit_generator.state = state["random"]
        self.rows = self.policy.rows(self.env.load_state(state["env"]))
