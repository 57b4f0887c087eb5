"""What wrappers and bridges know of an environment: its batch of slots, whichever interface is around it."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete, Space
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.step import Array, BatchStep

Mask = npt.NDArray[np.bool_]


class Batch:
    """A batch of slots: every environment of this package is one, of either interface, wrapped or not."""

    batch_size: int
    """How many slots."""

    slot_observation_space: Space[Any]
    """The space of one slot's observation."""

    slot_action_space: Discrete | Box
    """The space of one slot's action."""

    slot_autoreset_mode: AutoresetMode
    """When a slot that ended begins again: in the ``SAME_STEP``, or in the ``NEXT_STEP``.

    That is what :meth:`step_batch` does. A ``VectorEnv`` in DISABLED mode and agents that leave only hide it.
    """

    autoreset: bool
    """Whether whoever ended is seen to begin again, and need not be reset."""

    @property
    @abstractmethod
    def live(self) -> Mask:
        """Which slots' agents are there: they have not left for good. Shape ``(batch_size,)``.

        The array is never written into. When somebody leaves or comes back, it is another one.
        """

    @property
    @abstractmethod
    def ready(self) -> bool:
        """Whether a step is possible: after the first reset, and until closed."""

    @abstractmethod
    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once; what ``actions`` hold for agents that left does not matter."""

    @abstractmethod
    def reset_batch(self, seed: int | None = None) -> Array:
        """Begin an episode in every slot; return observations of shape ``(batch_size, ...)``."""

    @abstractmethod
    def reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked slots; return all observations."""
