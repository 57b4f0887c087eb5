"""Rollouts of policies with memory, and the chunks of them that are learned from.

The worker keeps what each agent remembers from one rollout to the next. Learning begins a chunk with what was
remembered there in the rollout, and goes back through all of its steps.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from pearl_marl.training.actor_critic import Inputs
from pearl_marl.training.rollout import RolloutBuffer, RolloutSteps, RolloutWorker


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
        self._starts: list[Tensor] = []
        self._begins: list[Tensor] = []
        self._ends: list[Tensor] = []

    def gather(self, rollout: int) -> RolloutBuffer:
        """Step all agents ``rollout_length`` times; return the rollout of that number, with memories."""
        try:
            gathered = super().gather(rollout)
            memories = {"memory": torch.stack(self._starts), "begins": torch.stack(self._begins[:-1])}
            return gathered._replace(inputs=gathered.inputs._replace(**memories))
        finally:
            for noted in (self._starts, self._begins, self._ends, self.expects):
                noted.clear()

    def decide(self, inputs: Inputs, t: int) -> Tensor:
        """Return the policy's outputs for the rollout's next step, which it remembers."""
        self._empty()
        if t % self.settings.chunk_length == 0:
            self._starts.append(self.memory)
        outputs, values, self.memory = self.stepped(inputs, self.memory)
        self.expects.append(values)
        return outputs

    def expected(self, steps: RolloutSteps) -> Tensor:
        """Return what the critic expected before each step, and now."""
        self._empty()
        _, values, _ = self.stepped(steps.inputs.pick(-1), self.memory)
        return torch.stack([*self.expects, values]) * steps.acting

    def values_where(self, inputs: Inputs, cut: Tensor) -> Tensor:
        """Return what the critic expects of where time limits cut episodes off."""
        values = torch.zeros(cut.shape, device=self.where)
        ends, memories = torch.stack(self._begins[1:]), torch.cat(self._ends[1:])
        numbers = ends.flatten().cumsum(0).view_as(ends) - 1
        for block in self.blocks:
            steps, columns = cut[:, block].nonzero(as_tuple=True)
            rows = steps, columns + block.start
            if len(steps):
                _, values[rows], _ = self._unrolled(inputs.pick(rows), memories[numbers[rows]])
        return values

    def _empty(self) -> None:
        """Empty the memories of agents whose episodes begin; note which, and what these remembered."""
        begins = self.agents.begins
        self._begins.append(begins)
        self._ends.append(self.memory[begins])
        self.memory = self.memory.masked_fill(begins[:, None], 0)

    def stepped(self, inputs: Inputs, memory: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return outputs, values and the memories after a step of all agents, block by block."""
        parts = [self._unrolled(inputs.pick(block), memory[block]) for block in self.blocks]
        outputs, values, after = (torch.cat(part) for part in zip(*parts, strict=True))
        return outputs, values, after

    def _unrolled(self, inputs: Inputs, memory: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        outputs, values, (after,) = self.model.unrolled(one_step(inputs, memory))
        return outputs, values, after


def one_step(inputs: Inputs, memory: Tensor) -> Inputs:
    """Return what agents are given in one step, and remember before it, with an axis for steps."""
    return inputs.map(lambda tensor: tensor[None])._replace(memory=memory[None])


def chunked(rollout: RolloutBuffer, length: int) -> RolloutBuffer:
    """Return a rollout as chunks: a row for each of ``length`` steps, and a column for each chunk.

    Of memories there is one row: what chunks begin with.
    """

    def columns(tensor: Tensor) -> Tensor:
        steps, agents, *rest = tensor.shape
        chunks = tensor.reshape(steps // length, length, agents, *rest)
        return chunks.transpose(0, 1).flatten(1, 2)

    memory = rollout.inputs.memory
    assert memory is not None
    chunks = rollout._replace(inputs=rollout.inputs._replace(memory=None)).map(columns)
    return chunks._replace(inputs=chunks.inputs._replace(memory=memory.flatten(0, 1)[None]))
