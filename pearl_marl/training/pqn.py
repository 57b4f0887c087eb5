"""Parallel Q-learning: no replay memory, no target network (PQN; Gallici et al., 2024, arXiv:2407.04811).

The steps of tens of thousands of agents take the place of a memory, and layer norm keeps the values from
diverging. Targets are lambda-returns of the rollout. In worlds it is independent Q-learning.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from torch import Tensor

from pearl_marl.spec import EnvSpec
from pearl_marl.training.action_values import ActionValues, explored
from pearl_marl.training.dense_values import PQNGradients, fits
from pearl_marl.training.on_policy import OnPolicyTrainer
from pearl_marl.training.rollout import RolloutBuffer
from pearl_marl.training.settings import BlockSettings, count, number


@dataclass(frozen=True, kw_only=True)
class PQNSettings(BlockSettings):
    """What a run of PQN depends on beside :class:`BlockSettings`, each said beside its default."""

    epochs: int = count(2)  # how often an update goes through its experience
    minibatch: int = count(1024)  # steps of single agents to learn from at a time
    discount: float = number(0.99, most=1)  # gamma
    q_lambda: float = number(0.65, most=1)  # of the returns
    epsilon: float = number(1.0, most=1)  # share of random actions at first
    final_epsilon: float = number(0.05, most=1)  # and at last
    exploration_fraction: float = number(0.5, most=1, above=True)  # the part of the run in which it falls
    # Share of random actions where the trained policy is used.
    evaluation_epsilon: float = number(0.0, most=1)

    @property
    def gae_lambda(self) -> float:
        """Lambda-returns are values of best actions plus these values' advantages by the same lambda."""
        return self.q_lambda


class PQN(OnPolicyTrainer):
    """A run of PQN."""

    losses = ("loss",)
    max_grad_norm = 10.0

    def made(self, spec: EnvSpec, settings: PQNSettings) -> ActionValues:
        """Return the model that is learned."""
        return ActionValues(spec, settings)

    def loops(self, samples: RolloutBuffer) -> PQNGradients | None:
        """See :class:`OnPolicyTrainer`."""
        return PQNGradients(self.model, samples, self.team) if fits(self.model, self.team) else None

    def autograd(self, samples: RolloutBuffer, minibatch: Tensor) -> Tensor:
        """Leave the gradients of a minibatch's loss with the parameters; return the loss."""

        def loss(rows: Tensor) -> tuple[Tensor, Tensor]:
            outputs, _, batch = self.forward(samples, rows)
            chosen = outputs.gather(1, batch.actions[:, None])[:, 0]
            mean = 0.5 * (chosen - batch.returns).square().mean()
            return mean, mean[None]

        return self.halves.find(minibatch, loss, partial(self.terms, samples))

    def figures(self) -> dict[str, float | None]:
        """Return figures for the metrics: those of rollouts, and the share of actions that is random."""
        share = explored(self.settings, self.done / self.settings.iterations)
        return {**super().figures(), "explored": share}
