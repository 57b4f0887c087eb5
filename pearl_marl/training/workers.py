"""Rollouts of one training run, gathered by many processes: weights travel instead of steps.

A worker's rollout depends on the weights that it is sent and on its agents' state, which comes back each
time. A lost worker is replaced by one that gets that state, and gathers the same.
"""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import BatchConfig, worlds_of
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.devices import cluster
from pearl_marl.devices.ray import Packed, pack, unpacked
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.spec import EnvSpec
from pearl_marl.training.actor_critic import Inputs
from pearl_marl.training.recurrent import RecurrentWorker
from pearl_marl.training.rollout import RolloutBuffer, RolloutWorker, block_edges

RESOURCES: dict[str, dict[str, float]] = {"cuda": {"GPU": 1}, "xdma": {"fpga": 1}, "serial": {"fpga": 1}}
"""Resources that a worker needs of its machine, by its device."""

ATTEMPTS = 3
"""How often in a row a worker may be lost in the same rollout, or while it starts."""


class Worker:
    """A :class:`RolloutWorker` in a process of its own, which is sent weights."""

    def begin(self, packed: Packed) -> SavedState:
        """Make the agents; return their state. In the parcel are arguments of :class:`RolloutWorker`."""
        torch.set_num_threads(1)
        spec, device, settings, blocks, model = unpacked(packed)
        self.model = model(spec, settings)
        gathers = RecurrentWorker if self.model.policy.remembers else RolloutWorker
        self.worker: Any = gathers(spec, device, settings, self.model, blocks)
        self.model.to(self.worker.where)
        return self.worker.agents.state()

    def gather(
        self, rollout: int, weights: dict[str, Array], state: AgentsState | None
    ) -> tuple[RolloutBuffer, AgentsState]:
        """Return a rollout of arrays, and the agents' state after it; they begin at ``state``, if any."""
        remembers = self.model.policy.remembers
        if state is not None:
            saved, memory = state
            self.worker.agents.load(saved)
            if remembers:
                self.worker.memory = torch.tensor(memory, device=self.worker.where)
        # Copies: arrays out of the object store cannot be written to.
        self.model.load_state_dict({name: torch.tensor(array) for name, array in weights.items()})
        arrays = self.worker.gather(rollout).map(lambda tensor: tensor.cpu().numpy())
        memory = self.worker.memory.cpu().numpy() if remembers else None
        return arrays, (self.worker.agents.state(), memory)


AgentsState = tuple[SavedState, Array | None]
"""All that agents' continuation depends on: their state, and what they remember, if anything."""


class RayWorkers:
    """Gathers as one :class:`RolloutWorker` of all agents would, with as many actors of Ray as ``shards``.

    Blocks of agents are divided among them evenly.

    Raises
    ------
    ArgumentError
        There are fewer blocks than shards.
    DeviceError
        There is no Ray, or no machine for a worker.
    """

    def __init__(self, spec: EnvSpec, device: str, settings: Any, model: Any, shards: int) -> None:
        if shards < 1:
            raise ArgumentError(f"--shards is {shards}; it must be at least 1, or left out for this process")
        if shards > settings.blocks:
            raise ArgumentError(
                f"--shards is {shards}; the agents are in {settings.blocks} blocks, and a shard has at least "
                f"one: --set blocks={shards}, with which the run is another"
            )
        self.spec, self.settings, self.model, self.device = spec, settings, model, device
        self._resources = RESOURCES.get(device.partition(":")[0])
        learns_on_gpu = device == "cuda" and torch.cuda.is_available()
        self.where = torch.device("cuda" if learns_on_gpu else "cpu")
        edges = (i * settings.blocks // shards for i in range(shards + 1))
        self._blocks = [range(*pair) for pair in itertools.pairwise(edges)]
        ray = cluster.connect()
        self._put = ray.put
        with ThreadPoolExecutor(shards) as pool:  # each takes seconds
            started = list(pool.map(self._start, range(shards)))
        self.memory = torch.zeros(settings.n_agents, model.memory_size)  # of policies that remember
        self._actors = [actor for actor, _ in started]
        self._states = [state for _, state in started]
        self._behind = False  # whether the actors' agents have to be given the states noted here

    def _start(self, i: int) -> tuple[Any, SavedState]:
        """Return an actor for a shard, and its agents' first state."""
        sent = pack(self.spec, self.device, self.settings, self._blocks[i], type(self.model))
        for attempt in itertools.count(1):
            try:
                actor = cluster.start_actor(Worker, resources=self._resources)
                return actor, cluster.get(actor.begin.remote(sent))
            except cluster.lost() as error:
                self._give_up(i, attempt, "while it started", error)
        raise AssertionError

    def gather(self, rollout: int) -> RolloutBuffer:
        """Have all agents stepped; return the rollout of that number."""
        weights = self._put({name: tensor.cpu().numpy() for name, tensor in self.model.state_dict().items()})
        under_way = [self._ask(i, rollout, weights) for i in range(len(self._actors))]
        # Should it fail, all begin at the states noted here, whichever were done.
        self._behind = True
        gathered: list[tuple[RolloutBuffer, AgentsState]] = []
        for i, asked in enumerate(under_way):
            for attempt in itertools.count(1):
                try:
                    gathered.append(cluster.get(asked))
                    break
                except cluster.lost() as error:
                    advice = ". With the same --out the run goes on later"
                    self._give_up(i, attempt, f"in rollout {rollout}", error, advice)
                    cluster.kill(self._actors[i])
                    self._actors[i], _ = self._start(i)
                    asked = self._ask(i, rollout, weights)
        self._states = [state for _, (state, _) in gathered]
        for i, (_, (_, memory)) in enumerate(gathered):
            if memory is not None:
                self.memory[self._rows(i)] = torch.tensor(memory)
        self._behind = False
        inputs = zip(*(share.inputs for share, _ in gathered), strict=True)
        others = zip(*(share[1:] for share, _ in gathered), strict=True)
        return RolloutBuffer(Inputs(*map(self._joined, inputs)), *map(self._joined, others))

    def _joined(self, parts: tuple[Any, ...]) -> Any:
        """Return the arrays of all shards side by side, or None if they have none."""
        return None if parts[0] is None else torch.from_numpy(np.concatenate(parts, 1)).to(self.where)

    def _give_up(self, i: int, attempt: int, when: str, error: BaseException, advice: str = "") -> None:
        """Raise where a worker was lost too often, or can never start."""
        if attempt == ATTEMPTS or getattr(error, "actor_init_failed", False):
            lines = [line.strip() for line in str(error).splitlines() if line.strip()]
            why = " ... ".join(dict.fromkeys((lines[0], lines[-1])))
            raise DeviceError(
                f"the worker of shard {i} was lost {attempt} times {when}, last by: {why}{advice}"
            ) from error

    def _rows(self, i: int) -> slice:
        """Return which agents are a shard's."""
        edges = block_edges(self.settings, self._blocks[i])
        return slice(edges[0], edges[-1])

    def _ask(self, i: int, rollout: int, weights: Any) -> Any:
        state = (self._states[i], self.memory[self._rows(i)].numpy()) if self._behind else None
        return self._actors[i].gather.remote(rollout, weights, state)

    @property
    def config(self) -> BatchConfig:
        """The batch that a saved state of all agents has to agree with."""
        return BatchConfig(spec=self.spec, n_envs=worlds_of(self.spec, self.settings.n_agents))

    def state(self) -> SavedState:
        """Return all that the agents' continuation depends on: the same, however many shards there are."""
        return SavedState.join(self.spec, self._states)

    def load(self, state: SavedState) -> None:
        """Go on from what :meth:`state` returned, or that of this process's own agents."""
        self._states = [state.cut(self.spec, self._rows(i)) for i in range(len(self._blocks))]
        self._behind = True
