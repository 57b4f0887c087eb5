"""What wrappers and bridges know of an environment: its batch of slots, whichever interface is around it."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete, Space
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.step import Array, BatchStep

Mask = npt.NDArray[np.bool_]


class Batch(Protocol):
    """A batch of slots: every environment of this package is one, of either interface, wrapped or not."""

    @property
    def batch_size(self) -> int:
        """How many slots."""

    @property
    def slot_observation_space(self) -> Space[Any]:
        """The space of one slot's observation."""

    @property
    def slot_action_space(self) -> Discrete | Box:
        """The space of one slot's action."""

    @property
    def slot_autoreset_mode(self) -> AutoresetMode:
        """When a slot that ended begins again: in the ``SAME_STEP``, or in the ``NEXT_STEP``.

        That is what :meth:`step_batch` does. A ``VectorEnv`` in DISABLED mode and agents that leave only
        hide it.
        """

    @property
    def autoreset(self) -> bool:
        """Whether whoever ended is seen to begin again, and need not be reset."""

    @property
    def live(self) -> Mask:
        """Which slots' agents are there: they have not left for good. Shape ``(batch_size,)``.

        The array is never written into. When somebody leaves or comes back, it is another one.
        """

    @property
    def ready(self) -> bool:
        """Whether a step is possible: after the first reset, and until closed."""

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once; what ``actions`` hold for agents that left does not matter."""

    def reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked slots; return all observations."""
