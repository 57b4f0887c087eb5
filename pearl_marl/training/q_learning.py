"""Tabular Q-learning (Watkins and Dayan, 1992, doi:10.1007/BF00992698), of one learner or of many thousands.

A learner is a table and the agents that write into it, all at once: a step's updates are averaged for each
entry, so that one step of all agents is one update of the table. With as many learners as agents, every
agent learns for itself, from nothing but its own experience.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pearl_marl.errors import ArgumentError
from pearl_marl.policies.network import masked
from pearl_marl.policies.trained import TabularPolicy
from pearl_marl.spec import MAX_SLOTS, EnvSpec
from pearl_marl.training.agents import Agents
from pearl_marl.training.restoring import copied
from pearl_marl.training.settings import TrainerSettings, check_memory, count, number
from pearl_marl.training.trainer import Trainer


@dataclass(frozen=True, kw_only=True)
class QLearningSettings(TrainerSettings):
    """What a run of Q-learning depends on, each said beside its default."""

    n_agents: int = count(43008, most=MAX_SLOTS)  # that gather experience, as many for each learner
    learners: int = count(1, most=MAX_SLOTS)  # tables; from 1, which all agents share, to n_agents
    iterations: int = count(300)  # steps of every agent
    epsilon: float = number(0.2, most=1)  # share of random actions at first; falls evenly to 0
    # How far an entry's first update moves it towards its target.
    learning_rate: float = number(0.5, most=1, above=True, formerly="rate")
    # After 1 / learning_rate_decay updates an entry moves half as far; with 0, always as far.
    learning_rate_decay: float = number(0.0, formerly="fading")
    discount: float = number(1.0, most=1)  # gamma

    def __post_init__(self) -> None:
        super().__post_init__()
        n, learners = self.n_agents, self.learners
        if n % learners:
            raise ArgumentError(f"setting 'learners' is {learners}; it must divide n_agents, {n}")


EXPLORATION_FRACTION = 0.8
"""The part of a run in which random actions become fewer."""


class QLearning(Trainer):
    """A run of Q-learning: :meth:`iterate` is a step of all agents and an update of the tables.

    Parameters
    ----------
    spec, device
        The environment, and where it is stepped.
    settings
        The run's.
    rates
        Learning rates instead of ``settings.learning_rate``, shape ``(learners,)``: learners may differ.
    rewards
        Reward tables instead of the environment's, shape ``(learners, entries)``: learners may want different
        things. The device then returns the numbers of entries, and each learner looks them up.
    """

    def __init__(
        self,
        spec: EnvSpec,
        device: Any,
        settings: QLearningSettings,
        rates: npt.NDArray[Any] | None = None,
        rewards: npt.NDArray[Any] | None = None,
    ) -> None:
        n, learners = settings.n_agents, settings.learners
        if spec.turns:
            raise ArgumentError(
                f"q-learning learns from every step, and in {spec.name} agents take turns: use self-play"
            )
        # Of every agent an observation and some ten numbers; of every entry of a table, one.
        others = n * 10 * 8 + learners * TabularPolicy(spec).values.numel() * 4
        self.need = check_memory(spec, settings, device, ("n_agents", "learners"), n, others)
        self.policy = TabularPolicy(spec, learners)
        entries = len(spec.rewards or ())
        for name, array, shape in (("rates", rates, (learners,)), ("rewards", rewards, (learners, entries))):
            if array is not None and np.shape(array) != shape:
                raise ArgumentError(f"{name} have the shape {np.shape(array)}; of {spec.name} it is {shape}")
        agents = Agents(spec, device, n, settings.seed)
        where = agents.obs.device
        super().__init__(settings, agents, where)
        self.policy.to(where)
        if rates is None:
            rates = np.full(learners, settings.learning_rate)
        self.rates = torch.as_tensor(np.asarray(rates, np.float32), device=where)
        self.rewards: Tensor | None = None
        if rewards is not None:
            self.rewards = torch.as_tensor(np.asarray(rewards, np.float32), device=where)
            agents.device.set_rewards(np.arange(entries, dtype=np.float32))
        self.learner = torch.arange(n, device=where) * learners // n  # of every agent
        self.rows = self.policy.rows(agents.obs)
        # An entry of each table's: updates so far; of the step, visits and the sum of targets.
        self.updates = torch.zeros_like(self.policy.values).flatten()
        self.visits, self.sums = (torch.zeros_like(self.updates, dtype=torch.float64) for _ in range(2))
        self.evaluated = max(2_000, learners)

    @property
    def explored(self) -> float:
        """The share of actions that is random now."""
        settings: QLearningSettings = self.settings
        return max(0.0, settings.epsilon * (1 - self.done / (EXPLORATION_FRACTION * settings.iterations)))

    def update(self) -> None:
        """Step all agents and update the tables."""
        rows, n_actions = self.rows, self.policy.values.shape[2]
        values = self.policy.values.view(-1, n_actions)  # of all learners, one below the other
        masks, alive = self.agents.inputs.masks, self.agents.alive
        best = masked(values[rows], masks).argmax(1)
        actions = self.explore(best, n_actions, self.explored, masks)
        step = self.agents.step(actions)
        rewards = step.rewards
        if self.rewards is not None:
            rewards = self.rewards[self.learner, rewards.long()]
        # Of where the step itself led: the observations may be the next episode's first ones already.
        later = values[self.policy.rows(step.arrivals())]
        if self.agents.inputs.masks is not None:
            # Where a time limit cut an episode short, the device does not tell the masks: all are allowed.
            later = masked(later, self.agents.inputs.masks.masked_fill(step.ended[:, None], 1))
        targets = rewards + self.settings.discount * later.amax(1) * ~step.terminations
        self._update(rows * n_actions + actions, targets, alive)
        self.episodes.add(rewards[None], step.ended[None])
        self.rows = self.policy.rows(step.obs)
        self.done += 1

    def figures(self) -> dict[str, float | None]:
        """Return figures for the metrics: of episodes since they were last asked for."""
        return {**super().figures(), "explored": self.explored}

    def _update(self, entries: Tensor, targets: Tensor, alive: Tensor) -> None:
        """Move the entries that agents visited towards the mean of their targets."""
        learner = self.learner
        if self.agents.spec.agents > 1:  # else no agent has ended before its world
            entries, targets, learner = entries[alive], targets[alive], learner[alive]
        values, updates = self.policy.values.view(-1), self.updates
        self.visits.index_add_(0, entries, torch.ones_like(targets, dtype=torch.float64))
        self.sums.index_add_(0, entries, targets.double())
        # Agents that visited the same entry compute the same for it, so any of their results may be kept.
        mean = (self.sums[entries] / self.visits[entries]).float()
        rates = self.rates[learner] / (1 + self.settings.learning_rate_decay * updates[entries])
        old = values[entries]
        values[entries] = old + rates * (mean - old)
        updates[entries] = updates[entries] + 1
        self.visits[entries] = 0
        self.sums[entries] = 0

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on."""
        return {**super().state(), "values": self.policy.values, "updates": self.updates}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        super().load(state)
        copied("table", self.policy.values, state["values"])
        copied("number of updates", self.updates, state["updates"], least=0)
        self.rows = self.policy.rows(self.agents.obs)


def __getattr__(name: str) -> Any:
    if name != "Settings":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warnings.warn(f"{__name__}.Settings is now QLearningSettings", DeprecationWarning, stacklevel=2)
    return lambda **given: QLearningSettings(**QLearningSettings.renamed(given))
