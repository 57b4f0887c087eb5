"""What an environment is to the platform: its words, spaces, rewards and golden functions."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import Env, Space
from gymnasium.spaces import Box, Discrete

from pearl_marl.errors import ArgumentError
from pearl_marl.golden import GoldenFunction


@dataclass(frozen=True, slots=True)
class Field:
    """One named piece of a hardware word.

    Parameters
    ----------
    name
        As it appears in reports and waveforms.
    bits
        Width in hardware, 1 to 64. On the host it lives in the narrowest integer that holds it.
    signed
        Whether it is two's complement.
    fraction
        Binary fraction bits: the value delivered is ``word * 2**-fraction``.
    """

    name: str
    bits: int
    signed: bool = False
    fraction: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.bits <= 64:
            raise ArgumentError(f"field {self.name!r} has {self.bits} bits; possible are 1 to 64")

    @property
    def dtype(self) -> np.dtype[Any]:
        """The narrowest NumPy integer that holds the field."""
        width = max(8, 1 << (self.bits - 1).bit_length())
        return np.dtype(f"{'int' if self.signed else 'uint'}{width}")

    @property
    def low(self) -> float:
        """The least value."""
        return -(2.0 ** (self.bits - 1 - self.fraction)) if self.signed else 0.0

    @property
    def high(self) -> float:
        """The greatest value."""
        return ((1 << (self.bits - self.signed)) - 1) * 2.0**-self.fraction


def word_bits(fields: Sequence[Field]) -> int:
    """Return the width in bits of the word made of ``fields`` side by side."""
    return sum(f.bits for f in fields)


class Golden(NamedTuple):
    """The three functions that are an environment's dynamics, as :mod:`pearl_marl.golden` has them written.

    Each takes and returns scalars, in the order in which the spec lists its fields::

        initial(*reset_draws)             -> *state
        step(*state, action, *step_draws) -> *next_state, reward, terminated
        observe(*state)                   -> *observation

    A function of one result returns it bare. Draws are uniform ``u32``;
    ``terminated`` is 0 or 1. Options are constants of the enclosing scope.
    """

    initial: GoldenFunction
    step: GoldenFunction
    observe: GoldenFunction


class Grid(NamedTuple):
    """How a batch of observations falls onto a grid of cells, for heat maps."""

    rows: int
    columns: int
    cell: Callable[[npt.NDArray[Any]], npt.NDArray[np.integer[Any]]]
    """Maps observations of shape ``(n, ...)`` to cell numbers (row-major) of shape ``(n,)``."""


@dataclass(frozen=True, kw_only=True)
class EnvSpec:
    """The whole description of one environment; every device and interface is made from it.

    Parameters
    ----------
    name, version
        ``"CliffWalking"`` and 0 give ``"Pearl/CliffWalking-v0"`` in the registries.
    summary
        One line for the table of environments.
    state, observation
        The fields of the state word and of the observation word, least significant first.
    action
        The field of an action.
    reward
        The field of a reward: a category code if ``rewards`` is a table, the value itself if not.
    rewards
        The reward of each category, or ``None``.
    observation_space, action_space
        One agent's spaces, equal to the oracle's. Observations are delivered in the space's dtype:
        a ``Discrete`` takes one field, a ``Box`` of shape ``(k,)`` takes ``k``.
    golden
        The dynamics.
    reset_draws, step_draws
        How many 32-bit random draws ``golden.initial`` and ``golden.step`` take.
    max_cycles
        Steps after which an episode is truncated; ``None`` for no limit.
    options, configure
        The keyword arguments that this spec was made with, and the function that takes them.
    oracle
        The Gymnasium id of the environment that this one is held against, if it is one of theirs.
    pose
        Puts the oracle's environment, unwrapped, into a slot's state, so that it can render it.
    render_modes, render_fps
        How the oracle can render, as its own metadata say.
    grid
        How observations fall onto a grid, for heat maps.
    """

    name: str
    version: int
    summary: str
    state: tuple[Field, ...]
    action: Field
    observation: tuple[Field, ...]
    reward: Field
    rewards: tuple[float, ...] | None
    observation_space: Space[Any]
    action_space: Discrete
    golden: Golden
    reset_draws: int = 0
    step_draws: int = 0
    max_cycles: int | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    configure: Callable[..., EnvSpec] | None = None
    oracle: str | None = None
    pose: Callable[[Env[Any, Any], tuple[int, ...]], None] | None = None
    render_modes: tuple[str, ...] = ()
    render_fps: int = 4
    grid: Grid | None = None

    def __post_init__(self) -> None:
        space = self.observation_space
        if isinstance(space, Discrete):
            fields_needed = 1
        elif isinstance(space, Box) and len(space.shape) == 1:
            fields_needed = space.shape[0]
        else:
            raise ArgumentError(f"{self.name}: observation space {space} is neither Discrete nor a flat Box")
        if len(self.observation) != fields_needed:
            raise ArgumentError(
                f"{self.name}: observation space {space} takes {fields_needed} fields, "
                f"the spec lists {len(self.observation)}"
            )
        if not isinstance(self.action_space, Discrete) or self.action_space.start != 0:
            raise ArgumentError(f"{self.name}: action space {self.action_space} is not a Discrete from 0")
        if self.action_space.n > 1 << self.action.bits:
            raise ArgumentError(
                f"{self.name}: {self.action_space} does not fit {self.action.bits} action bits"
            )
        if self.rewards is not None and len(self.rewards) > 1 << self.reward.bits:
            raise ArgumentError(
                f"{self.name}: {len(self.rewards)} rewards do not fit {self.reward.bits} reward bits"
            )
        check_max_cycles(self.max_cycles)

    @property
    def id(self) -> str:
        """The name with its version, as in ``"CliffWalking-v0"``."""
        return f"{self.name}-v{self.version}"

    def with_options(self, **options: Any) -> EnvSpec:
        """Return the spec of this environment under the given keyword arguments.

        Raises
        ------
        ArgumentError
            Names the first argument that this environment does not have, and those it has.
        """
        if not options:
            return self
        known = list(inspect.signature(self.configure).parameters) if self.configure else []
        for name in options:
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1)
                has = (
                    f"{self.name} takes {', '.join(known)}" if known else f"{self.name} takes none of its own"
                )
                raise ArgumentError(
                    f"unknown argument {name!r}{f', did you mean {near[0]!r}?' if near else ''} ({has})"
                )
        assert self.configure is not None
        return self.configure(**{**self.options, **options})


def check_max_cycles(value: object) -> None:
    """Refuse a time limit that is no integer of ``0 .. 2**32 - 1``; ``None`` stands for the default."""
    if value is None:
        return
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 0 <= value < 1 << 32:
        raise ArgumentError(f"max_cycles is {value!r}; it must be an integer from 0 (no limit) to 2**32 - 1")
