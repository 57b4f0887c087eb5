"""Policies that run beside the environments: exact integers in, exact integers out, the same on every device.

An environment shows such a policy *elements*: the numbers of an observation as the integers that they are
made of. Those of a ``Box`` of floats are its fixed-point words; others are the elements of the observation
itself. Chance comes from the same counter-based random numbers as an environment's (:mod:`pearl_marl.rng`),
from an index on that no environment uses, so that a rollout is what single steps would have been.
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box

from pearl_marl import rng
from pearl_marl.spec import EnvSpec, Itself

Array = npt.NDArray[Any]

FIRST_DRAW = 1 << 31
"""The index of a policy's first draw. Those of an environment's golden functions come long before it."""


class Choice(NamedTuple):
    """What a policy chose, a row an agent."""

    words: Array
    """The words of actions, ``int64`` of shape ``(n, fields)``."""
    logits: Array | None
    """What the actions were chosen by, ``int32`` of shape ``(n, sum of action_counts)``, if by any."""


class DevicePolicy(ABC):
    """A policy that every device can run beside its environments.

    ``spec`` is the environment that it is for, and ``draws`` how many random numbers it takes for an action.
    Where masks forbid what a policy would choose otherwise, it takes what it likes best of the rest, or the
    first action that is allowed. Where all are forbidden, what it chooses is ignored by the environment.
    """

    spec: EnvSpec
    draws: int = 0
    logits: int = 0
    """How many logits an action is chosen by."""

    @abstractmethod
    def choose(self, elements: Array, agents: Array, masks: Array | None, draws: Array) -> Choice:
        """Return an action for each agent.

        Parameters
        ----------
        elements
            What is observed, integers of shape ``(n, elements)``.
        agents
            Which agent of its world each is, shape ``(n,)``.
        masks
            ``int8`` of shape ``(n, n_actions)``, or ``None`` where the environment has none.
        draws
            ``uint32`` of shape ``(n, self.draws)``, as :func:`policy_draws` makes them.
        """


def policy_draws(
    count: int, seed: tuple[int, int], tick: int, slots: Array, agents: Array, per_world: int
) -> Array:
    """Return the draws that a policy's actions at a tick take, ``uint32`` of shape ``(n, count)``.

    ``slots`` are the global numbers of the agents' worlds, and ``agents`` their places there. Agent ``k`` of
    a world has the indices from ``FIRST_DRAW + count * k`` on.
    """
    result = np.empty((len(slots), count), np.uint32)
    for agent in range(per_world):
        rows = agents == agent
        for k in range(count):
            result[rows, k] = rng.draws(seed, slots[rows], tick, FIRST_DRAW + count * agent + k)
    return result


def elements_of(spec: EnvSpec) -> EnvSpec:
    """Return the same environment with the elements of its observations as observations: integers.

    It is the same spec where they are integers already.
    """
    return spec if spec.observation_dtype.kind in "biu" else _elements_of(Itself(spec))


@functools.lru_cache(maxsize=64)
def _elements_of(itself: Itself) -> EnvSpec:
    spec = itself.spec
    fields = tuple(replace(field, fraction=0) for field in spec.observation)
    dtype = np.int64 if any(field.bits + (not field.signed) > 32 for field in fields) else np.int32
    low, high = np.array([field.range for field in fields], np.int64).T
    space = Box(low.astype(dtype), high.astype(dtype), (len(fields),), dtype)
    roles = tuple(role._replace(observation_space=space) for role in spec.roles)
    return replace(
        spec,
        golden=spec.golden._replace(view=None),
        observation=fields,
        observation_space=space,
        roles=roles,
    )
