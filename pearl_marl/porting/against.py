"""An environment beside the original that it follows: ``pearl verify NAME --against package:Class``."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.errors import ArgumentError
from pearl_marl.porting import oracle
from pearl_marl.porting.contents import elements, leaves_of
from pearl_marl.porting.oracle import DifferenceError, Games, Ours, Outcome, one_by_one
from pearl_marl.porting.originals import Original
from pearl_marl.porting.port import like
from pearl_marl.spec import EnvSpec

Pose = Callable[[Any], None]
"""Puts an original into a state, as golden functions have it."""

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


class ComparisonWithOriginal(NamedTuple):
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


def compare(spec: EnvSpec, original: Original, steps: int, seed: int) -> ComparisonWithOriginal:
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
    if pose is None and (spec.reset_draws or spec.step_draws):
        how += "; only returns are compared"
    elif reals and pose is not None:
        taken = steps
        for states in ("reached", "random"):
            errors += _errors(spec, original, pose, rng, steps // 2, states)
    elif spec.step_draws and pose is not None:
        taken, difference = _outcomes(spec, original, pose, rng, steps)
    else:
        taken, difference = _side_by_side(spec, original, pose, rng, steps)
    ours = Ours(spec, 1)

    def start() -> None:
        ours.start(oracle.uniform_draws(rng, 1, spec.reset_draws))

    def step(given: list[Any]) -> Outcome:
        return ours.step(np.array(given)[None], oracle.uniform_draws(rng, 1, spec.step_draws))

    def reset() -> None:
        original.reset(seed=int(rng.integers(1 << 31)))

    mine, length = _returns(original, start, step, _limit(spec))
    theirs, other_length = _returns(original, reset, original.step, _limit(spec))
    return ComparisonWithOriginal(how, taken, difference, errors, (mine, theirs), (length, other_length))


def _poser(spec: EnvSpec, original: Original) -> tuple[Pose | None, str]:
    """Return what puts the original into a state, and how."""
    own = spec.pose
    if own is not None:
        return lambda state: own(original.env, state), "posed by the spec's pose()"
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

    def by_names(state: Any) -> None:
        for name in names:
            *groups, last = there[name].split(".")
            owner = functools.reduce(getattr, groups, original.env)
            setattr(owner, last, like(getattr(owner, last), getattr(state, name)))

    return by_names, "posed by attributes of the same names"


def _beside(spec: EnvSpec, original: Original, pose: Pose | None, rng: np.random.Generator) -> Games:
    """Return the original as an oracle of one game, which is reset where an episode begins."""

    def begin(game: Original, state: Any) -> None:
        game.reset(seed=int(rng.integers(1 << 31)))
        if pose is not None:
            pose(state)

    def look(game: Original) -> Outcome:
        return Outcome(_observations(spec, game) if pose is None else None)

    return Games(spec, [original], begin, lambda game, *given: _stepped(spec, game, *given), look)


def _stepped(spec: EnvSpec, original: Original, actions: list[Any], draws: list[int]) -> Outcome:
    """Step the original by its own random numbers; of the time limit nothing is said."""
    kind = original.action_space.dtype
    given = [np.asarray(action, kind) if isinstance(action, list) else action for action in actions]
    return original.step(given)._replace(observations=_observations(spec, original), truncated=None)


def _observations(spec: EnvSpec, original: Original) -> list[Any]:
    """Return what each agent observes, element by element; of one that has left nothing."""
    nothing = (np.nan,) * spec.observation_size
    return [nothing if seen is None else elements(seen) for seen in original.observations]


def _side_by_side(
    spec: EnvSpec, original: Original, pose: Pose | None, rng: np.random.Generator, steps: int
) -> tuple[int, str | None]:
    """Run both from the same states by the same actions, without draws."""
    taken, game = 0, _beside(spec, original, pose, rng)
    while taken < steps:
        habits = original.habits(rng, taken)

        def act(ours: Ours, generator: np.random.Generator) -> Array:
            nonlocal taken
            taken += 1
            return np.array(next(habits))[None]  # noqa: B023 - of this episode

        most = min(_limit(spec), steps - taken)
        try:
            for move in oracle.compare(spec, game, 1, most, actions=act, seed=taken, restarts=False):
                if move.ended[0] or original.over:
                    break
        except DifferenceError as error:
            return taken, str(error)
    return taken, None


def _walk(
    spec: EnvSpec, original: Original, rng: np.random.Generator, steps: int
) -> Iterator[tuple[Any, Any]]:
    """Yield the words and the actions of steps of ours alone, by the habits of the original."""
    ours, generator = Ours(spec, 1), np.random.default_rng(int(rng.integers(1 << 31)))
    for episode in itertools.count():
        ours.start(oracle.uniform_draws(generator, 1, spec.reset_draws))
        for given in itertools.islice(original.habits(generator, episode), min(steps, _limit(spec))):
            actions = np.array(given)[None]
            yield [word[0] for word in ours.words], actions[0]
            steps -= 1
            if ours.step(actions, oracle.uniform_draws(generator, 1, spec.step_draws)).over:
                break
        if steps == 0:
            return


def _outcomes(
    spec: EnvSpec, original: Original, pose: Pose, rng: np.random.Generator, steps: int
) -> tuple[int, str | None]:
    """Compare the outcomes of steps with draws: what happens often on one side happens on the other."""
    original.reset(seed=0)
    compared = set[tuple[Any, ...]]()

    def posed(state: Any, actions: list[Any]) -> Outcome:
        pose(state)
        original.reseed(int(rng.integers(1 << 31)))
        return _stepped(spec, original, actions, [])

    for taken, (words, actions) in enumerate(_walk(spec, original, rng, steps), 1):
        key = (*map(int, words), *np.ravel(actions).tolist())
        if key in compared or len(compared) >= MOST_SAMPLED:
            continue
        compared.add(key)
        values = [field.value(int(word)) for field, word in zip(spec.state, words, strict=True)]
        state, given = spec.layout.built(values), actions.tolist()
        theirs = oracle.joined([posed(state, given) for _ in range(SAMPLES)])
        wrong = oracle.unlike_outcomes(spec, words, actions, theirs, rng)
        if wrong:
            return taken, wrong
    return steps, None


def _errors(
    spec: EnvSpec, original: Original, pose: Pose, rng: np.random.Generator, steps: int, states: str
) -> Iterator[Errors]:
    """Yield the errors of one step over states that are reached, or random ones within those."""
    original.reset(seed=0)
    reached = np.array([words for words, _ in _walk(spec, original, rng, max(steps, 1))])
    if states == "random":
        reached = rng.integers(reached.min(0), reached.max(0), reached.shape, endpoint=True)

    def posed(state: Any, actions: list[Any], draws: list[int]) -> Outcome:
        # Both begin from what the words stand for, so the error is of one step alone.
        pose(state)
        return _stepped(spec, original, actions, draws)

    (move,) = oracle.compare(
        spec,
        one_by_one(spec, posed),
        len(reached),
        state=list(reached.T),
        seed=int(rng.integers(1 << 31)),
        tolerance=np.inf,
    )
    errors = move.errors
    shown = Outcome(errors["observation"], errors["reward"], errors["terminated"])
    for name, column in oracle.numbers(spec, shown).items():
        yield Errors(name, states, float(column.max()), float(column.mean()))


def _limit(spec: EnvSpec) -> int:
    return min(spec.max_cycles or LONGEST, LONGEST)


def _returns(
    original: Original, reset: Callable[[], Any], step: Callable[[Any], Outcome], limit: int
) -> tuple[tuple[float, float], float]:
    """Return mean and standard deviation of random episodes' returns, and their mean steps."""
    rng = np.random.default_rng(0)
    returns, lengths = [], []
    for _ in range(EPISODES):
        reset()
        total, taken, over = 0.0, 0, False
        while taken < limit and not over:
            outcome = step(original.actions(rng))
            total, taken, over = total + float(np.sum(outcome.rewards)), taken + 1, outcome.over
        returns.append(total)
        lengths.append(taken)
    return (float(np.mean(returns)), float(np.std(returns))), float(np.mean(lengths))
