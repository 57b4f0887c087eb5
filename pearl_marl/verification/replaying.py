"""Making a recorded call again, in which two devices differed."""

from __future__ import annotations

from pearl_marl.comparison.replay import Replay
from pearl_marl.devices import Lockstep
from pearl_marl.errors import LockstepError


def replay(recorded: Replay, lockstep: Lockstep) -> LockstepError | None:
    """Make a call again; return where the devices differ now, ``None`` if they agree.

    Parameters
    ----------
    recorded
        The call, and the state before it.
    lockstep
        A new one of the two devices; closed afterwards.
    """
    lockstep.open(recorded.config)
    try:
        if recorded.before is not None:
            lockstep.restore(recorded.before)
        if recorded.actions is not None:
            lockstep.step_words(recorded.actions)
        elif recorded.divergence.call == "reset":
            lockstep.reset(recorded.seed, recorded.mask)
        lockstep.snapshot()
    except LockstepError as error:
        return error
    finally:
        lockstep.close()
    return None
