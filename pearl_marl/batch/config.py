"""What a device is opened for: the environment, how many slots, and how they start over."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from pearl_marl.checks import checked_choice, checked_flag, checked_integer
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, check_max_cycles, check_slots, check_spec

GOLDEN = "golden_functions"
"""Of an identity: what the golden functions do. Saved states of 0.1.0 do not have it."""


def worlds_of(spec: EnvSpec, n_agents: int | None) -> int:
    """Return how many slots have so many agents together; ``None`` is one of them.

    Raises ArgumentError where the worlds of the environment cannot have so many: names those next to it that
    they can.
    """
    k = spec.agents
    if n_agents is None:
        return 1
    if k == 1:
        return n_agents  # BatchConfig says what is wrong
    if checked_integer("the number of agents", n_agents) % k:
        low = max(n_agents // k, 1) * k
        raise ArgumentError(
            f"n_agents is {n_agents}, and a world of {spec.name} has {k} agents; {low} and {low + k} fit"
        )
    return int(n_agents) // k


@dataclass(frozen=True, kw_only=True)
class BatchConfig:
    """What a device is opened for; checked when made.

    Parameters
    ----------
    spec
        The environment.
    n_envs
        How many slots: worlds of ``spec.agents`` agents each.
    autoreset_mode
        ``SAME_STEP`` or ``NEXT_STEP``: when a slot that ended begins its next episode.
    max_cycles
        The time limit; ``None`` takes the environment's own, 0 is none.
    initial_states
        ``"random"``: each episode starts from a draw. ``"stored"``: a slot repeats its first start.
    first_slot
        The global number of the first slot: random draws depend on it, and on nothing else of the device.
    copy
        Whether results are fresh arrays. If not, the next step overwrites them.
    """

    spec: EnvSpec
    n_envs: int
    autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP
    max_cycles: int | None = None
    initial_states: str = "random"
    first_slot: int = 0
    copy: bool = True

    def __post_init__(self) -> None:
        check_spec(self.spec)
        n, first = self.n_envs, self.first_slot
        checked_integer("first_slot", first, 0)
        check_slots("the number of agents" if self.spec.agents == 1 else "the number of worlds", n, first)
        if self.autoreset_mode not in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP):
            raise ArgumentError(
                f"a device resets in SAME_STEP or NEXT_STEP mode, not {self.autoreset_mode!r}"
            )
        check_max_cycles(self.max_cycles)
        checked_choice("initial_states", self.initial_states, ("random", "stored"))
        checked_flag("copy", self.copy)
        # A NumPy integer would wrap around where sizes in bytes are computed from it.
        object.__setattr__(self, "n_envs", int(n))
        object.__setattr__(self, "first_slot", int(first))

    @property
    def n_agents(self) -> int:
        """How many agents the slots have together."""
        return self.n_envs * self.spec.agents

    @cached_property
    def limit(self) -> int:
        """The time limit that holds; 0 for none."""
        return int((self.spec.max_cycles if self.max_cycles is None else self.max_cycles) or 0)

    def identity(self) -> dict[str, Any]:
        """Return what a saved state has to agree with, by name."""
        return {
            "environment": self.spec.id,
            "options": dict(self.spec.options),
            GOLDEN: self.spec.behaviour,
            "n_agents": self.n_agents,
            "autoreset_mode": self.autoreset_mode.value,
            "max_cycles": self.limit,
            "initial_states": self.initial_states,
            "first_slot": self.first_slot,
        }


def checked_mask(mask: npt.ArrayLike, n: int) -> npt.NDArray[np.bool_]:
    """Return a reset mask of ``n`` slots as an array; refuse what is none."""
    try:
        array = np.asarray(mask)
    except ValueError:
        raise ArgumentError(f"a reset mask is bool of shape ({n},), not a ragged list") from None
    if array.shape != (n,) or array.dtype != np.bool_:
        raise ArgumentError(f"a reset mask is bool of shape ({n},), not {array.dtype} of shape {array.shape}")
    return array
