"""What learners from rollouts have in common: gather one, learn from it in minibatches, forget it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import torch
from torch import Tensor

from pearl_marl.policies.second_thread import left_to_loops
from pearl_marl.spec import EnvSpec
from pearl_marl.training.adam import Adam
from pearl_marl.training.halves import AutogradHalves
from pearl_marl.training.recurrent import RecurrentWorker, chunked
from pearl_marl.training.restoring import copied
from pearl_marl.training.rollout import RolloutBuffer, RolloutWorker
from pearl_marl.training.settings import check_memory
from pearl_marl.training.trainer import Trainer
from pearl_marl.training.workers import RayWorkers


class OnPolicyTrainer(Trainer):
    """A run of an algorithm that learns from rollouts: :meth:`iterate` is one update.

    Without a memory it learns from rows of a rollout, whose steps and agents are one axis; with one, from
    columns of :func:`~pearl_marl.training.recurrent.chunked`.

    It learns where the device has its observations: with ``"cuda"``, on the GPU. This process gathers
    rollouts, or as many of Ray's as ``shards`` says; the result is the same.
    """

    gathers: tuple[type[RolloutWorker], type[RecurrentWorker]] = RolloutWorker, RecurrentWorker
    """The classes that gather rollouts in this process: with policies that do not remember, or do."""

    losses: tuple[str, ...]
    """The names of what :meth:`autograd` returns."""

    max_grad_norm: float

    of_teams = False
    """Whether what is learned from are whole teams: a world's rows, or chunks."""

    def __init__(self, spec: EnvSpec, device: Any, settings: Any, shards: int | None = None) -> None:
        torch.manual_seed(settings.seed)
        self.model = self.made(spec, settings)
        # Of every step at least an observation, six numbers more, and the next rollout's noise; memories of
        # every chunk.
        rows = settings.n_agents * settings.rollout_length
        others, names = (6 + self.model.policy.outputs) * 4 * rows, ["n_agents", "rollout_length"]
        if self.model.policy.remembers:
            others += 4 * self.model.memory_size * rows // settings.chunk_length
            names += ["width", "chunk_length"]
        self.need = check_memory(spec, settings, device, names, rows, others, lasting=False)
        self.worker: Any
        if shards is None:
            forgetful, remembering = self.gathers
            gathers = remembering if self.model.policy.remembers else forgetful
            self.worker = gathers(spec, device, settings, self.model)
            agents = self.worker.agents
            self.begins_noise = self.worker.where.type == "cpu"
        else:
            self.begins_noise = False
            agents = self.worker = RayWorkers(spec, device, settings, self.model, shards)
        super().__init__(settings, agents, self.worker.where)
        self.steps_per_iteration = settings.rollout_length
        self.model.to(self.where)
        self.policy = self.model.policy
        self.optimiser = Adam(self.model.parameters(), epsilon=1e-5, max_grad_norm=self.max_grad_norm)
        self.team = spec.agents if self.of_teams else 1
        width = settings.width * self.team
        if self.policy.remembers:
            width *= settings.chunk_length
        self.halves = AutogradHalves(self.optimiser.parameters, width)
        self.components = {"model": self.model, "optimiser": self.optimiser}
        self.last_losses = torch.zeros(len(self.losses), device=self.where)

    def made(self, spec: EnvSpec, settings: Any) -> Any:
        """Return the model that is learned."""
        raise NotImplementedError

    def loops(self, samples: RolloutBuffer) -> Callable[[Tensor], Tensor] | None:
        """Return compiled loops that do what :meth:`autograd` does with a rollout's rows, if they can."""
        raise NotImplementedError

    def autograd(self, samples: RolloutBuffer, minibatch: Tensor) -> Tensor:
        """Leave the gradients of the loss of some rows, or chunks, with the parameters; return the losses."""
        raise NotImplementedError

    def all_steps(self, samples: RolloutBuffer, minibatch: Tensor) -> tuple[Tensor, Tensor, RolloutBuffer]:
        """Return the model's outputs and values for rows, or for all steps of chunks; and these samples."""
        if not self.policy.remembers:
            batch = samples.pick(minibatch)
            return *self.model(batch.inputs), batch
        batch = samples.pick((slice(None), minibatch))
        outputs, values, _ = self.model.unrolled(batch.inputs)
        return outputs, values, batch.flat()

    def forward(self, samples: RolloutBuffer, minibatch: Tensor) -> tuple[Tensor, Tensor, RolloutBuffer]:
        """Return the same for those of these rows, or steps of chunks, that are learned from."""
        outputs, values, batch = self.all_steps(samples, minibatch)
        if not self.policy.remembers:
            return outputs, values, batch
        rows = batch.loss_mask.nonzero()[:, 0]
        return outputs[rows], values[rows], batch.pick(rows)

    def terms(self, samples: RolloutBuffer, minibatch: Tensor) -> int:
        """Return how many terms the loss of some rows, or chunks, or teams of these, averages."""
        if not self.policy.remembers:
            return len(minibatch)
        # The other steps of chunks are not learned from.
        teams = samples.loss_mask.view(len(samples.loss_mask), -1, self.team)[:, minibatch]
        return int(teams.any(2).sum())

    def update(self) -> None:
        """Gather a rollout and learn from it."""
        rollout = self.worker.gather(self.done)
        if self.begins_noise and self.threads > 1 and self.done + 1 < self.settings.iterations:
            self.worker.begin_noise(self.done + 1)
        self.count(rollout)
        samples = rollout.flat()
        rows = samples.loss_mask.nonzero()[:, 0]
        if len(rows):
            inputs = samples.inputs
            self.model.see(inputs if len(rows) == len(inputs.obs) else inputs.pick(rows))
            if self.policy.remembers:
                samples = chunked(rollout, self.settings.chunk_length)
                rows = samples.loss_mask.any(0).nonzero()[:, 0]
            self.learn(samples, rows)
        self.done += 1

    def learn(self, samples: RolloutBuffer, rows: Tensor) -> None:
        """Learn from these rows, or chunks, of a rollout."""
        rate = self.settings.learning_rate * (1 - self.done / self.settings.iterations)
        self.last_losses = self.descend(samples, rows, rate).mean(0)
        self.check(self.last_losses)

    def descend(self, samples: RolloutBuffer, rows: Tensor, rate: float) -> Tensor:
        """Learn from minibatches of these rows, one after the other; return the losses of each."""
        loops, most, losses = self.loops(samples), min(self.minibatch, len(rows)), []
        gradients = partial(self.autograd, samples) if loops is None else loops
        with self.halves.shared(most, self.threads) if loops is None else left_to_loops(self.threads):
            for minibatch in self.minibatches(rows):
                losses.append(gradients(minibatch))
                self.optimiser.step(rate)
        return torch.stack(losses)

    def count(self, rollout: RolloutBuffer) -> None:
        """Count the episodes that ended."""
        self.episodes.add(rollout.rewards, rollout.ended)

    def figures(self) -> dict[str, float | None]:
        """Return figures for the metrics: of episodes since they were last asked for, and the last losses."""
        return {**super().figures(), **dict(zip(self.losses, self.last_losses.tolist(), strict=True))}

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on."""
        memory = {"memory": self.worker.memory} if self.policy.remembers else {}
        return {**super().state(), **memory}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        super().load(state)
        if self.policy.remembers:
            copied("memory of agents", self.worker.memory, state["memory"], -1, 1)

    @property
    def minibatch(self) -> int:
        """How many rows, or chunks, or teams of these, are learned from at a time."""
        steps = self.settings.chunk_length if self.policy.remembers else 1
        return max(int(self.settings.minibatch) // steps // self.team, 1)

    @property
    def together(self) -> int:
        """How many neighbouring rows share a state; minibatches keep them together."""
        return 1

    def minibatches(self, rows: Tensor) -> Iterator[Tensor]:
        """Yield rows in random order; those of a world's step follow each other."""
        size = self.together
        groups = rows // size
        if size > 1:
            groups = torch.unique_consecutive(groups)
            taken = torch.zeros((int(groups[-1]) + 1) * size, dtype=torch.bool, device=self.where)
            taken[rows] = True
        for _ in range(self.settings.epochs):
            order = torch.randperm(len(groups), generator=self.random, device=self.where)
            for picked in torch.split(groups[order], max(self.minibatch * len(groups) // len(rows), 1)):
                if size > 1:
                    some = (picked[:, None] * size + torch.arange(size, device=self.where)).flatten()
                    yield some[taken[some]]
                else:
                    yield picked
