"""The memory of a recurrent policy: a gated recurrent unit (GRU; Cho et al., 2014, arXiv:1406.1078).

A memory is empty, all zeros, where an episode begins. It moves on where its agent acts: not while the agent
waits for its turn, or for its world to end.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from pearl_marl.policies.dense_memory import GRUSteps

MEMORY = ("none", "gru")
"""Possible memories of a policy."""


class Recall(NamedTuple):
    """What some steps of some agents remember."""

    memory: Tensor  # before the first step, (agents, size)
    begins: Tensor | None = None  # (steps, agents): where an episode begins
    acting: Tensor | None = None  # (steps, agents): where it moves on; by default everywhere


def acting(masks: Tensor | None) -> Tensor | None:
    """Return which agents have something to decide, by the masks of their actions."""
    return None if masks is None else (masks != 0).any(-1)


class Memory(nn.Module):
    """Memories of ``size`` numbers, which move on by as many features of each step.

    On a CPU, compiled loops move them; on a GPU, PyTorch does.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.cell = nn.GRUCell(size, size)

    def forward(self, features: Tensor, recall: Recall) -> Tensor:
        """Return the memories after each step, shape ``(steps, agents, size)``.

        Features have the shape ``(steps * agents, size)``.
        """
        memory, begins, acts = recall
        if features.device.type == "cpu":
            cell, agents = self.cell, len(memory)
            shape = len(features) // max(agents, 1), agents, 3 * cell.hidden_size
            given = linear(features, cell.weight_ih, cell.bias_ih).reshape(shape)
            made: Tensor = GRUSteps.apply(given, cell.weight_hh, cell.bias_hh, *recall)  # type: ignore[no-untyped-call]
            return made
        memories = []
        for t, now in enumerate(features.reshape(-1, *memory.shape)):
            if begins is not None:
                memory = memory.masked_fill(begins[t, :, None], 0)
            moved = self.cell(now, memory)
            memory = moved if acts is None else torch.where(acts[t, :, None], moved, memory)
            memories.append(memory)
        return torch.stack(memories)
