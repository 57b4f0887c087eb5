"""An environment beside the original that it follows: ``pearl verify NAME --against package:Class``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.batch.actions import encode, room_for_words
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import reference
from pearl_marl.porting.contents import elements, leaves_of
from pearl_marl.porting.originals import Original
from pearl_marl.porting.port import like
from pearl_marl.spec import EnvSpec

EPISODES, LONGEST = 100, 1000
"""Of random policies, whose returns are compared; and their steps at most."""

SAMPLES, OFTEN = 100, 0.1
"""Outcomes of a step with draws, and the share of one that has to be on both sides."""

MOST_SAMPLED = 300
"""Different states and actions whose outcomes are compared so."""


class Errors(NamedTuple):
    """By how much the elements of observation and reward differ after one step."""

    name: str
    states: str
    most: float
    mean: float


class Comparison(NamedTuple):
    """What there is to say of the two."""

    how: str
    """What was compared, as a sentence."""
    steps: int
    difference: str | None
    """The first one, for integers."""
    errors: list[Errors]
    """Those of reals."""
    returns: tuple[tuple[float, float], tuple[float, float]]
    """Mean and standard deviation of ours and of the original's."""
    lengths: tuple[float, float]
    """The mean steps of an episode of each."""

    @property
    def equal(self) -> bool:
        """Whether nothing was found to differ that has to be equal."""
        return self.difference is None


class _Ours:
    """An environment, one slot of it, by its golden functions as Python runs them."""

    def __init__(self, spec: EnvSpec) -> None:
        self.spec = spec
        golden = spec.positional
        self._initial, self._step = reference(golden.initial), reference(golden.step)
        self._observe = [reference(golden.observe, *agent) for agent in spec.views]
        self.state: tuple[int, ...] = ()

    def reset(self, rng: np.random.Generator) -> None:
        self.state = tuple(map(int, self._initial(*_draws(rng, self.spec.reset_draws))))

    def step(self, words: list[int], rng: np.random.Generator) -> tuple[list[float], list[bool]]:
        """Step by actions as words; return rewards and ends."""
        spec, n = self.spec, len(self.spec.state)
        result = [int(w) for w in self._step(*self.state, *words, *_draws(rng, spec.step_draws))]
        self.state = tuple(result[:n])
        rewards = result[n : n + spec.agents]
        worth = [spec.rewards[r] if spec.rewards is not None else spec.reward.value(r) for r in rewards]
        return list(map(float, worth)), list(map(bool, result[n + spec.agents :]))

    def observation(self, agent: int) -> tuple[float, ...]:
        """Return what an agent sees, element by element."""
        spec, words = self.spec, [int(word) for word in self._observe[agent](*self.state)]
        if spec.unpack is not None:
            dtype = np.dtype(np.uint8) if spec.observation_dtype.kind == "b" else spec.observation_dtype
            row = np.zeros(spec.observation_size, dtype)
            spec.unpack(*words, row)
            return tuple(map(float, row))
        return tuple(float(f.value(w)) for f, w in zip(spec.observation, words, strict=True))


def compare(spec: EnvSpec, original: Original, steps: int, seed: int) -> Comparison:
    """Compare an environment with an original.

    Raises
    ------
    ArgumentError
        Their spaces or their numbers of agents differ.
    """
    for what in ("agents", "observation_space", "action_space"):
        mine, other = getattr(spec, what), getattr(original, what)
        if mine != other:
            raise ArgumentError(
                f"{spec.name} has {what} {mine}, and {original.name} {other}: they must be the same"
            )
    pose, how = _poser(spec, original)
    rng = np.random.default_rng(seed)
    reals = any(f.fraction for f in (*spec.state, *spec.observation))
    difference, errors, taken = None, list[Errors](), 0
    ours = _Ours(spec)
    if pose is None and (spec.reset_draws or spec.step_draws):
        how += "; only returns are compared"
    elif reals and pose is not None:
        taken = steps
        for states in ("reached", "random"):
            errors += _errors(ours, original, pose, rng, steps // 2, states)
    elif spec.step_draws and pose is not None:
        taken, difference = _outcomes(ours, original, pose, rng, steps)
    else:
        taken, difference = _side_by_side(ours, original, pose, rng, steps)
    limit = min(spec.max_cycles or LONGEST, LONGEST)
    mine = list(_returns(lambda: _our_episode(ours, original, rng, limit)))
    theirs = list(_returns(lambda: _their_episode(original, rng, limit)))
    (a, b), (c, d) = zip(*mine, strict=True), zip(*theirs, strict=True)
    return Comparison(
        how,
        taken,
        difference,
        errors,
        ((float(np.mean(a)), float(np.std(a))), (float(np.mean(c)), float(np.std(c)))),
        (float(np.mean(b)), float(np.mean(d))),
    )


def _poser(spec: EnvSpec, original: Original) -> tuple[Callable[[tuple[int, ...]], None] | None, str]:
    """Return what puts the original into a state, and how."""
    own = spec.pose
    if own is not None:
        return lambda words: own(original.env, spec.layout.built(words)), "posed by the spec's pose()"
    original.reset(seed=0)
    paths = [path for path, _ in leaves_of(original.env)]
    there = {path.rpartition(".")[2]: path for path in paths} | {
        path.replace(".", "_"): path for path in paths
    }
    names = list(getattr(spec.golden.state, "__annotations__", ()))
    missing = [name for name in names if name not in there]
    if missing:
        return (
            None,
            f"it cannot be posed: the spec has no pose(), and the original no attribute {missing[0]!r}",
        )

    def by_names(words: tuple[int, ...]) -> None:
        if spec.layout.fraction is None:  # otherwise reals are made of words
            words = tuple(f.value(word) for f, word in zip(spec.state, words, strict=True))  # type: ignore[misc]
        state = spec.layout.built(words)
        for name in names:
            *groups, last = there[name].split(".")
            owner = original.env
            for group in groups:
                owner = getattr(owner, group)
            setattr(owner, last, like(getattr(owner, last), getattr(state, name)))

    return by_names, "posed by attributes of the same names"


def _side_by_side(
    ours: _Ours, original: Original, pose: Any, rng: np.random.Generator, steps: int
) -> tuple[int, str | None]:
    """Run both from the same states by the same actions, without draws."""
    taken = 0
    while taken < steps:
        ours.reset(rng)
        original.reset(seed=int(rng.integers(1 << 31)))
        begun = ours.state
        if pose is not None:
            pose(begun)
        else:
            wrong = _wrong_view(ours, original)
            if wrong:
                return taken, f"at the start of an episode {wrong}"
        actions: list[Any] = []
        for _ in range(min(ours.spec.max_cycles or LONGEST, LONGEST, steps - taken)):
            given = original.actions(rng)
            actions.append(given[0] if len(given) == 1 else given)
            rewards, ends = ours.step(_words(ours.spec, given), rng)
            outcome = original.step(given)
            taken += 1
            wrong = _wrong(rewards, ends, outcome.rewards, outcome.terminated) or _wrong_view(ours, original)
            if wrong:
                last = ", ".join(map(str, actions[-8:]))
                return taken, (
                    f"from {_named(ours.spec, begun)} after {len(actions)} steps, the last by the actions "
                    f"{last}: {wrong}"
                )
            if all(ends) or outcome.over:
                break
    return taken, None


def _outcomes(
    ours: _Ours, original: Original, pose: Any, rng: np.random.Generator, steps: int
) -> tuple[int, str | None]:
    """Compare the outcomes of steps with draws: what happens often on one side happens on the other."""
    original.reset(seed=0)
    ours.reset(rng)
    age, compared = 0, set[tuple[Any, ...]]()
    for taken in range(1, steps + 1):
        before, given = ours.state, original.actions(rng)
        words = _words(ours.spec, given)
        mine, theirs = Counter[Any](), Counter[Any]()
        known = (before, *words) in compared or len(compared) >= MOST_SAMPLED
        compared.add((before, *words))
        for _ in range(1 if known else SAMPLES):
            ours.state = before
            rewards, ends = ours.step(words, rng)
            mine[(*rewards, *ends, *ours.observation(0))] += 1
        last, last_ends = ours.state, ends
        for _ in range(0 if known else SAMPLES):
            pose(before)
            original.reseed(int(rng.integers(1 << 31)))
            outcome = original.step(given)
            seen = outcome.observations[0]
            row = () if seen is None else elements(seen)
            theirs[(*outcome.rewards, *outcome.terminated, *row)] += 1
        for result in {} if known else {**theirs, **mine}:
            own, due = mine[result] / SAMPLES, theirs[result] / SAMPLES
            both = (own + due) / 2
            if (max(own, due) >= OFTEN and min(own, due) == 0) or abs(own - due) > 6 * np.sqrt(
                both * (1 - both) * 2 / SAMPLES
            ):
                n = len(given)
                told = f"reward {result[:n]}, terminated {result[n : 2 * n]}, observation {result[2 * n :]}"
                return taken, (
                    f"from {_named(ours.spec, before)} by action {_words(ours.spec, given)}: {told} "
                    f"has a share of {own:.2f}, the original's is {due:.2f}"
                )
        ours.state, age = last, age + 1
        if all(last_ends) or age >= (ours.spec.max_cycles or LONGEST):
            ours.reset(rng)
            age = 0
    return steps, None


def _errors(
    ours: _Ours, original: Original, pose: Any, rng: np.random.Generator, steps: int, states: str
) -> Iterator[Errors]:
    """Yield the errors of one step over states that are reached, or random ones within those."""
    spec = ours.spec
    original.reset(seed=0)
    reached, found = [], []
    ours.reset(rng)
    age = 0
    for _ in range(max(steps, 1)):
        reached.append(ours.state)
        _, ends = ours.step(_words(spec, original.actions(rng)), rng)
        age += 1
        if all(ends) or age >= (spec.max_cycles or LONGEST):
            ours.reset(rng)
            age = 0
    if states == "random":
        low, high = np.array(reached).min(0), np.array(reached).max(0)
        reached = [
            tuple(map(int, row)) for row in rng.integers(low, high, (len(reached), len(low)), endpoint=True)
        ]
    for state in reached:
        given = original.actions(rng)
        ours.state = state
        pose(state)
        # Both begin from what the words stand for, so the error is of one step alone.
        rewards, ends = ours.step(_words(spec, given), rng)
        outcome = original.step(given)
        row = [*rewards, *map(float, ends)]
        due = [*outcome.rewards, *map(float, outcome.terminated)]
        for agent in range(spec.agents):
            row += ours.observation(agent)
            due += elements(outcome.observations[agent])
        found.append(np.abs(np.subtract(row, due)))
    table = np.array(found)
    several = spec.agents > 1
    names = [f"{what}{f' {k}' * several}" for what in ("reward", "terminated") for k in range(spec.agents)]
    fields = [f.name for f in spec.observation]
    fields = fields if spec.unpack is None else [f"element {k}" for k in range(spec.observation_size)]
    names += [f"{name}{f' of {k}' * several}" for k in range(spec.agents) for name in fields]
    for name, column in zip(names, table.T, strict=True):
        yield Errors(name, states, float(column.max()), float(column.mean()))


def _wrong(rewards: list[float], ends: list[bool], due: list[float], due_ends: list[bool]) -> str | None:
    for k, (a, b) in enumerate(zip(rewards, due, strict=True)):
        if np.float32(a) != np.float32(b):
            return f"reward{f' {k}' * (len(due) > 1)} is {a}, the original's {b}"
    for k, (own, other) in enumerate(zip(ends, due_ends, strict=True)):
        if own != other:
            return f"terminated{f' {k}' * (len(due) > 1)} is {own}, the original's {other}"
    return None


def _wrong_view(ours: _Ours, original: Original) -> str | None:
    for agent, seen in enumerate(original.seen):
        if seen is None:
            continue
        mine, due = ours.observation(agent), elements(seen)
        for k, (a, b) in enumerate(zip(mine, due, strict=True)):
            if np.float32(a) != np.float32(b):
                where = f"element {k} of the observation" if len(due) > 1 else "the observation"
                return f"{where} is {a:g}, the original's {b:g}"
    return None


def _named(spec: EnvSpec, state: tuple[int, ...]) -> str:
    pairs = [f"{f.name}={f.value(word)}" for f, word in zip(spec.state, state, strict=True)]
    return ", ".join(pairs if len(pairs) <= 12 else [*pairs[:12], "..."])


def _words(spec: EnvSpec, actions: list[Any]) -> list[int]:
    return encode(np.stack(actions), spec, room_for_words(spec, len(actions))).ravel().tolist()


def _draws(rng: np.random.Generator, count: int) -> list[int]:
    return [int(word) for word in rng.integers(1 << 32, size=count)]


def _returns(episode: Callable[[], tuple[float, int]]) -> Iterator[tuple[float, int]]:
    return (episode() for _ in range(EPISODES))


def _our_episode(ours: _Ours, original: Original, rng: np.random.Generator, limit: int) -> tuple[float, int]:
    ours.reset(rng)
    total = 0.0
    for k in range(limit):
        rewards, ends = ours.step(_words(ours.spec, original.actions(rng)), rng)
        total += sum(rewards)
        if all(ends):
            return total, k + 1
    return total, limit


def _their_episode(original: Original, rng: np.random.Generator, limit: int) -> tuple[float, int]:
    original.reset(seed=int(rng.integers(1 << 31)))
    total = 0.0
    for k in range(limit):
        outcome = original.step(original.actions(rng))
        total += sum(outcome.rewards)
        if outcome.over:
            return total, k + 1
    return total, limit
