"""The parts of a port, each compared with the original: what the tests of a package call."""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from pearl_marl.golden import CountingDraws, Draws, as_python_runs_it
from pearl_marl.golden.reals import Real
from pearl_marl.layout import Layout, leaves
from pearl_marl.layout.fields import Field
from pearl_marl.porting.contents import elements
from pearl_marl.porting.originals import Original

SEEDS, STEPS = 40, 100
"""Episodes of the original that a part is compared over, and their steps at most."""

SAMPLES, CHANCES, OFTEN = 100, 60, 0.1
"""Outcomes that are drawn on both sides of a step, how many steps are compared so, and the share of one that
has to be on both."""

STARTS = 400


FRACTION = 16
"""Bits behind the binary point of actions in a ``Box`` where the state has no reals."""


def as_numbers(value: Any) -> Any:
    """Return a number as Python's, or an array of them as lists, such as fields of a state are."""
    return np.asarray(value).tolist()


def like(old: Any, numbers: Any) -> Any:
    """Return fields as what an original keeps in their place: an array, list or number of the same kind."""
    value = np.asarray(numbers)
    if isinstance(old, np.ndarray):
        return value.astype(old.dtype)
    if isinstance(old, (list, tuple)):
        return type(old)(value.tolist())
    return type(old)(value.item())


@dataclasses.dataclass(frozen=True)
class Port:
    """Golden functions, as far as there are any, beside the original that they are written after.

    Each method returns what differs first, as a sentence, or ``None``.
    """

    original: Original
    state: type
    initial: Callable[..., Any]
    step: Callable[..., Any]
    observe: Callable[..., Any]
    read: Callable[[Any], Any]
    pose: Callable[[Any, Any], None]
    rewards: Sequence[float] | None
    reward_fraction: int = 0
    """Bits behind the point of rewards that are words: of a state without reals."""
    view: type | None = None
    tolerance: float = 0.0
    """By how much of itself, or of 1, a real may differ."""

    def wrong_state(self) -> str | None:
        """Compare the ranges of fields with what the original has in them."""
        for where in self._reached():
            numbers = leaves(self.read(self.original.env))
            for field, number in zip(self._layout.fields, numbers, strict=True):
                low, high = field.low, field.high
                if not self._near(min(max(number, low), high), number):
                    return f"{where}: {field.name} is {number}, and its field holds {low:g} to {high:g}"
        return None

    def wrong_pose(self) -> str | None:
        """Put another original into each state that one comes to, and step both."""
        other = self.original.copied()
        other.reset(seed=12345)
        rng = np.random.default_rng(0)
        for where in self._reached(SEEDS // 4):
            words = self._words(self.original)
            pairs = zip(self._layout.fields, words, strict=True)
            self.pose(other.env, self._layout.built(field.value(word) for field, word in pairs))
            again = self._words(other)
            wrong = self._difference(again, words)
            if wrong:
                return f"{where}: posed, the original has other values: {wrong}"
            actions = self.original.actions(rng)
            posed, due = (self._stepped(one, actions, 1) for one in (other, self.original))
            wrong = self._difference(posed, due)
            if wrong:
                return f"{where}: posed, the original goes on otherwise after actions {actions}: {wrong}"
        return None

    def wrong_start(self) -> str | None:
        """Compare the states that episodes begin in."""
        initial = self._python(self.initial)
        rng = np.random.default_rng(0)
        ours = [self._flat(initial(self._draws(rng))) for _ in range(STARTS)]
        theirs = []
        for seed in range(STARTS):
            self.original.reset(seed)
            theirs.append(self._words(self.original))
        if len(set(theirs)) <= STARTS // 10 or len(set(ours)) <= STARTS // 10:
            return self._often(Counter(ours), Counter(theirs), "episodes begin in")
        for field, own, due in zip(self._layout.fields, np.array(ours).T, np.array(theirs).T, strict=True):
            spread = np.hypot(own.std(), due.std()) / np.sqrt(STARTS) + 1e-9
            scale = 2.0**-field.fraction
            if (
                abs(own.mean() - due.mean()) > 6 * spread
                or not 0.7 <= (own.std() + 1e-9) / (due.std() + 1e-9) <= 1.4
            ):
                return (
                    f"{field.name} of a start is {own.mean() * scale:.6g} +- {own.std() * scale:.6g}, "
                    f"the original's {due.mean() * scale:.6g} +- {due.std() * scale:.6g}"
                )
        return None

    def wrong_observation(self) -> str | None:
        """Compare what is observed in each state that the original comes to."""
        observe = self._python(self.observe)
        view = None if self.view is None else Layout(self.view, self._layout.fraction)
        for where in self._reached():
            state = self._state()
            for agent in range(self.original.agents):
                seen = self.original.observations[agent]
                if seen is None:  # it has left
                    continue
                result = observe(state, *[agent][: self.original.agents > 1])
                if view is None:
                    numbers = leaves(result)
                else:
                    pairs = zip(view.fields, view.flat(result), strict=True)
                    numbers = [field.value(word) for field, word in pairs]
                due = elements(seen)
                if len(numbers) != len(due):
                    return f"{where}: observe() returns {len(numbers)} numbers, and the space has {len(due)}"
                for k, (own, right) in enumerate(zip(numbers, due, strict=True)):
                    if not self._near(own, right):
                        what, told = f"element {k} of the observation", self._fields_of(state)
                        return f"{where}: {what} is {own:g}, the original's {right:g} (in {told})"
        return None

    def wrong_step(self) -> str | None:
        """Step from each state that the original comes to, by the same actions."""
        step = self._python(self.step)
        rng = np.random.default_rng(1)
        sampled = 0
        for where in self._reached(leaving=True):
            state, actions = self._state(), self.original.actions(rng)
            each = list(map(self._action, actions))
            given = each if self.original.agents > 1 else each[0]
            counted = CountingDraws(self._layout.fraction)
            own = self._outcome(step(state, given, counted))
            theirs = self._sampled(actions, 1)[0]
            again = self._sampled(actions, 3)
            if counted.count == 0 and all(self._difference(theirs, other) is None for other in again):
                wrong = self._difference(own, theirs)
                if wrong:
                    return f"{where}, action {_short(actions)}: {wrong} (from {self._fields_of(state)})"
            elif sampled < CHANCES:
                sampled += 1
                ours = Counter(self._outcome(step(state, given, self._draws(rng))) for _ in range(SAMPLES))
                wrong = self._often(ours, Counter(self._sampled(actions, SAMPLES)), "a step comes to")
                if wrong:
                    return f"{where}, action {_short(actions)}: {wrong} (from {self._fields_of(state)})"
        return None

    # ---- Both sides as tuples: the words of a state, then rewards, then ends ----

    @functools.cached_property
    def _layout(self) -> Layout:
        return Layout(self.state)

    def _python(self, function: Callable[..., Any]) -> Callable[..., Any]:
        return as_python_runs_it(function, self._layout.fraction is not None)

    def _draws(self, rng: np.random.Generator) -> Draws:
        return Draws((int(word) for word in iter(lambda: rng.integers(1 << 32), None)), self._layout.fraction)

    def _flat(self, state: Any) -> tuple[int, ...]:
        return tuple(map(round, self._layout.flat(state)))

    def _words(self, original: Original) -> tuple[int, ...]:
        """Return the words of the state that an original is in."""
        return self._flat(self.read(original.env))

    def _state(self) -> Any:
        """Return the state that the original is in, as a step takes it: reals are rounded to their fields."""
        return self._layout.built(self._words(self.original))

    def _fields_of(self, state: Any) -> str:
        pairs = zip(self._layout.fields, self._flat(state), strict=True)
        return ", ".join(f"{field.name} {field.value(word):.9g}" for field, word in pairs)

    def _action(self, action: Any) -> Any:
        """Return an action as a step takes it."""
        parts = np.ravel(action).tolist()
        fraction = self._layout.fraction
        if isinstance(self.original.action_space, Box):
            parts = [
                round(part * 2**FRACTION) if fraction is None else Real.of(part, fraction) for part in parts
            ]
        return parts[0] if len(parts) == 1 else tuple(parts)

    def _reached(self, seeds: int = SEEDS, leaving: bool = False) -> Iterator[str]:
        """Say where the original is, at each state that it comes to; with ``leaving`` where it goes on."""
        rng = np.random.default_rng(0)
        for seed in range(seeds):
            self.original.reset(seed)
            yield f"seed {seed}, reset"
            for k, actions in enumerate(islice(self.original.habits(rng, seed), STEPS)):
                outcome = self.original.step(actions)
                if not (leaving and outcome.over):
                    yield f"seed {seed}, step {k + 1}"
                if outcome.over:
                    break

    def _stepped(self, original: Original, actions: list[Any], seed: int) -> tuple[Any, ...]:
        other = original.copied()
        other.reseed(seed)
        outcome = other.step(actions)
        return (*self._words(other), *outcome.rewards, *map(bool, outcome.terminated))

    def _sampled(self, actions: list[Any], count: int) -> list[tuple[Any, ...]]:
        return [self._stepped(self.original, actions, seed) for seed in range(count)]

    def _outcome(self, result: Any) -> tuple[Any, ...]:
        after, rewards, ends = result
        agents = self.original.agents
        rewards, ends = ([rewards], [ends]) if agents == 1 else (rewards, ends)
        if self.rewards is None:
            worth = [float(reward) * 2.0**-self.reward_fraction for reward in rewards]
        else:
            worth = [float(self.rewards[int(category)]) for category in rewards]
        return (*self._flat(after), *worth, *map(bool, ends))

    def _columns(self) -> list[Field]:
        agents = range(self.original.agents)
        one = self.original.agents == 1
        rewards = [Field("reward" if one else f"reward of agent {k}", 64) for k in agents]
        ends = [Field("terminated" if one else f"terminated of agent {k}", 1) for k in agents]
        return [*self._layout.fields, *rewards, *ends]

    def _near(self, own: float, due: float) -> bool:
        return abs(own - due) <= self.tolerance * max(1.0, abs(due))

    def _difference(self, own: Sequence[Any], due: Sequence[Any]) -> str | None:
        """Return what differs first of what is after a step, or of a state alone."""
        for field, a, b in zip(self._columns()[: len(own)], own, due, strict=True):
            scale = 2.0**-field.fraction if field.fraction else 1
            if not self._near(a * scale, b * scale):
                return f"{field.name} is {a * scale}, the original's {b * scale}"
        return None

    def _often(self, ours: Counter[Any], theirs: Counter[Any], what: str) -> str | None:
        """Return which outcome happens often on one side, and never on the other or much less often."""

        def close(one: Sequence[Any], two: Sequence[Any]) -> bool:
            return self._difference(one, two) is None

        unlike = first_unlike(ours, theirs, close if self.tolerance else None)
        if unlike is None:
            return None
        outcome, own, due = unlike
        pairs = zip(self._columns()[: len(outcome)], outcome, strict=True)
        names = ", ".join(f"{field.name} {value}" for field, value in pairs)
        return f"{what} ({names}) with a share of {own:.3f}, the original's is {due:.3f}"


def first_unlike(
    ours: Counter[Any], theirs: Counter[Any], close: Callable[[Any, Any], bool] | None = None
) -> tuple[Any, float, float] | None:
    """Return an outcome that is often on one side, and never on the other or much less, and its shares.

    Without ``close``, which tells what counts as the same, outcomes are equal.
    """

    def share(counts: Counter[Any], outcome: Any) -> float:
        if close is None:
            return counts[outcome] / counts.total()
        return sum(count for other, count in counts.items() if close(other, outcome)) / counts.total()

    for outcome in {**theirs, **ours}:
        own, due = share(ours, outcome), share(theirs, outcome)
        both = (own + due) / 2
        chance = np.sqrt(both * (1 - both) * (1 / ours.total() + 1 / theirs.total()))
        if (max(own, due) >= OFTEN and min(own, due) == 0) or abs(own - due) > 6 * chance:
            return outcome, own, due
    return None


def _short(actions: list[Any]) -> str:
    return str(actions[0] if len(actions) == 1 else actions)
