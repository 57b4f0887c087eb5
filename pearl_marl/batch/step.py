"""The results of one step of all slots."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from pearl_marl.base.arrays import Array
from pearl_marl.errors import renamed


class Observed(NamedTuple):
    """What agents see before a step, a row an agent; each as :class:`BatchStep` has it."""

    obs: Array
    action_masks: Array | None
    in_episode: Array


class _Results(NamedTuple):
    obs: Array
    rewards: Array
    terminations: Array
    truncations: Array
    final_obs: Array


class BatchStep(_Results):
    """The results of one step, a row an agent: NumPy arrays, or tensors of a device that was asked for them.

    It is a tuple of five arrays. Agent ``k`` of world ``w`` has row ``w * K + k``, where a world has ``K``.

    Attributes
    ----------
    obs
        Shape ``(n, *spec.observation_shape)``, in the space's dtype (of a ``Tuple`` space a column for each
        of its spaces). In SAME_STEP mode, where an episode ended, the first observation of the next one.
        Zeros where an agent has ended before its world.
    rewards
        ``float32``, shape ``(n,)``.
    terminations, truncations
        ``bool``, shape ``(n,)``. Both may be set: the last step of a time limit can also reach the goal. In a
        world that goes on, an agent that ended is not told so again.
    final_obs
        Like ``obs``; where an agent ended in this step, its last observation. Other rows have no meaning.
    """

    action_masks: Array | None = None
    """``int8``, shape ``(n, n_actions)``: which actions may be taken where ``obs`` was seen. Zeros for agents
    that are not ``in_episode``. ``None`` where the environment has no masks."""

    _in_episode: Array | None = None

    @classmethod
    def of(cls, arrays: Sequence[Any], masked: bool) -> Self:
        """Return the results in arrays: the five, masks if there are any, and ``in_episode`` if given."""
        step = cls(*arrays[:5])
        if masked:
            step.action_masks = arrays[5]
        if len(arrays) > 5 + masked:
            step._in_episode = arrays[5 + masked]
        return step

    @property
    def arrays(self) -> tuple[Array, ...]:
        """All arrays, as :meth:`of` takes them."""
        if self.action_masks is None and self._in_episode is None:
            return self
        return (*self, *(array for array in (self.action_masks, self._in_episode) if array is not None))

    def map(self, function: Callable[[Array], Any]) -> Self:
        """Return the same with a function of every array in its place."""
        return self.of([function(array) for array in self.arrays], self.action_masks is not None)

    @property
    def in_episode(self) -> Array:
        """Which agents take part in the next step, ``(n,)``: not those that have ended before their world."""
        return self.terminations | True if self._in_episode is None else self._in_episode

    alive = renamed("alive", "in_episode")

    @property
    def observed(self) -> Observed:
        """What agents see before the next step."""
        return Observed(self.obs, self.action_masks, self.in_episode)

    @property
    def ended(self) -> npt.NDArray[np.bool_]:
        """Which agents' episodes ended in this step, shape ``(n,)``."""
        return self.terminations | self.truncations

    def arrivals(self) -> Array:
        """Return where the step itself took every agent: ``final_obs`` where it ended, else ``obs``."""
        if not isinstance(self.obs, np.ndarray):  # tensors; to ask which slots ended would wait for them
            final: Any = self.final_obs
            return final.where(self.ended.reshape(-1, *(1,) * (final.ndim - 1)), self.obs)
        slots = np.flatnonzero(self.ended)
        if not slots.size:
            return self.obs
        obs = self.obs.copy()  # few slots end in most steps
        obs[slots] = self.final_obs[slots]
        return obs

    def on_host(self) -> Self:
        """Return the results as NumPy arrays: these, or copies of tensors."""
        return self.map(on_host)


def on_host(array: Any) -> Array:
    """Return a NumPy array: this one, or a copy of a tensor."""
    return array if isinstance(array, np.ndarray) else array.cpu().numpy()
