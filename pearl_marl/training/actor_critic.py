"""What PPO learns: a policy, and a critic that says what is still to come by it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium.spaces import Box
from torch import Tensor, nn

from pearl_marl.policies.network import Network, masked, networks
from pearl_marl.policies.trained import NetworkPolicy
from pearl_marl.spec import EnvSpec
from pearl_marl.training.adam import Gradients

LOG_TURN = math.log(2 * math.pi)


class View(NamedTuple):
    """What networks are given, a row an agent, or a row a step and a column an agent."""

    obs: Tensor
    masks: Tensor | None = None  # where the environment has any
    position: Tensor | None = None  # of the agent in its world; where there are others
    state: Tensor | None = None  # of its world; for a central critic

    def each(self, function: Callable[[Tensor], Tensor]) -> View:
        """Return the same with a function of every tensor in its place."""
        others = (None if part is None else function(part) for part in self[1:])
        return View(function(self.obs), *others)

    def pick(self, rows: Tensor | slice | tuple[Tensor, ...]) -> View:
        """Return some rows."""
        return self.each(lambda part: part[rows])

    def flat(self) -> View:
        """Return steps and agents as one axis."""
        return self.each(lambda part: part.flatten(0, 1))

    @staticmethod
    def stacked(views: Sequence[View]) -> View:
        """Return views one step after the other."""
        obs, *others = zip(*views, strict=True)
        return View(torch.stack(obs), *(None if part[0] is None else torch.stack(part) for part in others))


class Weighed(NamedTuple):
    """How probable some actions are."""

    logs: Tensor  # logarithms of their probabilities
    entropy: Tensor  # the mean over observations
    gradients: Callable[[Tensor, float], Gradients]
    """Returns a loss's gradients from those by ``logs`` and by ``entropy``. It is written out, since autograd
    would take longer than the network does that is learned."""


class ActorCritic(nn.Module):
    """A policy and its critic.

    Parameters
    ----------
    spec
        The environment that they are for.
    width
        Of their networks' layers.
    sharing, temperature
        See :class:`~pearl_marl.policies.trained.NetworkPolicy`.
    central
        Whether the critic is given the state of the whole world, and has an output for each of its agents,
        instead of what the agent observes. The policy is not, so agents act on their own all the same.
    """

    def __init__(
        self, spec: EnvSpec, width: int, sharing: str = "all", temperature: float = 0.0, central: bool = False
    ) -> None:
        super().__init__()
        self.continuous = isinstance(spec.action_space, Box)
        self.central = central
        self.policy = NetworkPolicy(
            spec, "mean" if self.continuous else "logits", width, sharing, temperature
        )
        network: Any = self.policy.network
        # Of a picture, most of the work is to see what is on it: actor and critic do that together.
        self.shared = not central and isinstance(network, Network) and network.encoder.kind == "picture"
        self.critic: Any
        # Of worlds nothing is expected at first: their rewards are rare, and noise would outdo them.
        scale = 0.01 if spec.agents > 1 else 1.0
        if central:
            state = Box(-np.inf, np.inf, (len(spec.state),), np.float32)
            self.critic = Network(state, spec.agents, width, scale)
        else:
            self.critic = nn.Linear(width, 1)
            if not self.shared:
                self.critic = networks(spec, 1, width, scale, self.policy.about["sharing"])
        if self.continuous:
            self.log_deviation = nn.Parameter(torch.full((1,), -0.5))

    def see(self, view: View) -> None:
        """Take a batch into the statistics by which observations and states are standardised."""
        self.policy.see(view.obs, view.position)
        if self.central:
            self.critic.see(view.state)
        elif not self.shared:
            self.critic.see(view.obs, view.position)

    def outputs(self, view: View) -> Tensor:
        """Return the policy's outputs."""
        outputs: Tensor = self.policy(view.obs, view.masks, view.position)
        return outputs

    def values(self, view: View) -> Tensor:
        """Return what the critic expects, shape ``(batch,)``."""
        if self.central:
            values: Tensor = self.critic(view.state)
            return values[:, 0] if view.position is None else values.gather(1, view.position[:, None])[:, 0]
        if self.shared:
            network: Any = self.policy.network
            values = self.critic(network.features(view.obs, view.position))
        else:
            values = self.critic(view.obs, view.position)
        return values[:, 0]

    def forward(self, view: View) -> tuple[Tensor, Tensor]:
        """Return the policy's outputs, and what the critic expects."""
        if not self.shared:
            return self.outputs(view), self.values(view)
        network: Any = self.policy.network
        features = network.features(view.obs, view.position)
        return masked(network.output(features), view.masks), self.critic(features)[:, 0]

    def noise(self, shape: tuple[int, ...], random: torch.Generator) -> Tensor:
        """Return what makes random actions of outputs of that shape: see :meth:`draw`."""
        noise = torch.empty(shape, device=random.device)
        if self.continuous:
            return noise.normal_(generator=random)
        return -noise.exponential_(generator=random).log_()

    def draw(self, outputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions of the policy's probabilities, and as the environment takes them."""
        if self.continuous:
            actions = outputs + self.log_deviation.exp() * noise
            return actions, self.policy.within_bounds(actions)
        # Gumbel's trick: the largest of logits with such noise has the probabilities that these are of.
        actions = self.policy.most(outputs + noise)
        return actions, actions

    def weigh(self, outputs: Tensor, actions: Tensor) -> Weighed:
        """Return how probable actions are, and how far the policy is from being certain."""
        choices = self._weigh_fields if self.policy.heads else self._weigh_choices
        weigh = self._weigh_numbers if self.continuous else choices
        with torch.no_grad():
            return weigh(outputs, actions)

    def _weigh_numbers(self, outputs: Tensor, actions: Tensor) -> Weighed:
        spread = self.log_deviation.exp()
        apart = (actions - outputs) / spread
        logs = -(0.5 * apart.square() + self.log_deviation + 0.5 * LOG_TURN).sum(-1)
        entropy = (0.5 + 0.5 * LOG_TURN + self.log_deviation).expand_as(outputs).sum(-1).mean()

        def gradients(by_logs: Tensor, by_entropy: float) -> Gradients:
            by_apart = by_logs[..., None] * apart
            wider = (by_apart * apart).sum() - outputs.shape[-1] * (by_logs.sum() - by_entropy)
            return [(outputs, by_apart / spread), (self.log_deviation, wider[None])]

        return Weighed(logs, entropy, gradients)

    def _weigh_choices(self, outputs: Tensor, actions: Tensor) -> Weighed:
        everything = outputs.log_softmax(-1)
        shares, taken = everything.exp(), actions[..., None]
        entropies = -(shares * everything).sum(-1, keepdim=True)

        def gradients(by_logs: Tensor, by_entropy: float) -> Gradients:
            by_outputs = (shares * -by_logs[..., None]).scatter_add_(-1, taken, by_logs[..., None])
            if by_entropy:
                by_outputs -= shares * (everything + entropies) * (by_entropy / entropies.numel())
            return [(outputs, by_outputs)]

        return Weighed(everything.gather(-1, taken)[..., 0], entropies.mean(), gradients)

    def _weigh_fields(self, outputs: Tensor, actions: Tensor) -> Weighed:
        """Do so with actions of several fields, which are chosen independently of each other."""
        heads = torch.split(outputs, self.policy.heads, -1)
        fields = [self._weigh_choices(*each) for each in zip(heads, actions.unbind(-1), strict=True)]

        def gradients(by_logs: Tensor, by_entropy: float) -> Gradients:
            parts = [by for field in fields for _, by in field.gradients(by_logs, by_entropy)]
            return [(outputs, torch.cat(parts, -1))]

        logs, entropies = zip(*((field.logs, field.entropy) for field in fields), strict=True)
        return Weighed(torch.stack(logs).sum(0), torch.stack(entropies).sum(), gradients)
