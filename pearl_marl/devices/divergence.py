"""Comparing two devices' words bit for bit, and saying in words where they first differ."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.batch.rollout import Rollout
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.batch.step import BatchStep, Observed
from pearl_marl.spec import EnvSpec


class Words(NamedTuple):
    """A word, or an array of them, of every slot from both devices, and ``where`` it has a meaning."""

    field: str
    device: Array
    reference: Array
    where: Array | None = None


class Difference(NamedTuple):
    """One word of one slot that is not the same."""

    field: str
    device_value: Any
    reference_value: Any


@dataclass(frozen=True, kw_only=True)
class Divergence:
    """Where two devices part: the first slot (by number) of the first step in which any word differs."""

    environment: str
    device: str
    reference: str
    call: str
    """``"step"``, or the call that is none: ``"reset"``, ``"restore"``, ``"snapshot"`` or ``"rollout"``."""
    step: int
    """The tick: steps since seeding, from 0. A full reset without a seed counts as one."""
    slot: int
    """Its global number."""
    slots: int
    """How many slots differ in this step."""
    differences: tuple[Difference, ...]
    """Every word of the slot that differs, results before state."""
    state_before: dict[str, int] | None
    """The slot's state words by name, with ``elapsed`` and ``ended``; ``None`` before the first reset."""
    action: float | list[float] | None
    """What the slot was told to do, a list of several agents; ``None`` where the call is no step."""

    @property
    def field(self) -> str:
        """The first word that differs."""
        return self.differences[0].field

    def __str__(self) -> str:
        at = f"step {self.step}" if self.call == "step" else f"{self.call}() before step {self.step}"
        first, *others = (f"{d.field} is {d.device_value}, not {d.reference_value}" for d in self.differences)
        lines = [
            f"{self.environment} on {self.device} differs from {self.reference} at {at}, slot {self.slot}"
        ]
        lines[0] += f": {first}"
        if others:
            lines.append(f"  also there: {'; '.join(others)}")
        if self.state_before is not None:
            before = ", ".join(f"{name} {value}" for name, value in self.state_before.items())
            lines.append(f"  before: {before}" + ("" if self.action is None else f"; action {self.action}"))
        if self.slots > 1:
            lines.append(f"  {self.slots:,} slots differ in this step")
        return "\n".join(lines)

    def as_json(self) -> dict[str, Any]:
        """Return it as a dict of what JSON has types for."""
        differences = [difference._asdict() for difference in self.differences]
        return {**asdict(self), "field": self.field, "differences": differences}

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> Self:
        """Return what :meth:`as_json` made a dict of."""
        differences = tuple(Difference(**difference) for difference in value["differences"])
        fields = {name: word for name, word in value.items() if name not in ("field", "differences")}
        return cls(differences=differences, **fields)


def result_words(spec: EnvSpec, device: BatchStep, reference: BatchStep) -> Iterator[Words]:
    """Yield the words of a step's results; final observations where the reference's agents ended."""
    yield from seen_words(spec, device.observed, reference.observed)
    for name in ("rewards", "terminations", "truncations"):
        yield from _by_world(spec, Words(name, getattr(device, name), getattr(reference, name)))
    yield from _observation(spec, "final_obs", device.final_obs, reference.final_obs, reference.ended)


def seen_words(spec: EnvSpec, device: Observed, reference: Observed) -> Iterator[Words]:
    """Yield the words of what agents see, and in worlds of several which are in an episode."""
    yield from _observation(spec, "obs", device.obs, reference.obs)
    if reference.action_masks is not None:
        assert device.action_masks is not None
        yield from _by_world(spec, Words("action_masks", device.action_masks, reference.action_masks))
    if spec.agents > 1:
        yield from _by_world(spec, Words("in_episode", device.in_episode, reference.in_episode))


def rollout_words(n: int, device: Rollout, reference: Rollout) -> Iterator[Words]:
    """Yield the sums of a rollout over all agents, as words of the first of ``n`` slots."""
    for name in ("ended", "truncated", "lengths", "returns"):
        ours, theirs = (np.zeros(n, np.float64 if name == "returns" else np.int64) for _ in range(2))
        ours[0], theirs[0] = (np.sum(getattr(rollout, name)) for rollout in (device, reference))
        yield Words(f"sum of {name}", ours, theirs)


def _observation(
    spec: EnvSpec, name: str, device: Array, reference: Array, where: Array | None = None
) -> Iterator[Words]:
    """Yield the words of an array of observations: one, or as many as the observation has fields."""
    if device.shape != reference.shape or reference.ndim == 1 or spec.unpack is not None:
        yield from _by_world(spec, Words(name, device, reference, where))
        return
    device, reference = (array.reshape(len(array), -1) for array in (device, reference))
    for k, f in enumerate(spec.observation):
        yield from _by_world(spec, Words(f"{name}.{f.name}", device[:, k], reference[:, k], where))


def _by_world(spec: EnvSpec, words: Words) -> Iterator[Words]:
    """Yield words that have a row an agent with a row a world: those of one agent after the other."""
    if spec.agents == 1 or words.device.shape != words.reference.shape:
        yield words
        return
    for k in range(spec.agents):
        where = None if words.where is None else words.where[k :: spec.agents]
        mine, other = words.device[k :: spec.agents], words.reference[k :: spec.agents]
        yield Words(f"agent {k}: {words.field}", mine, other, where)


def state_words(spec: EnvSpec, n: int, device: SavedState, reference: SavedState) -> Iterator[Words]:
    """Yield the words of two saved states: state fields, counters and, if there are any, stored starts."""
    ours, theirs = (SlotMemory(spec, n, saved.memory) for saved in (device, reference))
    names = [*(f"state.{f.name}" for f in spec.state), "elapsed", "ended"]
    yield from map(Words, names, ours.columns.values(), theirs.columns.values())
    if device.stored.size or reference.stored.size:
        ours, theirs = (SlotMemory(spec, n, saved.stored) for saved in (device, reference))
        yield from map(Words, (f"stored {name}" for name in names), ours.state, theirs.state)


def state_of(spec: EnvSpec, n: int, saved: SavedState, i: int) -> dict[str, int]:
    """Return row ``i`` of a saved state by name, as words."""
    return {name: int(column[i]) for name, column in SlotMemory(spec, n, saved.memory).columns.items()}


class WordComparison:
    """Compares words, and keeps those that differ; ``words`` counts how many were compared."""

    def __init__(self) -> None:
        self.words = 0
        self._differing: list[tuple[Words, Array]] = []

    def __bool__(self) -> bool:
        """Whether any word differed."""
        return bool(self._differing)

    def add(self, all_words: Iterable[Words]) -> None:
        """Compare every slot's words."""
        for words in all_words:
            self._add(*words)

    def _add(self, field: str, ours: Array, theirs: Array, where: Array | None) -> None:
        if ours.dtype != theirs.dtype or ours.shape != theirs.shape:
            unequal = np.arange(len(theirs)) == 0
            ours, theirs = (np.array([f"{a.dtype} of shape {a.shape}"]) for a in (ours, theirs))
            field += " array"
        else:
            # As integers: two floats may be equal and yet have other bits, or have the same and be unequal.
            bits = f"u{theirs.dtype.itemsize}"
            unequal = ours.view(bits) != theirs.view(bits)
            if where is not None:
                unequal &= where.reshape(-1, *(1,) * (unequal.ndim - 1))
        slots = len(unequal) if where is None else int(np.count_nonzero(where))
        self.words += slots * math.prod(unequal.shape[1:])
        for element in np.argwhere(unequal.any(0)).tolist():
            place = f"[{', '.join(map(str, element))}]" if element else ""
            at: Any = (slice(None), *element)
            # Copies: a device may write its next results where these are.
            apart = Words(f"{field}{place}", ours[at].copy(), theirs[at].copy())
            self._differing.append((apart, unequal[at]))

    def first(self) -> tuple[int, int, tuple[Difference, ...]]:
        """Return the first slot that differs, how many do, and what differs there."""
        anywhere = np.logical_or.reduce([unequal for _, unequal in self._differing])
        slot = int(anywhere.argmax())
        differences = tuple(
            Difference(words.field, *_values(words.device[slot], words.reference[slot]))
            for words, unequal in self._differing
            if unequal[slot]
        )
        return slot, int(np.count_nonzero(anywhere)), differences


def _values(ours: np.generic, theirs: np.generic) -> tuple[Any, Any]:
    """Return two words as Python values, or as hexadecimal where those would look the same."""
    if repr(ours) == repr(theirs):  # a bool that is neither 0 nor 1, or two sorts of NaN
        return f"0x{ours.tobytes()[::-1].hex()}", f"0x{theirs.tobytes()[::-1].hex()}"
    return ours.item(), theirs.item()
