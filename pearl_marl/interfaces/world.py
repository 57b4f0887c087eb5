"""What agents that share a state have in common."""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Space

from pearl_marl.batch.step import BatchStep
from pearl_marl.spec import EnvSpec, Role
from pearl_marl.spec.elements import ActionSpace

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

    def with_spaces(self, observations: Space[Any] | None, actions: ActionSpace | None) -> World:
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
        # Where an agent ended and all are in an episode, the whole world has begun again.
        # Agent by agent: along the short rows, any() and all() take ten times as long.
        ended, in_episode = (array.reshape(-1, self.agents).T for array in (step.ended, step.in_episode))
        return self.rows(reduce(np.bitwise_or, ended) & reduce(np.bitwise_and, in_episode))
