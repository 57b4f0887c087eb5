"""Rollouts of policies with memory, and the chunks of them that are learned from.

The worker keeps what each agent remembers from one rollout to the next. Learning begins a chunk with what was
remembered there in the rollout, and goes back through all of its steps.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from pearl_marl.training.actor_critic import Inputs
from pearl_marl.training.rollout import RolloutBuffer, RolloutWorker


class RecurrentWorker(RolloutWorker):
    """Gathers with a model that remembers.

    Attributes
    ----------
    memory
        What agents remember before the next step, a row for each.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.memory = torch.zeros(len(self.agents.obs), self.model.memory_size, device=self.where)
        self._before: list[Tensor] = []
        self._after: list[Tensor] = []
        self._begins: list[Tensor] = []
        self._expects: list[Tensor] = []

    def gather(self, rollout: int) -> RolloutBuffer:
        """Step all agents ``rollout_length`` times; return the rollout of that number, with memories."""
        for noted in (self._before, self._after, self._begins, self._expects):
            noted.clear()
        gathered = super().gather(rollout)
        inputs = gathered.inputs._replace(memory=torch.stack(self._before), begins=torch.stack(self._begins))
        return gathered._replace(inputs=inputs)

    def decide(self, inputs: Inputs, _: int) -> Tensor:
        """Return the policy's outputs for the rollout's next step, which it remembers."""
        begins = self.agents.begins
        self.memory = self.memory.masked_fill(begins[:, None], 0)
        outputs, values, after = self._step(inputs, self.memory)
        for noted, tensor in (
            (self._before, self.memory),
            (self._begins, begins),
            (self._expects, values),
            (self._after, after),
        ):
            noted.append(tensor)
        self.memory = after
        return outputs

    def expected(self, inputs: Inputs, decides: Tensor) -> Tensor:
        """Return what the critic expected before each step, and now."""
        self.memory = self.memory.masked_fill(self.agents.begins[:, None], 0)
        _, values, _ = self._step(inputs.pick(-1), self.memory)
        return torch.stack([*self._expects, values]) * decides

    def expected_at_ends(self, inputs: Inputs, cut: Tensor) -> Tensor:
        """Return what the critic expects of where time limits cut episodes off."""
        values = torch.zeros(cut.shape, device=self.where)
        memory = torch.stack(self._after)
        for block in self.blocks:
            steps, columns = cut[:, block].nonzero(as_tuple=True)
            rows = steps, columns + block.start
            if len(steps):
                _, values[rows], _ = self._unrolled(inputs.pick(rows), memory[rows])
        return values

    def _step(self, inputs: Inputs, memory: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return outputs, values and the memories after a step of all agents, block by block."""
        parts = [self._unrolled(inputs.pick(block), memory[block]) for block in self.blocks]
        outputs, values, after = (torch.cat(part) for part in zip(*parts, strict=True))
        return outputs, values, after

    def _unrolled(self, inputs: Inputs, memory: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        one_step = Inputs(*(None if tensor is None else tensor[None] for tensor in inputs))  # type: ignore[arg-type]
        outputs, values, (after,) = self.model.unrolled(one_step._replace(memory=memory[None]))
        return outputs, values, after


def chunked(rollout: RolloutBuffer, length: int) -> RolloutBuffer:
    """Return a rollout as chunks: a row for each of ``length`` steps, and a column for each chunk."""

    def columns(tensor: Tensor) -> Tensor:
        steps, agents, *rest = tensor.shape
        chunks = tensor.reshape(steps // length, length, agents, *rest)
        return chunks.transpose(0, 1).flatten(1, 2)

    return rollout.map(columns)
