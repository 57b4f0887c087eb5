"""Every error this package raises on purpose.

A refused call changes nothing: whoever catches one of these may go on with the environment as
it was before the call.
"""

from __future__ import annotations

import warnings
from typing import Any


def brief(value: Any) -> str:
    """Return what stands for a value from a file in a sentence: one line, however long the value is."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits
        text = f"of the type {type(value).__name__}"
    return text if len(text) <= 200 else f"{text[:200]}..."


def one_line(why: object) -> str:
    """Return what another error says, as a part of a sentence: on one line, and not too long."""
    text = " ".join(str(why).split())
    return text if len(text) <= 600 else f"{text[:400]}...{text[-150:]}"


class PearlError(Exception):
    """Base of every error of this package."""


class ArgumentError(PearlError, ValueError):
    """An argument is not among those that are possible; the message names the value and the limit."""


class ActionError(PearlError, ValueError):
    """An action is missing, of the wrong kind or out of range.

    The message names the first agent concerned, its action, and the action space.
    """


class OrderError(PearlError, RuntimeError):
    """A call came at the wrong time: ``step`` before ``reset``, or anything after ``close``."""


class SavedStateError(PearlError, ValueError):
    """A saved state is damaged, or belongs to another environment, size or version."""


class DeviceError(PearlError, RuntimeError):
    """A device is not available or failed; the message names it and says what to do."""


class LockstepError(PearlError, AssertionError):
    """Two devices that must agree bit for bit did not.

    Attributes
    ----------
    divergence
        What differs, decoded: a :class:`pearl_marl.devices.divergence.Divergence`. Its fields ``step``,
        ``slot``, ``state_before`` and ``action`` are attributes of the error too, and those of its first
        difference: ``field``, ``device_value`` and ``reference_value``.
    replay
        What does it again: a :class:`pearl_marl.devices.replay.Replay`.
    """

    def __init__(self, divergence: Any, replay: Any) -> None:
        super().__init__(divergence, replay)
        self.divergence = divergence
        self.replay = replay
        self.step = divergence.step
        self.slot = divergence.slot
        self.field, self.device_value, self.reference_value = divergence.differences[0]
        self.state_before = divergence.state_before
        self.action = divergence.action

    def __str__(self) -> str:
        return str(self.divergence)


def renamed(old: str, new: str) -> Any:
    """Return a property that reads attribute ``new`` and warns that ``old`` is its name of before."""

    def value(self: Any) -> Any:
        warnings.warn(f"{old} is now {new}", DeprecationWarning, stacklevel=2)
        return getattr(self, new)

    return property(value)
