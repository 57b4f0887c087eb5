"""The model that PPO learns: a policy, and a critic that expects what is still to come by it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium.spaces import Box
from torch import Tensor, nn

from pearl_marl.policies.memory import Recall, acting
from pearl_marl.policies.network import Network, masked, most, networks
from pearl_marl.policies.trained import NetworkPolicy
from pearl_marl.spec import EnvSpec

LOG_TURN = math.log(2 * math.pi)


class Inputs(NamedTuple):
    """What networks are given: a row for each agent, or a row for each step and a column for each agent."""

    obs: Tensor
    masks: Tensor | None = None  # where the environment has any
    position: Tensor | None = None  # of the agent in its world; where there are others
    state: Tensor | None = None  # of its world; for a central critic
    # Of rollouts with memory: what agents remember before the first step of each chunk, and where episodes
    # begin.
    memory: Tensor | None = None
    begins: Tensor | None = None

    def map(self, function: Callable[[Tensor], Any]) -> Inputs:
        """Return what a function makes of every tensor that there is."""
        return Inputs(*(None if tensor is None else function(tensor) for tensor in self))  # type: ignore[arg-type]

    def pick(self, rows: Any) -> Inputs:
        """Return some rows."""
        return self.map(lambda tensor: tensor[rows])

    def flat(self) -> Inputs:
        """Return steps and agents as one axis."""
        return self.map(lambda tensor: tensor.flatten(0, 1))

    def recall(self) -> tuple[Inputs, Recall]:
        """Return steps and agents as one axis, and what agents remember in these steps."""
        assert self.memory is not None
        return self.flat(), Recall(self.memory[0], self.begins, acting(self.masks))


def world_space(spec: EnvSpec) -> Box:
    """Return the space of the state of a world, as networks are given it."""
    return Box(-np.inf, np.inf, (len(spec.state),), np.float32)


class ActorCritic(nn.Module):
    """A policy and its critic.

    Parameters
    ----------
    spec
        The environment that they are for.
    settings
        The run's. With a memory, a critic that is not central remembers too.
    central
        Whether the critic is given the state of the whole world, and has an output for each of its agents,
        instead of what the agent observes. The policy is not, so agents act on their own all the same.
    """

    of_best = False
    """Whether what is expected is of the best action that masks allow, and not of an observation."""

    mixer = None
    """Makes the value of a team of its agents' values: see :mod:`pearl_marl.training.mixers`."""

    def __init__(self, spec: EnvSpec, settings: Any, central: bool = False) -> None:
        super().__init__()
        width = settings.width
        self.continuous = isinstance(spec.action_space, Box)
        self.central = central
        self.agents_per_state = spec.agents if central else 1  # which the critic is given
        self.policy = NetworkPolicy(
            spec,
            "mean" if self.continuous else "logits",
            width,
            settings.sharing,
            settings.temperature,
            memory=settings.memory,
        )
        network = self.actor
        # For pictures, most of the work is in the first layers: actor and critic share them.
        self.shared = not central and isinstance(network, Network) and network.encoder.kind == "picture"
        self.critic: Any
        # In worlds the critic expects nothing at first: rewards are rare, and noise would outdo them.
        scale = 0.01 if spec.agents > 1 else 1.0
        if central:
            self.critic = Network(world_space(spec), spec.agents, width, scale)
        else:
            self.critic = nn.Linear(width, 1)
            if not self.shared:
                sharing = self.policy.about["sharing"]
                self.critic = networks(spec, 1, width, scale, sharing, memory=self.policy.remembers)
        # Numbers that an agent's memory has: the actor's, then the critic's, if that has its own.
        self.memory_size = width * (1 if self.shared or central else 2)
        if self.continuous:
            self.log_deviation = nn.Parameter(torch.full((1,), -0.5))

    @property
    def actor(self) -> Any:
        """The policy's network."""
        return self.policy.network

    def see(self, inputs: Inputs) -> None:
        """Take a batch into the statistics by which observations and states are standardised."""
        self.actor.see(inputs.obs, inputs.position)
        if self.central:
            self.critic.see(inputs.state)
        elif not self.shared:  # both are given the same
            self.critic.take_statistics(self.actor)

    def outputs(self, inputs: Inputs) -> Tensor:
        """Return the policy's outputs."""
        return masked(self.actor(inputs.obs, inputs.position), inputs.masks)

    def values(self, inputs: Inputs) -> Tensor:
        """Return what the critic expects, shape ``(batch,)``."""
        if self.central:
            values: Tensor = self.critic(inputs.state)
            if inputs.position is None:
                return values[:, 0]
            return values.gather(1, inputs.position[:, None])[:, 0]
        if self.shared:
            values = self.critic(self.actor.features(inputs.obs, inputs.position))
        else:
            values = self.critic(inputs.obs, inputs.position)
        return values[:, 0]

    def values_of_all(self, inputs: Inputs) -> Tensor:
        """Return the same for worlds with all their agents, one world after the other."""
        if self.central:
            assert inputs.state is not None
            every: Tensor = self.critic(inputs.state[:: self.agents_per_state])
            return every.flatten()
        return self.values(inputs)

    def forward(self, inputs: Inputs) -> tuple[Tensor, Tensor]:
        """Return the policy's outputs, and what the critic expects."""
        if not self.shared:
            return self.outputs(inputs), self.values(inputs)
        features = self.actor.features(inputs.obs, inputs.position)
        return masked(self.actor.output(features), inputs.masks), self.critic(features)[:, 0]

    def unrolled(self, inputs: Inputs) -> tuple[Tensor, Tensor, Tensor]:
        """Return the same for steps of agents that remember, and the memories after each step.

        Inputs have a row for each step and a column for each agent; of memories, the first row counts.
        Outputs and values have both as one axis.
        """
        flat, recall = inputs.recall()
        network = self.actor
        own = recall._replace(memory=recall.memory[:, : network.hidden.in_features])
        features, memories = network.unrolled(flat.obs, flat.position, own)
        outputs = masked(network.output(features), flat.masks)
        if self.shared:
            return outputs, self.critic(features)[:, 0], memories
        if self.central:
            return outputs, self.values(flat), memories
        own = recall._replace(memory=recall.memory[:, network.hidden.in_features :])
        features, others = self.critic.unrolled(flat.obs, flat.position, own)
        return outputs, self.critic.output(features)[:, 0], torch.cat((memories, others), -1)

    def noise(self, shape: tuple[int, ...], random: torch.Generator, _: float = 0.0) -> Tensor:
        """Return the noise that makes actions random, for outputs of that shape: see :meth:`draw`."""
        noise = torch.empty(shape, device=random.device)
        if self.continuous:
            return noise.normal_(generator=random)
        return noise.exponential_(generator=random).log_().neg_()

    def draw(self, outputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions of the policy's probabilities, and as the environment takes them."""
        if self.continuous:
            actions = outputs + self.log_deviation.exp() * noise
            return actions, self.policy.within_bounds(actions)
        # Gumbel's trick: the largest of logits with such noise has the probabilities of the logits.
        actions = most(outputs + noise, self.policy.heads)
        return actions, actions

    def log_probs(self, outputs: Tensor, actions: Tensor) -> Tensor:
        """Return the logarithms of actions' probabilities."""
        if self.continuous:
            return self._evaluate_numbers(outputs, actions)[0]
        return torch.stack([_chosen(*field) for field in self._fields(outputs, actions)]).sum(0)

    def evaluate(self, outputs: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return the logarithms of actions' probabilities, and the mean entropy of the policy."""
        if self.continuous:
            return self._evaluate_numbers(outputs, actions)
        fields = list(self._fields(outputs, actions))
        entropies = [-(log_probs.exp() * log_probs).sum(-1).mean() for log_probs, _ in fields]
        return torch.stack([_chosen(*field) for field in fields]).sum(0), torch.stack(entropies).sum()

    def _fields(self, outputs: Tensor, actions: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield the logarithms of all probabilities of each field of actions, and what was chosen.

        Fields are chosen independently of each other.
        """
        heads = self.policy.heads
        columns = actions.unbind(-1) if heads else (actions,)
        for logits, column in zip(torch.split(outputs, heads or outputs.shape[-1], -1), columns, strict=True):
            yield logits.log_softmax(-1), column

    def _evaluate_numbers(self, outputs: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        deviations = (actions - outputs) / self.log_deviation.exp()
        log_probs = -(0.5 * deviations.square() + self.log_deviation + 0.5 * LOG_TURN).sum(-1)
        entropy = (0.5 + 0.5 * LOG_TURN + self.log_deviation).expand_as(outputs).sum(-1).mean()
        return log_probs, entropy


def _chosen(log_probs: Tensor, column: Tensor) -> Tensor:
    return log_probs.gather(-1, column[..., None])[..., 0]
