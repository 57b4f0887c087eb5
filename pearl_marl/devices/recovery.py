"""Going on after a failure: the last state that was kept, and all calls since, once more.

::

    reset --> step --> step --> ... --> step --> step fails --> recover() --> step
      |                           |         |                     |
    kept                        kept      noted     put back what was kept, take the noted steps again

A device's answers depend on nothing but its state and the calls, so what comes after is what would
have come without the failure, bit for bit, whatever the device did or did not do of the call that failed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.errors import DeviceError

CHECKPOINT_EVERY = 100
"""Steps between two states that are kept. Of 43,008 slots of CliffWalking, a state takes 0.3 ms to keep,
and the actions of 100 steps are 4 MB."""

Kept = tuple[BatchConfig, SavedState]
Calls = list[tuple[str, tuple[Any, ...]]]


class CheckpointLog:
    """Keeps a state of a device's slots on the host, and the calls since.

    It does not refer to the device, so that one that is no longer used frees its board at once.

    Parameters
    ----------
    every
        Steps between two states that are kept; ``None`` keeps nothing.
    """

    def __init__(self, every: int | None) -> None:
        self._every = every
        # What is kept, with the configuration of that moment; and the calls since, by name and arguments.
        self._kept: Kept | None = None
        self._calls: Calls = []
        self._marked: tuple[Kept | None, Calls, int] = None, [], 0

    def before(self, device: Any, call: str) -> None:
        """Keep the state before a step, rather than after one: then what it returned is safe already.

        A rollout counts as one step: to repeat it takes the host nothing, and its state is not there yet.
        """
        if call in ("step_words", "rollout") and self._every is not None and len(self._calls) >= self._every:
            self._keep(device, device.snapshot())

    def after(self, device: Any, call: str, *arguments: Any) -> None:
        """Note a call that succeeded; keep the state that begins anew."""
        if self._every is None:
            return
        if call == "restore":
            self._keep(device, arguments[0].copy())
        elif call == "reset" and arguments[1] is None:
            self._keep(device, device.snapshot())
        else:
            copies = (a.copy() if isinstance(a, np.ndarray) else a for a in arguments)
            self._calls.append((call, tuple(copies)))

    def recover(self, device: Any) -> None:
        """Restore what is kept and make the calls since again; see :meth:`Device.recover`."""
        if self._kept is None:
            why = "checkpoint_every is None" if self._every is None else "no reset has succeeded"
            raise DeviceError(
                f"the {device.name} device keeps nothing to recover from, as {why}: "
                "call reset(), or load a saved state"
            )
        (config, saved), calls = kept, calls_before = self._kept, self._calls
        position = device.position
        device.config = config
        try:
            device.restore(saved)
            for name, arguments in calls:  # which notes them again
                getattr(device, name)(*arguments)
        except BaseException:
            device.position = position
            device.fail()
            self._kept, self._calls = kept, calls_before
            raise

    def mark(self) -> None:
        """Remember this moment for :meth:`rewind`."""
        self._marked = self._kept, self._calls, len(self._calls)

    def rewind(self, device: Any) -> None:
        """Recover what was at the mark: a call since may have succeeded here, but not on other devices."""
        self._kept, calls, count = self._marked
        self._calls = calls[:count]
        self.recover(device)

    def _keep(self, device: Any, saved: SavedState) -> None:
        self._kept = device.config, saved
        self._calls = []
