"""The results of one step of all slots."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


class BatchStep(NamedTuple):
    """The results of one step, a row a slot: NumPy arrays, or tensors of a device that was asked for them.

    Parameters
    ----------
    obs
        Shape ``(n, *spec.observation_shape)``, in the space's dtype (of a ``Tuple`` space a column for each
        of its spaces). In SAME_STEP mode, where a slot ended, the first observation of its new episode.
    rewards
        ``float32``, shape ``(n,)``.
    terminations, truncations
        ``bool``, shape ``(n,)``. Both may be set: the last step of a time limit can also reach the goal.
    final_obs
        Like ``obs``; where a slot ended, the last observation of that episode. Other rows have no meaning.
    """

    obs: Array
    rewards: Array
    terminations: Array
    truncations: Array
    final_obs: Array

    @property
    def ended(self) -> npt.NDArray[np.bool_]:
        """Which slots' episodes ended in this step, shape ``(n,)``."""
        return self.terminations | self.truncations

    def arrivals(self) -> Array:
        """Return where the step itself took every slot: ``final_obs`` where it ended, else ``obs``."""
        if not isinstance(self.obs, np.ndarray):  # tensors; to ask which slots ended would wait for them
            final: Any = self.final_obs
            return final.where(self.ended.reshape(-1, *(1,) * (final.ndim - 1)), self.obs)
        slots = np.flatnonzero(self.ended)
        if not slots.size:
            return self.obs
        obs = self.obs.copy()  # few slots end in most steps
        obs[slots] = self.final_obs[slots]
        return obs

    def on_host(self) -> BatchStep:
        """Return the results as NumPy arrays: these, or copies of tensors."""
        return BatchStep(*map(on_host, self))


def on_host(array: Any) -> Array:
    """Return a NumPy array: this one, or a copy of a tensor."""
    return array if isinstance(array, np.ndarray) else array.cpu().numpy()
