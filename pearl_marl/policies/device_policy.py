"""Policies that run beside the environments: exact integers in, exact integers out, the same on every device.

An environment shows such a policy *elements*: the numbers of an observation as the integers that they are
made of. Those of a ``Box`` of floats are its fixed-point words, or where ``unpack`` writes floats, these in
fixed point; others are the elements of the observation itself. Chance comes from the same counter-based
random numbers as an environment's (:mod:`pearl_marl.golden.rng`), from an index on that no environment uses,
so that a rollout is what single steps would have been.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.golden import rng
from pearl_marl.spec import EnvSpec

FIRST_DRAW = 1 << 31
"""The index of a policy's first draw. Those of an environment's golden functions come long before it."""


class ActionChoice(NamedTuple):
    """What a policy chose, a row an agent."""

    words: Array
    """The words of actions, ``int64`` of shape ``(n, fields)``."""
    logits: Array | None
    """What the actions were chosen by, ``int32`` of shape ``(n, sum of action_counts)``, if by any."""


class CompiledPolicy(NamedTuple):
    """A policy as the CPU's loop of a rollout calls it."""

    act: int
    """The address of a function ``act(at, elements, masks, draws, words, logits)``.

    ``elements`` are the bytes of the elements of ``n`` agents of whole worlds; ``masks``, ``int8`` of shape
    ``(n, n_actions)`` or of no rows; ``draws``, ``uint32`` of shape ``(n, draws)``. It writes the words of
    actions to ``words``, ``int64`` of shape ``(n, fields)``, and logits to ``logits``, ``int32`` of shape
    ``(n, outputs)`` or of no rows. For a learner, draws are the bits of noise to be added to outputs, and
    logits those of the outputs, both ``float32``.
    """
    memory: Array
    """What ``act`` works on; ``at`` is its address."""
    draws: int
    owner: Any
    """What owns the arrays that the memory refers to."""

    @property
    def arguments(self) -> tuple[int, int, int]:
        """What the loop is given."""
        return self.act, self.memory.ctypes.data, self.draws


def best_of_fields(outputs: Array, counts: Sequence[int]) -> Array:
    """Return the number of the greatest output of each field, of so many outputs, ``(n, fields)``."""
    fields = np.split(outputs, np.cumsum(counts)[:-1], 1)
    return np.stack([field.argmax(1) for field in fields], 1)


ACT_ARGUMENTS = (
    0,
    np.zeros(0, np.uint8),
    *(np.zeros((0, 0), dtype) for dtype in (np.int8, np.uint32, np.int64, np.int32)),
)
"""What has the types of the arguments of a :class:`CompiledPolicy`'s ``act``."""


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

    def form(self, spec: EnvSpec) -> EnvSpec:
        """Return an environment with the elements that the policy is shown as observations."""
        return spec.in_elements

    @abstractmethod
    def choose(self, elements: Array, agents: Array, masks: Array | None, draws: Array) -> ActionChoice:
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
