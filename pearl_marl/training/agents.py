"""Agents that step by tensors, and the rewards of a team."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Discrete
from torch import Tensor

from pearl_marl.batch.config import worlds_of
from pearl_marl.batch.rollout import Experience
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.compiler.packing import packed
from pearl_marl.devices import BatchConfig, BatchStep, Cuda, Device, make_device
from pearl_marl.policies.dense_policy import DenseNetwork
from pearl_marl.policies.trained import NetworkPolicy
from pearl_marl.spec import EnvSpec
from pearl_marl.training.actor_critic import Inputs


def observed_spec(spec: EnvSpec, device: str | Device) -> EnvSpec:
    """Return the spec by which agents observe: on the host, planes are packed into words."""
    on_gpu = device == Cuda.name or isinstance(device, Cuda)
    return spec if spec.unpack is None or on_gpu else packed(spec)


class Agents:
    """``n`` agents of whole worlds, from the global number ``first`` on.

    They are stepped by tensors, which stay where the device has its results: of ``"cuda"`` on the GPU. A
    step's results, and ``inputs``, are written over by the next step.

    Attributes
    ----------
    inputs
        What networks are given before the next step; with ``central``, also the states of the worlds.
    alive
        Which agents take part in the next step.
    acting
        Which of these have something to decide in it: not those that wait for their turn.
    begins
        Which of them forget what they remember before it, as an episode of theirs has ended; none at first.
    """

    def __init__(
        self,
        spec: EnvSpec,
        device: str | Device,
        n: int,
        seed: int,
        first: int = 0,
        central: bool = False,
    ) -> None:
        self.spec, self.central = spec, central
        self.device = make_device(device, tensors=True)
        observed, first_slot = observed_spec(spec, device), first // spec.agents
        self.device.open(
            BatchConfig(spec=observed, n_envs=worlds_of(spec, n), first_slot=first_slot, copy=False)
        )
        obs = torch.as_tensor(self.device.reset(seed))
        number = torch.arange(n, device=obs.device)
        self.position = number % spec.agents if spec.agents > 1 else None
        self.alive = number >= 0
        self.begins = ~self.alive
        self._observe(obs)

    @property
    def obs(self) -> Tensor:
        """What they observe now."""
        return self.inputs.obs

    def step(self, actions: Tensor) -> Any:
        """Step every agent; return a :class:`BatchStep` of tensors."""
        taken: Any = actions
        if not self.device.tensors:
            taken = actions.numpy()
            if isinstance(self.spec.action_space, Discrete):  # the words that a device takes as they are
                taken = taken.astype(self.spec.action_dtype)
        step: Any = BatchStep(*map(torch.as_tensor, self.device.step(taken)))  # type: ignore[arg-type]
        alive = self.alive
        self._observe(step.obs)
        # One that had ended before its world may have been stepped since.
        self.begins = step.ended | ~alive
        return step

    def network_beside(self, policy: NetworkPolicy) -> DenseNetwork | None:
        """Return what chooses actions beside these agents, if that can be: a network for the CPU."""
        asked_otherwise = self.spec.turns or self.central or self.spec.unpack is not None
        return policy.dense if self.device.runs_networks and not asked_otherwise else None

    def experience(self, network: DenseNetwork, noise: Tensor) -> Experience:
        """Step every agent by a network with noise, as often as that has rows; return all steps."""
        steps = self.device.experience(network, noise.numpy())
        self._observe(steps.observations[-1].copy())  # a view would keep all of them
        over = steps.terminations[-1] | steps.truncations[-1] | ~steps.in_episode[-2]
        self.begins = torch.from_numpy(over)
        return steps

    def _observe(self, obs: Any) -> None:
        obs = torch.as_tensor(obs)
        masks = state = None
        if self.device.action_masks is not None:
            masks = torch.as_tensor(self.device.action_masks, device=obs.device)
        if self.central:
            words = torch.as_tensor(self.device.state().astype(np.float32), device=obs.device)
            state = words.repeat_interleave(self.spec.agents, 0)
        self.inputs = Inputs(obs, masks, self.position, state)
        if self.spec.agents > 1:  # an agent that is alone does not end before its world
            self.alive = torch.as_tensor(self.device.in_episode, device=obs.device).clone()
        self.acting = acting(self.alive, masks)

    @property
    def config(self) -> BatchConfig:
        """The batch that a saved state of these agents has to agree with."""
        return self.device.config

    def state(self) -> SavedState:
        """Return all that the agents' continuation depends on."""
        return self.device.snapshot()

    def load(self, state: SavedState) -> None:
        """Go on from what :meth:`state` returned."""
        self._observe(self.device.restore(state))
        self.begins = torch.zeros_like(self.begins)


def acting(alive: Tensor, masks: Tensor | None) -> Tensor:
    """Return which of the agents that take part have something to decide."""
    return alive if masks is None else alive & (masks != 0).any(-1)


TEAM = ("own", "mean", "sum")
"""Whose rewards an agent wants: see :func:`team_rewards`."""


def team_rewards(rewards: Tensor, agents: int, whose: str) -> Tensor:
    """Return, for each agent of a world, its own reward, or the mean or the sum of all of them."""
    if whose == "own" or agents == 1:
        return rewards
    worlds = rewards.reshape(*rewards.shape[:-1], -1, agents)
    together = worlds.mean(-1) if whose == "mean" else worlds.sum(-1)
    return together.repeat_interleave(agents, -1)
