"""What wrappers and bridges use of an environment: its batch of slots, behind either interface."""

from __future__ import annotations

from abc import abstractmethod
from copy import deepcopy
from functools import reduce
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Space
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.step import Array, BatchStep
from pearl_marl.elements import ActionSpace
from pearl_marl.spec import EnvSpec, Role

Mask = npt.NDArray[np.bool_]


class World(NamedTuple):
    """What agents that share a state have in common; every world of a batch is alike."""

    agents: int = 1
    """How many agents share a world."""
    roles: tuple[Role, ...] = ()
    """A role for each agent of a world; empty where all are alike."""
    masked: str = ""
    """What happens to masked actions: see :class:`EnvSpec`. Empty where there are no masks."""

    @classmethod
    def of(cls, spec: EnvSpec) -> World:
        """Return the worlds of an environment."""
        return cls(spec.agents, spec.roles, spec.masked if spec.mask_fields else "")

    def shown(self, observations: Space[Any] | None, actions: ActionSpace | None) -> World:
        """Return the same worlds with these spaces for every agent; ``None`` keeps those of the roles."""
        roles = (
            Role(role.name, observations or role.observation_space, actions or role.action_space)
            for role in self.roles
        )
        return self._replace(roles=tuple(roles))

    def rows(self, worlds: Mask) -> Mask:
        """Return a mask of agents for a mask of worlds."""
        return worlds if self.agents == 1 else worlds.repeat(self.agents)

    def begins(self, step: BatchStep) -> Mask:
        """Return which agents' worlds began a new episode in a step, a row an agent; SAME_STEP mode only."""
        if self.agents == 1:
            return step.ended
        # Where somebody ended and nobody is dead, everybody has begun again.
        # Agent by agent: along the short rows, any() and all() take ten times as long.
        ended, alive = (array.reshape(-1, self.agents).T for array in (step.ended, step.alive))
        return self.rows(reduce(np.bitwise_or, ended) & reduce(np.bitwise_and, alive))


class Batch:
    """A batch of agents: every environment of this package is one, of either interface, wrapped or not."""

    batch_size: int
    """Number of agents: worlds times agents per world. A *slot* here is the row of an agent."""

    world: World
    """How agents share states."""

    slot_observation_space: Space[Any]
    """The space of one slot's observation."""

    slot_action_space: ActionSpace
    """The space of one slot's action."""

    slot_autoreset_mode: AutoresetMode
    """When a slot that ended starts over: in the ``SAME_STEP``, or in the ``NEXT_STEP``.

    That is what :meth:`step_batch` does. A ``VectorEnv`` in DISABLED mode and agents that leave only hide it.
    """

    autoreset: bool
    """Whether slots that ended start over by themselves and need no reset."""

    def __copy__(self) -> Self:
        # Two environments that share a device would step each other's agents.
        return deepcopy(self)

    @property
    @abstractmethod
    def live(self) -> Mask:
        """Which agents are present, that is, have not left for good. Shape ``(batch_size,)``.

        The array is never written into. When somebody leaves or comes back, it is another one.
        """

    @property
    @abstractmethod
    def alive(self) -> Mask:
        """Which agents take part in the next step: see :class:`BatchStep`."""

    @property
    @abstractmethod
    def action_masks(self) -> Array | None:
        """Which actions are allowed in the next step: see :class:`BatchStep`. ``None`` without masks."""

    @property
    @abstractmethod
    def ready(self) -> bool:
        """Whether a step is possible: after the first reset, and until closed."""

    @abstractmethod
    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once; actions of agents that left are ignored."""

    @abstractmethod
    def reset_batch(self, seed: int | None = None) -> Array:
        """Begin an episode in every slot; return observations of shape ``(batch_size, ...)``."""

    @abstractmethod
    def reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked worlds, shape ``(worlds,)``; return all observations."""
