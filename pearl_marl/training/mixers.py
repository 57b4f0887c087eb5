"""Mixers: from the action values of a world's agents to the value of their team.

Where agents act by their own values, and the team's value falls with none of them, the agents' best actions
are the team's.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import elu

from pearl_marl.policies.network import Encoder
from pearl_marl.spec import EnvSpec
from pearl_marl.training.actor_critic import world_space


class SumMixer(nn.Module):
    """The sum: value decomposition networks (VDN; Sunehag et al., 2018, arXiv:1706.05296)."""

    def forward(self, values: Tensor, _: Tensor | None = None) -> Tensor:
        """Return the values of teams, shape ``(worlds,)``, of their agents', ``(worlds, agents)``."""
        return values.sum(-1)


class MonotonicMixer(nn.Module):
    """A network whose weights depend on the state, and are not negative (QMIX; Rashid et al., 2018).

    As in section 4 and appendix C of arXiv:1803.11485: a hidden layer of ``width`` units with ELU, whose
    weights, like those of the output, are absolute values of linear functions of the state. Its biases are
    linear functions, and the output's bias is a network with one hidden layer and ReLU. States are
    standardised by the statistics of all in training.
    """

    def __init__(self, spec: EnvSpec, width: int) -> None:
        super().__init__()
        # All linear functions of the state: weights and biases of the hidden layer, weights of the output,
        # and the hidden layer of its bias.
        self.sizes = [spec.agents * width, width, width, width]
        self.linear = Encoder(world_space(spec), sum(self.sizes))
        self.bias = nn.Linear(width, 1)
        # It begins near the sum of the values; at weights of the usual size, it would be many times that.
        with torch.no_grad():
            self.linear.linear.weight *= 0.01
            weights, _, outputs, _ = torch.split(self.linear.linear.bias, self.sizes)
            weights.fill_(1)
            outputs.fill_(1 / width)
            self.bias.weight *= 0.01
            self.bias.bias.zero_()

    def see(self, state: Tensor) -> None:
        """Take a batch of states into the statistics by which they are standardised."""
        self.linear.see(state)

    def forward(self, values: Tensor, state: Tensor) -> Tensor:
        """Return the values of teams, shape ``(worlds,)``, of their agents', ``(worlds, agents)``."""
        weights, biases, outputs, bias = torch.split(self.linear(state), self.sizes, -1)
        weights = weights.abs().view(*values.shape, -1)
        hidden = elu((values[..., None] * weights).sum(1) + biases)
        total: Tensor = (hidden * outputs.abs()).sum(-1) + self.bias(bias.relu())[:, 0]
        return total
