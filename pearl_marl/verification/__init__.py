"""Holding a device against the golden functions, and replaying where it differed.

May import ``devices``, ``comparison`` and what is below them.
"""

from pearl_marl.verification.modes import Run, runs, sticky_actions, verify
from pearl_marl.verification.replaying import replay

__all__ = ["Run", "replay", "runs", "sticky_actions", "verify"]
