"""An environment beside the original that it follows: ``pearl verify NAME --against package:Class``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.batch.actions import encode, room_for_words
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import reference
from pearl_marl.porting.contents import elements, leaves_of
from pearl_marl.porting.originals import Original, Outcome
from pearl_marl.porting.port import first_unlike, like
from pearl_marl.spec import EnvSpec

EPISODES, LONGEST = 100, 1000
"""Of random policies, whose returns are compared; and their steps at most."""

SAMPLES = 100
"""Outcomes of a step with draws."""

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

    def walk(self, original: Original, rng: np.random.Generator, steps: int) -> Iterator[list[Any]]:
        """Yield random actions in each of so many states that are reached, and take them then."""
        left, episode = 0, -1
        for _ in range(steps):
            if left == 0:
                self.reset(rng)
                episode += 1
                habits, left = original.habits(rng, episode), _limit(self.spec)
            given, before = next(habits), self.state
            yield given
            self.state = before
            _, ends = self.step(_words(self.spec, given), rng)
            left = 0 if all(ends) else left - 1

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

    def our_step(given: list[Any]) -> tuple[float, bool]:
        rewards, ends = ours.step(_words(spec, given), rng)
        return sum(rewards), all(ends)

    def their_step(given: list[Any]) -> tuple[float, bool]:
        outcome = original.step(given)
        return sum(outcome.rewards), outcome.over

    def their_reset() -> None:
        original.reset(seed=int(rng.integers(1 << 31)))

    mine, length = _returns(original, lambda: ours.reset(rng), our_step, _limit(spec))
    theirs, other_length = _returns(original, their_reset, their_step, _limit(spec))
    return Comparison(how, taken, difference, errors, (mine, theirs), (length, other_length))


def _poser(spec: EnvSpec, original: Original) -> tuple[Callable[[tuple[int, ...]], None] | None, str]:
    """Return what puts the original into a state, and how."""
    own = spec.pose
    if own is not None:
        return lambda words: own(original.env, _valued(spec, words)), "posed by the spec's pose()"
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
        state = _valued(spec, words)
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
    names = _names(ours.spec)
    taken = 0
    while taken < steps:
        ours.reset(rng)
        original.reset(seed=int(rng.integers(1 << 31)))
        begun = ours.state
        if pose is not None:
            pose(begun)
        else:
            rewards, ends = [0.0] * original.agents, [False] * original.agents
            outcome = Outcome(original.seen, rewards, ends, truncated=False)
            wrong = _unequal(names, _both(ours, rewards, ends, outcome))
            if wrong:
                return taken, f"at the start of an episode {wrong}"
        actions: list[Any] = []
        for given in islice(original.habits(rng, taken), min(_limit(ours.spec), steps - taken)):
            actions.append(given[0] if len(given) == 1 else given)
            rewards, ends = ours.step(_words(ours.spec, given), rng)
            outcome = original.step(given)
            wrong = _unequal(names, _both(ours, rewards, ends, outcome))
            if wrong:
                last = ", ".join(map(str, actions[-8:]))
                return taken + len(actions), (
                    f"from {_named(ours.spec, begun)} after {len(actions)} steps, the last by the actions "
                    f"{last}: {wrong}"
                )
            if all(ends) or outcome.over:
                break
        taken += len(actions)
    return taken, None


def _outcomes(
    ours: _Ours, original: Original, pose: Any, rng: np.random.Generator, steps: int
) -> tuple[int, str | None]:
    """Compare the outcomes of steps with draws: what happens often on one side happens on the other."""
    original.reset(seed=0)
    compared = set[tuple[Any, ...]]()
    for taken, given in enumerate(ours.walk(original, rng, steps), 1):
        before, words = ours.state, _words(ours.spec, given)
        if (before, *words) in compared or len(compared) >= MOST_SAMPLED:
            continue
        compared.add((before, *words))
        mine, theirs = Counter[Any](), Counter[Any]()
        for _ in range(SAMPLES):
            ours.state = before
            rewards, ends = ours.step(words, rng)
            pose(before)
            original.reseed(int(rng.integers(1 << 31)))
            own, due = _both(ours, rewards, ends, original.step(given))
            mine[tuple(own)] += 1
            theirs[tuple(due)] += 1
        unlike = first_unlike(mine, theirs)
        if unlike:
            result, share, right = unlike
            told = ", ".join(f"{name} {x:g}" for name, x in zip(_names(ours.spec), result, strict=True))
            return taken, (
                f"from {_named(ours.spec, before)} by action {words}: {told} has a share of {share:.2f}, "
                f"the original's is {right:.2f}"
            )
    return steps, None


def _errors(
    ours: _Ours, original: Original, pose: Any, rng: np.random.Generator, steps: int, states: str
) -> Iterator[Errors]:
    """Yield the errors of one step over states that are reached, or random ones within those."""
    original.reset(seed=0)
    reached = [ours.state for _ in ours.walk(original, rng, max(steps, 1))]
    if states == "random":
        low, high = np.array(reached).min(0), np.array(reached).max(0)
        reached = [
            tuple(map(int, row)) for row in rng.integers(low, high, (len(reached), len(low)), endpoint=True)
        ]
    found = []
    for state in reached:
        given = original.actions(rng)
        ours.state = state
        pose(state)
        # Both begin from what the words stand for, so the error is of one step alone.
        rewards, ends = ours.step(_words(ours.spec, given), rng)
        found.append(np.abs(np.subtract(*_both(ours, rewards, ends, original.step(given)))))
    for name, column in zip(_names(ours.spec), np.array(found).T, strict=True):
        yield Errors(name, states, float(column.max()), float(column.mean()))


def _names(spec: EnvSpec) -> list[str]:
    """Return what the numbers that a step gives are called: rewards, ends, and what each agent sees."""
    several, agents = spec.agents > 1, range(spec.agents)
    fields = [f.name for f in spec.observation]
    fields = fields if spec.unpack is None else [f"element {k}" for k in range(spec.observation_size)]
    names = [f"{what}{f' {k}' * several}" for what in ("reward", "terminated") for k in agents]
    return names + [f"{name}{f' of {k}' * several}" for k in agents for name in fields]


def _both(
    ours: _Ours, rewards: list[float], ends: list[Any], outcome: Outcome
) -> tuple[list[float], list[float]]:
    """Return these numbers of both; an agent that has left the original sees what it sees here."""
    own = [*rewards, *map(float, ends)]
    due = [*outcome.rewards, *map(float, outcome.terminated)]
    for agent, seen in enumerate(outcome.observations):
        mine = ours.observation(agent)
        own += mine
        due += mine if seen is None else elements(seen)
    return own, due


def _unequal(names: list[str], both: tuple[list[float], list[float]]) -> str | None:
    """Return the first number that differs."""
    for name, own, due in zip(names, *both, strict=True):
        if np.float32(own) != np.float32(due):
            return f"{name} is {own:.9g}, the original's {due:.9g}"
    return None


def _named(spec: EnvSpec, state: tuple[int, ...]) -> str:
    pairs = [f"{f.name}={f.value(word)}" for f, word in zip(spec.state, state, strict=True)]
    return ", ".join(pairs if len(pairs) <= 12 else [*pairs[:12], "..."])


def _valued(spec: EnvSpec, state: tuple[int, ...]) -> Any:
    """Return a state as :attr:`EnvSpec.pose` takes it: fields with a fraction are floats."""
    return spec.layout.built(f.value(word) for f, word in zip(spec.state, state, strict=True))


def _words(spec: EnvSpec, actions: list[Any]) -> list[int]:
    words: list[int] = encode(np.stack(actions), spec, room_for_words(spec, len(actions))).ravel().tolist()
    return words


def _draws(rng: np.random.Generator, count: int) -> list[int]:
    return [int(word) for word in rng.integers(1 << 32, size=count)]


def _limit(spec: EnvSpec) -> int:
    return min(spec.max_cycles or LONGEST, LONGEST)


def _returns(
    original: Original, reset: Callable[[], Any], step: Callable[[Any], tuple[float, bool]], limit: int
) -> tuple[tuple[float, float], float]:
    """Return mean and standard deviation of random episodes' returns, and their mean steps."""
    rng = np.random.default_rng(0)
    returns, lengths = [], []
    for _ in range(EPISODES):
        reset()
        total, taken, over = 0.0, 0, False
        while taken < limit and not over:
            reward, over = step(original.actions(rng))
            total, taken = total + reward, taken + 1
        returns.append(total)
        lengths.append(taken)
    return (float(np.mean(returns)), float(np.std(returns))), float(np.mean(lengths))
