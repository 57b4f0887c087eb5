"""Tabular Q-learning (Watkins and Dayan, 1992, doi:10.1007/BF00992698), of one learner or of many thousands.

A learner is a table and the agents that write into it, all at once: a step's updates are averaged for each
entry, so that one step of all agents is one update of the table. With as many learners as agents, every
agent learns for itself, from nothing but its own experience.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pearl_marl
from pearl_marl.episodes import EpisodeStatistics
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec

from .policy import Table


@dataclass(frozen=True)
class Settings:
    """What a run of Q-learning depends on.

    Attributes
    ----------
    n_agents
        Agents that gather experience, as many for each learner.
    learners
        Tables; from 1, which all agents share, to ``n_agents``.
    iterations
        Steps of every agent.
    epsilon
        Share of random actions at first; falls evenly to 0 at 80 % of the run.
    rate
        How far an entry moves towards the mean of its targets, at its first update.
    fading
        After ``1 / fading`` updates of an entry, it moves half as far; 0 for always as far.
    discount
        Gamma.
    seed
        Of everything random.
    """

    n_agents: int = 43008
    learners: int = 1
    iterations: int = 300
    epsilon: float = 0.2
    rate: float = 0.5
    fading: float = 0.0
    discount: float = 1.0
    seed: int = 0


EXPLORING = 0.8


class QLearning:
    """A run of Q-learning: :meth:`iterate` is a step of all agents and an update of the tables.

    Parameters
    ----------
    spec, device
        The environment, and where it is stepped.
    settings
        The run's.
    rates
        What stands in for ``settings.rate``, shape ``(learners,)``: learners may differ.
    rewards
        What stands in for the environment's reward table, shape ``(learners, entries)``: learners may want
        different things. The device hands out the numbers of entries instead, and each learner looks them up.
    """

    def __init__(
        self,
        spec: EnvSpec,
        device: Any,
        settings: Settings,
        rates: npt.NDArray[Any] | None = None,
        rewards: npt.NDArray[Any] | None = None,
    ) -> None:
        self.settings = settings
        n, learners = settings.n_agents, settings.learners
        if not 1 <= learners <= n or n % learners:
            raise ArgumentError(f"setting 'learners' is {learners}; it must divide n_agents, {n}")
        self.policy = Table(spec, learners)
        self.env = pearl_marl.parallel_env(spec.name, n, device=device, **spec.options)
        self.rewards = None if rewards is None else np.asarray(rewards, np.float32)
        entries = len(spec.rewards or ())
        for name, given, shape in (
            ("rates", rates, (learners,)),
            ("rewards", self.rewards, (learners, entries)),
        ):
            if given is not None and np.shape(given) != shape:
                raise ArgumentError(f"{name} have the shape {np.shape(given)}; of {spec.name} it is {shape}")
        if self.rewards is not None:
            self.env.set_rewards(np.arange(self.rewards.shape[1], dtype=np.float32))
        self.learner = np.arange(n) * learners // n  # of every agent
        self.rates = np.full(learners, settings.rate) if rates is None else np.asarray(rates)
        self.random = np.random.default_rng(settings.seed)
        self.statistics = EpisodeStatistics(n)
        self.rows = self.policy.rows(self.env.reset_batch(settings.seed))
        self.updates = np.zeros(self.policy.values.shape, np.int32)
        self.evaluated = max(2_000, learners)
        self.done = 0

    @property
    def agent_steps(self) -> int:
        """Steps of single agents so far."""
        return self.done * self.settings.n_agents

    def iterate(self) -> dict[str, float | None]:
        """Step all agents and update the tables; return figures for the metrics."""
        settings, rows = self.settings, self.rows
        n_actions = self.policy.values.shape[2]
        values = self.policy.values.reshape(-1, n_actions)  # of all learners, one below the other
        n = settings.n_agents
        explored = max(0.0, settings.epsilon * (1 - self.done / (EXPLORING * settings.iterations)))
        random = self.random.random(n, np.float32) < explored
        actions = np.where(random, self.random.integers(n_actions, size=n), values[rows].argmax(1))
        step = self.env.step_batch(actions)
        if self.rewards is not None:
            step = step._replace(rewards=self.rewards[self.learner, step.rewards.astype(np.intp)])
        # Where the step itself led; in its place there may be the next episode's start already.
        later = values[self.policy.rows(step.arrivals())].max(1)
        self._update(
            rows * n_actions + actions, step.rewards + settings.discount * later * ~step.terminations
        )
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

    def _update(self, entries: npt.NDArray[Any], targets: npt.NDArray[Any]) -> None:
        """Move the entries that agents visited towards the mean of their targets."""
        settings = self.settings
        values, updates = self.policy.values.reshape(-1), self.updates.reshape(-1)
        if settings.learners < settings.n_agents:
            visits = np.bincount(entries, minlength=values.size)
            sums = np.bincount(entries, targets, minlength=values.size)
            entries = np.flatnonzero(visits)
            targets = sums[entries] / visits[entries]
        rates = self.rates[entries // (values.size // settings.learners)]
        rates = rates / (1 + settings.fading * updates[entries])
        values[entries] += rates * (targets - values[entries])
        updates[entries] += 1

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
