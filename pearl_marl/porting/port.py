"""The parts of a port, each compared with the original: what the tests of a package call."""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any

import numpy as np

from pearl_marl.golden import Draws, as_python_runs_it
from pearl_marl.layout import Layout, leaves
from pearl_marl.porting.contents import elements
from pearl_marl.porting.oracle import (
    DifferenceError,
    Outcome,
    Rules,
    compare,
    first_unlike,
    joined,
    named,
    unlike_outcomes,
)
from pearl_marl.porting.originals import Original
from pearl_marl.spec import EnvSpec

SEEDS, STEPS = 40, 100
"""Episodes of the original that a part is compared over, and their steps at most."""

SAMPLES, CHANCES = 100, 60
"""Outcomes that are drawn on both sides of a step, and how many steps are compared so."""

REPEATS = 4
"""How often the original takes a step that has no draws with us."""

STARTS = 400


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

    Each method returns what differs first, as a sentence, or ``None``. States, starts and observations are
    compared before there is a spec; steps by the oracle contract: :func:`~pearl_marl.porting.oracle.compare`.
    """

    original: Original
    state: type
    initial: Callable[..., Any]
    observe: Callable[..., Any]
    read: Callable[[Any], Any]
    pose: Callable[[Any, Any], None]
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
            values = self._values(self._words(self.original))
            self.pose(other.env, self._layout.built(values))
            wrong = self._difference(self._values(self._words(other)), values)
            if wrong:
                return f"{where}: posed, the original has other values: {wrong}"
            actions = self.original.actions(rng)
            posed, due = (self._stepped(one, actions, 1) for one in (other, self.original))
            wrong = self._difference(_flat(posed), _flat(due))
            if wrong:
                return f"{where}: posed, the original goes on otherwise after actions {actions}: {wrong}"
        return None

    def wrong_start(self) -> str | None:
        """Compare the states that episodes begin in."""
        initial = self._python(self.initial)
        rng = np.random.default_rng(0)
        ours = [self._values(self._flat(initial(self._draws(rng)))) for _ in range(STARTS)]
        theirs = []
        for seed in range(STARTS):
            self.original.reset(seed)
            theirs.append(self._values(self._words(self.original)))
        if len(set(theirs)) <= STARTS // 10 or len(set(ours)) <= STARTS // 10:
            return self._often(Counter(ours), Counter(theirs))
        for field, own, due in zip(self._layout.fields, np.array(ours).T, np.array(theirs).T, strict=True):
            spread = np.hypot(own.std(), due.std()) / np.sqrt(STARTS) + 1e-9
            if (
                abs(own.mean() - due.mean()) > 6 * spread
                or not 0.7 <= (own.std() + 1e-9) / (due.std() + 1e-9) <= 1.4
            ):
                return (
                    f"{field.name} of a start is {own.mean():.6g} +- {own.std():.6g}, "
                    f"the original's {due.mean():.6g} +- {due.std():.6g}"
                )
        return None

    def wrong_observation(self) -> str | None:
        """Compare what is observed in each state that the original comes to."""
        observe = self._python(self.observe)
        view = None if self.view is None else Layout(self.view, self._layout.fraction)
        for where in self._reached():
            words = self._words(self.original)
            state = self._layout.built(words)  # as a step takes it: reals are rounded to their fields
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
                        told = self._by_name(self._values(words), ".9g")
                        return (
                            f"{where}: element {k} of the observation is {own:g}, the original's {right:g} "
                            f"(in {told})"
                        )
        return None

    def wrong_step(self, spec: EnvSpec) -> str | None:
        """Compare steps from states that the original comes to, by the same actions.

        ``spec`` is that of the environment, which can be made once all parts are written.
        """
        rng = np.random.default_rng(1)
        times, most = (SAMPLES, CHANCES) if spec.step_draws else (REPEATS, None)
        words, actions, outcomes = [], [], []
        for _ in islice(self._reached(leaving=True), most):
            chosen = self.original.actions(rng)
            words.append(self._words(self.original))
            actions.append(chosen)
            outcomes.append([self._stepped(self.original, chosen, seed) for seed in range(times)])
        if spec.step_draws:
            steps = zip(words, actions, map(joined, outcomes), strict=True)
            found = (unlike_outcomes(spec, *step, rng, self.tolerance) for step in steps)
            return next(filter(None, found), None)
        for state, chosen, (first, *again) in zip(words, actions, outcomes, strict=True):
            if any(self._difference(_flat(other), _flat(first)) for other in again):
                return (
                    f"from {named(spec, state)} by action {np.ravel(chosen).tolist()}: the original comes to "
                    "different states at random, and step() draws nothing"
                )
        moves = compare(
            spec,
            Rules(lambda *given: joined([first for first, *_ in outcomes])),
            len(words),
            state=list(np.array(words).T),
            actions=np.array(actions),
            tolerance=self.tolerance,
        )
        try:
            next(moves)
        except DifferenceError as error:
            return str(error)
        return None

    # ---- Both sides as tuples: the values of a state's fields, then rewards, then ends ----

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

    def _values(self, words: Sequence[int]) -> tuple[float, ...]:
        """Return what the words of a state stand for."""
        return tuple(field.value(word) for field, word in zip(self._layout.fields, words, strict=True))

    def _by_name(self, values: Sequence[float], form: str) -> str:
        """Return the values of a state's fields with their names."""
        pairs = zip(self._layout.fields, values, strict=True)
        return ", ".join(f"{field.name} {value:{form}}" for field, value in pairs)

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

    def _stepped(self, original: Original, actions: list[Any], seed: int) -> Outcome:
        """Return what a copy shows after a step by a seed, and its state; not what it observes."""
        other = original.copied()
        other.reseed(seed)
        outcome, names = other.step(actions), (field.name for field in self._layout.fields)
        state = dict(zip(names, self._values(self._words(other)), strict=True))
        return outcome._replace(observations=None, truncated=None, state=state)

    @property
    def _names(self) -> list[str]:
        agents = range(self.original.agents)
        one = self.original.agents == 1
        rewards = ["reward" if one else f"reward of agent {k}" for k in agents]
        ends = ["terminated" if one else f"terminated of agent {k}" for k in agents]
        return [*(field.name for field in self._layout.fields), *rewards, *ends]

    def _near(self, own: float, due: float) -> bool:
        return abs(own - due) <= self.tolerance * max(1.0, abs(due))

    def _difference(self, own: Sequence[Any], due: Sequence[Any]) -> str | None:
        """Return what differs first of what is after a step, or of a state alone."""
        for name, a, b in zip(self._names[: len(own)], own, due, strict=True):
            if not self._near(a, b):
                return f"{name} is {a}, the original's {b}"
        return None

    def _often(self, ours: Counter[Any], theirs: Counter[Any]) -> str | None:
        """Return which start is often on one side, and never on the other or much less often."""

        def close(one: Sequence[Any], two: Sequence[Any]) -> bool:
            return self._difference(one, two) is None

        unlike = first_unlike(ours, theirs, close if self.tolerance else None)
        if unlike is None:
            return None
        values, own, due = unlike
        start = self._by_name(values, "")
        return f"episodes begin in ({start}) with a share of {own:.3f}, the original's is {due:.3f}"


def _flat(outcome: Outcome) -> tuple[Any, ...]:
    return (*(outcome.state or {}).values(), *outcome.rewards, *outcome.terminated)
