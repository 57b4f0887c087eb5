"""A network of action values, for learners from rollouts: it is policy and critic at once."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from pearl_marl.policies.trained import NetworkPolicy
from pearl_marl.spec import EnvSpec
from pearl_marl.training.actor_critic import Inputs

OUTWEIGHING = 1e30
"""A random number times this decides an action, whatever the values are; masked actions are lower still."""


def explored(settings: Any, progress: float) -> float:
    """Return the share of actions that is random after this fraction of a run."""
    passed = min(1.0, progress / settings.exploration_fraction)
    return float(settings.epsilon + passed * (settings.final_epsilon - settings.epsilon))


class ActionValues(nn.Module):
    """A policy by action values, which explores as its settings say.

    It has the methods that a rollout takes of :class:`~pearl_marl.training.actor_critic.ActorCritic`. What is
    expected of an observation is the value of the best action. Those of a world's agents may be mixed: see
    :mod:`pearl_marl.training.mixers`. A mixer that has a method ``see`` is given states of worlds.
    """

    of_best = shared = True  # see ActorCritic

    def __init__(self, spec: EnvSpec, settings: Any, mixer: nn.Module | None = None) -> None:
        super().__init__()
        self.settings = settings
        self.policy = NetworkPolicy(
            spec,
            "values",
            settings.width,
            settings.sharing,
            epsilon=settings.evaluation_epsilon,
            layer_norm=True,
            memory=settings.memory,
        )
        self.memory_size = settings.width
        self.mixer: Any = mixer
        self.central = hasattr(mixer, "see")

    def see(self, inputs: Inputs) -> None:
        """Take a batch into the statistics by which observations are standardised."""
        self.policy.network.see(inputs.obs, inputs.position)
        if self.central:
            self.mixer.see(inputs.state)

    def outputs(self, inputs: Inputs) -> Tensor:
        """Return the action values."""
        outputs: Tensor = self.policy(*inputs[:3])
        return outputs

    def values(self, inputs: Inputs) -> Tensor:
        """Return the values of the best actions, shape ``(batch,)``."""
        return self.outputs(inputs).amax(-1)

    values_of_all = values  # see ActorCritic; no critic is given states here

    def forward(self, inputs: Inputs) -> tuple[Tensor, Tensor]:
        """Return the action values, and those of the best actions."""
        outputs = self.outputs(inputs)
        return outputs, outputs.amax(-1)

    def unrolled(self, inputs: Inputs) -> tuple[Tensor, Tensor, Tensor]:
        """Return the same for steps of agents that remember, and the memories after each step."""
        flat, recall = inputs.recall()
        outputs, memories = self.policy.unrolled(flat.obs, flat.masks, flat.position, recall)
        return outputs, outputs.amax(-1), memories

    def noise(self, shape: tuple[int, ...], random: torch.Generator, progress: float) -> Tensor:
        """Return the noise that makes actions random, for outputs of that shape: see :meth:`draw`."""
        draws = torch.rand((*shape[:-1], 1 + shape[-1]), generator=random, device=random.device)
        explores = draws[..., :1] < explored(self.settings, progress)
        return draws[..., 1:] * (explores * OUTWEIGHING)

    def draw(self, outputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return the best actions, or random ones where there is noise, twice."""
        actions = (outputs + noise).argmax(-1)
        return actions, actions

    def log_probs(self, outputs: Tensor, _: Tensor) -> Tensor:
        """Return zeros: learning asks for no probabilities."""
        return outputs.new_zeros(outputs.shape[:-1])
