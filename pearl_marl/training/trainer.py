"""Any algorithm's trainer: its iterations, its episodes' returns and its checkpoints."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

import torch
from torch import Tensor

from pearl_marl.batch.saved_state import SavedState
from pearl_marl.errors import ArgumentError
from pearl_marl.policies.network import masked
from pearl_marl.policies.policy_file import check_weights
from pearl_marl.policies.second_thread import torch_threads
from pearl_marl.policies.trained import SECOND_THREAD
from pearl_marl.spec import EnvSpec
from pearl_marl.training.restoring import copied, saved_bytes, whole
from pearl_marl.training.settings import MemoryNeed


def threads_for(spec: EnvSpec, settings: Any) -> AbstractContextManager[None]:
    """Learn in the block with one thread where networks and minibatches are small, else with all there are.

    It depends on nothing but the settings: another number of threads adds numbers up in another order.
    """
    picture = len(spec.observation_space.shape or ()) == 3
    elements = getattr(settings, "minibatch", 0) * getattr(settings, "width", 0)
    if getattr(settings, "memory", None) == "gru":  # other threads have halves of its minibatches
        elements //= settings.chunk_length
    return torch_threads(torch.get_num_threads() if picture or elements >= SECOND_THREAD else 1)


class DivergedError(ArgumentError):
    """A training whose losses are no numbers, which cannot go on."""


class EpisodeReturns:
    """Mean return and length of the episodes that ``n`` agents finish, added up where the rewards are."""

    def __init__(self, n: int, where: torch.device) -> None:
        # Of the episodes under way: returns, lengths. Of those finished: number, returns, lengths.
        self._under_way = torch.zeros(2, n, dtype=torch.float64, device=where)
        self._finished = torch.zeros(3, dtype=torch.float64, device=where)

    def add(self, rewards: Tensor, ended: Tensor) -> None:
        """Count some steps of every agent, shape ``(steps, n)``."""
        steps = len(rewards)
        number = torch.arange(1, steps + 1, device=rewards.device)[:, None]
        # An agent's finished episodes together are all that it had up to the last step that ended one.
        last = (ended * number).amax(0)
        earned = rewards.masked_fill(number > last, 0).sum(0, dtype=torch.float64)
        until_last = self._under_way + torch.stack((earned, last.double()))
        until_last = until_last.masked_fill(last == 0, 0)
        self._under_way[0] += rewards.sum(0, dtype=torch.float64)
        self._under_way[1] += steps
        self._under_way -= until_last
        self._finished[0] += ended.sum()
        self._finished[1:] += until_last.sum(1)

    def take(self) -> dict[str, float | None]:
        """Return means, and the number of episodes, by the names of metrics; and begin anew."""
        episodes, returns, lengths = self._finished.tolist()
        self._finished.zero_()
        return {
            "train_return": returns / episodes if episodes else None,
            "train_length": lengths / episodes if episodes else None,
            "episodes": int(episodes),
        }

    def state(self) -> tuple[Tensor, Tensor]:
        """Return all that the continuation depends on."""
        return self._under_way, self._finished

    def load(self, state: tuple[Tensor, Tensor]) -> None:
        """Go on from what :meth:`state` returned."""
        for mine, kept in zip(self.state(), state, strict=True):
            copied("sums of episodes", mine, kept)


class Trainer:
    """A run of any algorithm: ``iterate`` goes on by one iteration, and ``policy`` is what it learns.

    Parameters
    ----------
    settings
        The run's.
    agents
        :class:`~pearl_marl.training.agents.Agents`, or something else with ``state``, ``load``, ``config``.
    where
        The device of torch that has their observations, and on which it learns.
    """

    policy: Any
    need: MemoryNeed

    def __init__(self, settings: Any, agents: Any, where: torch.device) -> None:
        self.settings, self.agents, self.where = settings, agents, where
        self.random = torch.Generator(where).manual_seed(settings.seed)
        self.episodes = EpisodeReturns(settings.n_agents, where)
        self.components: dict[str, Any] = {}  # modules and optimisers, by their names in a checkpoint
        self.done = 0  # iterations so far
        self.steps_per_iteration = 1  # of every agent
        self.threads = 1  # of PyTorch, before an iteration chooses its own number
        self.evaluated = 256  # agents whose first episodes are an evaluation, unless said otherwise

    @property
    def agent_steps(self) -> int:
        """Steps of single agents so far."""
        return int(self.done * self.steps_per_iteration * self.settings.n_agents)

    def iterate(self) -> None:
        """Go on by one iteration, with as many threads of PyTorch as help."""
        self.threads = torch.get_num_threads()
        with threads_for(self.policy.spec, self.settings):
            self.update()

    def update(self) -> None:
        """Do one iteration of the algorithm."""
        raise NotImplementedError

    def check(self, losses: Tensor) -> None:
        """Refuse to go on from losses that are no numbers: the policy's outputs are none either, then."""
        if not torch.isfinite(losses).all():
            raise DivergedError(
                f"the training has diverged, as the loss of iteration {self.done + 1:,} is no number: make "
                "the setting 'learning_rate' smaller, or bring rewards nearer to 1 with 'reward_scale'"
            )

    def figures(self) -> dict[str, float | None]:
        """Return figures for the metrics, of episodes since they were last asked for."""
        return self.episodes.take()

    def explore(self, best: Tensor, n_actions: int, epsilon: float, masks: Tensor | None = None) -> Tensor:
        """Return the best actions, of which a share is replaced by random ones that the masks allow."""
        random = torch.rand(len(best), generator=self.random, device=self.where) < epsilon
        if masks is None:
            anything = torch.randint(n_actions, best.shape, generator=self.random, device=self.where)
        else:
            draws = torch.rand(masks.shape, generator=self.random, device=self.where)
            anything = masked(draws, masks).argmax(1)
        return torch.where(random, anything, best)

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on: tensors and plain data."""
        agents = torch.frombuffer(bytearray(self.agents.state().to_bytes()), dtype=torch.uint8)
        return {
            "done": self.done,
            "random": self.random.get_state(),
            "agents": agents,
            "episodes": self.episodes.state(),
            **{name: component.state_dict() for name, component in self.components.items()},
        }

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        self.done = whole("number of iterations", state["done"])
        for name, component in self.components.items():
            if isinstance(component, torch.nn.Module):
                check_weights(component, state[name], f"{self.policy.spec.name}'s {name}")
            component.load_state_dict(state[name])
        self.random.set_state(state["random"])
        agents = saved_bytes("state of agents", state["agents"])
        self.agents.load(SavedState.from_bytes(agents, self.agents.config))
        self.episodes.load(state["episodes"])
