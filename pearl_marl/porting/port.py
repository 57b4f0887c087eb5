"""The parts of a port, each compared with the original: what the tests of a package call."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from pearl_marl.fields import Field
from pearl_marl.golden import CountingDraws, Draws, as_python_runs_it
from pearl_marl.layout import Layout, leaves
from pearl_marl.porting.finite import elements
from pearl_marl.porting.originals import Original

SEEDS, STEPS = 40, 100
"""Episodes of the original that a part is compared over, and their steps at most."""

SAMPLES, CHANCES, OFTEN = 100, 60, 0.1
"""Outcomes that are drawn on both sides of a step, how many steps are compared so, and the share of one that
has to be on both."""

STARTS = 400


def as_words(value: Any, fraction: int = 0) -> Any:
    """Return a number as a word, or an array of them as lists of words, with bits behind the binary point."""
    return np.rint(np.ldexp(np.asarray(value, float), fraction)).astype(np.int64).tolist()


def like(old: Any, words: Any, fraction: int = 0) -> Any:
    """Return words as what an original keeps in their place: an array, list or number of the same kind."""
    value = np.ldexp(np.asarray(words, float), -fraction) if fraction else np.asarray(words)
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
    pose: Callable[[Any, tuple[int, ...]], None]
    rewards: Sequence[float] | None
    reward_fraction: int = 0
    view: type | None = None
    tolerance: float = 0.0
    """By how much of itself, or of 1, a real may differ."""

    def wrong_state(self) -> str | None:
        """Compare the ranges of fields with what the original has in them."""
        for where, state in self._reached():
            for field, word in zip(self._layout.fields, self._flat(state), strict=True):
                low, high = field.range
                if not low <= word <= high:
                    return f"{where}: {field.name} is {word}, and its field holds {low} to {high}"
        return None

    def wrong_pose(self) -> str | None:
        """Put another original into each state that one comes to, and step both."""
        other = self.original.copied()
        other.reset(seed=12345)
        rng = np.random.default_rng(0)
        for where, state in self._reached(SEEDS // 4):
            words = tuple(self._flat(state))
            self.pose(other.env, words)
            again = self._flat(self.read(other.env))
            wrong = self._first_difference(words, again)
            if wrong:
                return f"{where}: posed, the original has other values: {wrong}"
            one, two = self.original.copied(), other.copied()
            one.reseed(1)
            two.reseed(1)
            actions = self.original.actions(rng)
            first, second = one.step(actions), two.step(actions)
            wrong = self._first_difference(self._flat(self.read(one.env)), self._flat(self.read(two.env)))
            if wrong is None and (first.rewards, first.terminated) != (second.rewards, second.terminated):
                wrong = (
                    f"reward {first.rewards} and {second.rewards}, "
                    f"terminated {first.terminated} and {second.terminated}"
                )
            if wrong:
                return f"{where}: posed, the original goes on otherwise after actions {actions}: {wrong}"
        return None

    def wrong_start(self) -> str | None:
        """Compare the states that episodes begin in."""
        initial = as_python_runs_it(self.initial)
        rng = np.random.default_rng(0)
        ours = [tuple(self._flat(initial(_draws(rng)))) for _ in range(STARTS)]
        theirs = []
        for seed in range(STARTS):
            self.original.reset(seed)
            theirs.append(tuple(self._flat(self.read(self.original.env))))
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
        observe = as_python_runs_it(self.observe)
        fields = Layout(self.view).fields if self.view else ()
        for where, state in self._reached():
            for agent in range(self.original.agents):
                seen = self.original.seen[agent]
                if seen is None:  # it has left
                    continue
                words = leaves(observe(state, *[agent][: self.original.agents > 1]))
                due = elements(self.original.observation_space, seen)
                if len(words) != len(due):
                    return f"{where}: observe() returns {len(words)} words, and the space has {len(due)}"
                scales = [f.fraction for f in fields] or [0] * len(due)
                for k, (word, fraction, right) in enumerate(zip(words, scales, due, strict=True)):
                    own = word * 2.0**-fraction
                    if not self._near(own, right):
                        what = f"element {k} of the observation"
                        return f"{where}: {what} is {own:g}, the original's {right:g} ({state})"
        return None

    def wrong_step(self) -> str | None:
        """Step from each state that the original comes to, by the same actions."""
        step = as_python_runs_it(self.step)
        rng = np.random.default_rng(1)
        sampled = 0
        for where, state in self._reached(leaving=True):
            actions = self.original.actions(rng)
            given = actions if self.original.agents > 1 else actions[0]
            given = [int(a) for a in given] if isinstance(given, list) else given
            counted = CountingDraws()
            own = self._outcome(step(state, given, counted))
            theirs = self._sampled(actions, 1)[0]
            again = self._sampled(actions, 3)
            if counted.count == 0 and all(self._same(theirs, other) for other in again):
                wrong = self._difference(own, theirs)
                if wrong:
                    return f"{where}, action {_short(actions)}: {wrong} (from {state})"
            elif sampled < CHANCES:
                sampled += 1
                ours = Counter(self._outcome(step(state, given, _draws(rng))) for _ in range(SAMPLES))
                wrong = self._often(ours, Counter(self._sampled(actions, SAMPLES)), "a step comes to")
                if wrong:
                    return f"{where}, action {_short(actions)}: {wrong} (from {state})"
        return None

    # ---- Both sides as tuples: the words of a state, then rewards, then ends ----

    @property
    def _layout(self) -> Layout:
        return Layout(self.state)

    def _flat(self, state: Any) -> list[int]:
        return [int(word) for word in self._layout.flat(state)]

    def _reached(self, seeds: int = SEEDS, leaving: bool = False) -> Iterator[tuple[str, Any]]:
        """Yield states of the original, which is in them, as ours; with ``leaving`` only where it goes on."""
        rng = np.random.default_rng(0)
        for seed in range(seeds):
            self.original.reset(seed)
            yield f"seed {seed}, reset", self.read(self.original.env)
            for k in range(STEPS):
                outcome = self.original.step(self.original.actions(rng))
                if not (leaving and outcome.over):
                    yield f"seed {seed}, step {k + 1}", self.read(self.original.env)
                if outcome.over:
                    break

    def _sampled(self, actions: list[Any], count: int) -> list[tuple[Any, ...]]:
        results = []
        for seed in range(count):
            other = self.original.copied()
            other.reseed(seed)
            outcome = other.step(actions)
            words = self._flat(self.read(other.env))
            results.append((*words, *outcome.rewards, *map(bool, outcome.terminated)))
        return results

    def _outcome(self, result: Any) -> tuple[Any, ...]:
        after, rewards, ends = result
        agents = self.original.agents
        rewards, ends = ([rewards], [ends]) if agents == 1 else (rewards, ends)
        if self.rewards is None:
            worth = [reward * 2.0**-self.reward_fraction for reward in rewards]
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
        for field, a, b in zip(self._columns(), own, due, strict=True):
            scale = 2.0**-field.fraction if field.fraction else 1
            if not self._near(a * scale, b * scale):
                return f"{field.name} is {a * scale}, the original's {b * scale}"
        return None

    def _first_difference(self, one: Sequence[int], two: Sequence[int]) -> str | None:
        for field, a, b in zip(self._layout.fields, one, two, strict=True):
            if not self._near(a * 2.0**-field.fraction, b * 2.0**-field.fraction):
                return f"{field.name} is {b}, and was {a}"
        return None

    def _same(self, one: Sequence[Any], two: Sequence[Any]) -> bool:
        return self._difference(one, two) is None

    def _often(self, ours: Counter[Any], theirs: Counter[Any], what: str) -> str | None:
        """Return which outcome happens often on one side, and never on the other or much less often."""
        n, m = ours.total(), theirs.total()
        for outcome in {**theirs, **ours}:
            own, due = ours[outcome] / n, theirs[outcome] / m
            if self.tolerance:
                own = sum(c for o, c in ours.items() if self._close(o, outcome)) / n
                due = sum(c for o, c in theirs.items() if self._close(o, outcome)) / m
            both = (own + due) / 2
            chance = np.sqrt(both * (1 - both) * (1 / n + 1 / m))
            if (max(own, due) >= OFTEN and min(own, due) == 0) or abs(own - due) > 6 * chance:
                fields = self._columns()[: len(outcome)]  # of a start, those of the state
                pairs = zip(fields, outcome, strict=True)
                names = ", ".join(f"{field.name} {value}" for field, value in pairs)
                return f"{what} ({names}) with a share of {own:.3f}, the original's is {due:.3f}"
        return None

    def _close(self, one: Sequence[Any], two: Sequence[Any]) -> bool:
        fields = self._columns()[: len(one)]
        return all(
            self._near(a * 2.0**-f.fraction, b * 2.0**-f.fraction)
            for f, a, b in zip(fields, one, two, strict=True)
        )


def _draws(rng: np.random.Generator) -> Draws:
    return Draws(int(word) for word in iter(lambda: rng.integers(1 << 32), None))


def _short(actions: list[Any]) -> str:
    return str(actions[0] if len(actions) == 1 else actions)
