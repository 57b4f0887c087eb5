"""Ranges of the trainers' settings, beside their defaults, and a check of the memory that they take."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import torch

from pearl_marl.batch.results import memory_of_machine
from pearl_marl.checks import MANY, NumberRange
from pearl_marl.devices import Cuda
from pearl_marl.errors import ArgumentError
from pearl_marl.policies.memory import MEMORY
from pearl_marl.policies.network import SHARING
from pearl_marl.spec import MAX_SLOTS, EnvSpec
from pearl_marl.training.agents import TEAM, observed_spec

SEEDS = 2**63 - 1
"""The largest seed that PyTorch takes."""

WIDEST = 2**14
"""The widest layer of a network: its weights take a gigabyte."""


def _setting(default: Any, values: NumberRange | OneOf, formerly: str) -> Any:
    return field(default=default, metadata={"range": values, "formerly": formerly})


def count(default: int, least: int = 1, most: int = MANY, formerly: str = "") -> Any:
    """Return a setting that counts something; ``formerly`` is its name before it was renamed."""
    return _setting(default, NumberRange(least=least, most=most, whole=True), formerly)


def number(default: float, most: float = math.inf, above: bool = False, formerly: str = "") -> Any:
    """Return a setting that is a finite number from 0, or above 0 only, if ``above``."""
    return _setting(
        default, NumberRange(above=0, most=most) if above else NumberRange(least=0, most=most), formerly
    )


@dataclass(frozen=True)
class OneOf:
    """One of some words."""

    words: tuple[str, ...]

    def __contains__(self, value: Any) -> bool:
        return isinstance(value, str) and value in self.words

    def __str__(self) -> str:
        return f"one of {', '.join(self.words)}"


def choice(*words: str) -> Any:
    """Return a setting that is one of some words, by default the first."""
    return _setting(words[0], OneOf(words), "")


@dataclass(frozen=True, kw_only=True)
class TrainerSettings:
    """A dataclass of :func:`count`, :func:`number` and :func:`choice`, each within its range."""

    seed: int = count(0, least=0, most=SEEDS)  # of everything random

    @classmethod
    def range(cls, name: str) -> NumberRange | OneOf:
        """Return the values that a setting may have."""
        (found,) = (f.metadata["range"] for f in fields(cls) if f.name == name)
        return found  # type: ignore[no-any-return]

    @classmethod
    def renamed(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return settings by the names that they have now; earlier names warn."""
        successors, result = cls.successors(), {}
        for said, value in values.items():
            if (name := successors.get(said, said)) in result:
                raise ArgumentError(f"setting {name!r} is given twice, also as {said!r}: give it once")
            if name != said:
                warnings.warn(f"the setting {said!r} is now {name!r}", DeprecationWarning, stacklevel=3)
            result[name] = value
        return result

    @classmethod
    def successors(cls) -> dict[str, str]:
        """Return the names of renamed settings, by those that they had before."""
        named = ((f.metadata["formerly"], f.name) for f in fields(cls))
        return {old: new for old, new in named if old}

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the default of each setting."""
        return {f.name: f.default for f in fields(cls)}

    def __post_init__(self) -> None:
        for setting in fields(self):
            value, possible = getattr(self, setting.name), setting.metadata["range"]
            if value not in possible:
                raise ArgumentError(f"setting {setting.name!r} is {value!r}; it must be {possible}")


@dataclass(frozen=True, kw_only=True)
class NetworkSettings(TrainerSettings):
    """Settings of an algorithm that learns networks."""

    reward_scale: float = number(1.0, above=True)  # factor of rewards, before anything else
    width: int = count(64, most=WIDEST)  # of the networks' layers
    sharing: str = choice(*SHARING)  # of networks, among the agents of a world
    rewards: str = choice(*TEAM)  # an agent's own, or the mean or sum of its world's


@dataclass(frozen=True, kw_only=True)
class BlockSettings(NetworkSettings):
    """Settings of an algorithm that learns from rollouts.

    Agents are in ``blocks``, which the policy is given one at a time, each with random numbers of its own.
    The result depends on the number of blocks, and not on the number of workers that share them.
    """

    n_agents: int = count(1024, most=MAX_SLOTS)  # that gather experience
    rollout_length: int = count(32)  # steps of each between updates
    iterations: int = count(60)  # updates in all
    learning_rate: float = number(3e-3, most=1, above=True)  # of Adam, at first; falls to 0 evenly
    memory: str = choice(*MEMORY)  # of policies
    chunk_length: int = count(16)  # steps that gradients go back through, with a memory
    blocks: int = count(1, most=MAX_SLOTS)  # see above

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.memory != "none" and self.rollout_length % self.chunk_length:
            raise ArgumentError(
                f"setting 'chunk_length' is {self.chunk_length}; with a memory it must divide "
                f"rollout_length, {self.rollout_length}"
            )
        if self.blocks > self.n_agents:
            raise ArgumentError(
                f"setting 'blocks' is {self.blocks}; it must be 1 to {self.n_agents}, the number of agents"
            )


class MemoryNeed(NamedTuple):
    """The memory that a run takes at least, and the settings that it grows with."""

    size: int  # in bytes
    what: str
    on_gpu: bool
    lasting: bool  # whether the run has it between iterations, too

    def check(self, runs: int = 1) -> None:
        """Refuse as many runs at a time as take more memory than there is."""
        there, where = memory_of_machine(), "this machine"
        if self.on_gpu:
            there, where = torch.cuda.get_device_properties(0).total_memory, "the GPU"
        if runs * self.size > there:
            seeds = f", {runs} seeds at a time," if runs > 1 else ""
            raise ArgumentError(
                f"training on {self.what}{seeds} takes at least {runs * self.size / 2**30:,.1f} GiB of "
                f"memory, and {where} has {there / 2**30:,.1f} GiB: make one of these settings smaller"
            )


def check_memory(
    spec: EnvSpec,
    settings: Any,
    device: Any,
    names: Sequence[str],
    observations: int,
    others: int,
    lasting: bool = True,
) -> MemoryNeed:
    """Return what memory a run needs; refuse one that takes more than there is, before any is taken.

    Parameters
    ----------
    spec, settings, device
        The run's. With the device ``"cuda"``, the samples are on the GPU.
    names
        The settings that the memory grows with.
    observations, others
        Observations that the run holds at least, and bytes of anything else.
    lasting
        Whether it holds them between iterations, too.

    Raises
    ------
    ArgumentError
        There is less.
    """
    observed = observed_spec(spec, device)
    size = observations * math.prod(observed.observation_shape) * observed.observation_dtype.itemsize + others
    what = f"{spec.name} with {', '.join(f'{name}={getattr(settings, name)}' for name in names)}"
    on_gpu = device == Cuda.name and torch.cuda.is_available()
    need = MemoryNeed(size, what, on_gpu, lasting)
    need.check()
    return need
