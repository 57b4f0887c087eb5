"""Golden functions beside an oracle: somebody else's implementation of the same rules.

An author says how the oracle is put into a state, how it steps, and what it shows: as an :class:`Oracle`, or
as :class:`Games` of single games. :func:`compare` does the rest: it puts both into the same states, steps
both by the same actions and draws, and compares observations, rewards, ends, masks and states.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.batch.actions import encode, random_actions, room_for_words
from pearl_marl.devices.reference import observations_of
from pearl_marl.golden import reference
from pearl_marl.spec import EnvSpec


class Outcome(NamedTuple):
    """What a game shows after a step, or as it is posed; ``None`` where the oracle does not say it.

    In a world of several agents, a list with an entry for each agent; of several games, arrays whose first
    axis is that of the games. NaN stands for a number that is not said.
    """

    observations: Any = None
    rewards: Any = None
    terminated: Any = None
    truncated: Any = None
    """Whether the time limit ends the episode: one flag for all agents."""
    masks: Any = None
    state: Mapping[str, Any] | None = None
    """Values of the state's fields, by their names."""
    undecided: Any = False
    """Whether reward and end may differ: a number is nearer to a threshold than the tolerance."""

    @property
    def over(self) -> bool:
        """Whether the episode is over, of one game."""
        return bool(self.truncated) or bool(np.all(self.terminated))


class Oracle(Protocol):
    """Games of somebody else's implementation."""

    def pose(self, games: Array, state: list[Array]) -> None:
        """Put games, by their numbers, into states: for each field the values of those games."""

    def look(self, games: Array) -> Outcome:
        """Return what these games show as they are."""

    def step(self, actions: Array, draws: Array) -> Outcome:
        """Step all games by actions of shape ``(games, agents, ...)`` and draws of ``(games, draws)``."""


class Games:
    """An oracle that has an object for each game.

    Parameters
    ----------
    spec
        The environment.
    games
        The objects.
    pose
        Puts an object into a state, as :attr:`EnvSpec.pose` does.
    step
        Steps an object by a list of the agents' actions and a list of draws; returns its :class:`Outcome`.
    look
        Returns what a posed object shows.
    """

    def __init__(
        self,
        spec: EnvSpec,
        games: Sequence[Any],
        pose: Callable[[Any, Any], None],
        step: Callable[[Any, list[Any], list[int]], Outcome],
        look: Callable[[Any], Outcome] = lambda game: Outcome(),
    ) -> None:
        self.games, self._spec = list(games), spec
        self._pose, self._step, self._look = pose, step, look

    def pose(self, games: Array, state: list[Array]) -> None:
        """Put games into states."""
        for game, one in zip(games.tolist(), _states(self._spec, state), strict=True):
            self._pose(self.games[game], one)

    def look(self, games: Array) -> Outcome:
        """Return what these games show as they are."""
        return joined([self._look(self.games[game]) for game in games.tolist()])

    def step(self, actions: Array, draws: Array) -> Outcome:
        """Step all games."""
        rows = zip(self.games, actions.tolist(), draws.tolist(), strict=True)
        return joined([self._step(*row) for row in rows])


class Rules:
    """An oracle that is one function of states, actions and draws, for steps from states of ours.

    ``step(state, actions, draws)`` returns an :class:`Outcome` of many games: of a column of values for each
    field, and what :meth:`Oracle.step` takes. See :func:`one_by_one` for a function of one game.
    """

    def __init__(self, step: Callable[[list[Array], Array, Array], Outcome]) -> None:
        self._step = step
        self._state: list[Array] = []

    def pose(self, games: Array, state: list[Array]) -> None:
        """Put games into states."""
        if not self._state or len(games) == len(self._state[0]):
            self._state = [column.copy() for column in state]
        for kept, column in zip(self._state, state, strict=True):
            kept[games] = column

    def look(self, games: Array) -> Outcome:
        """Return nothing: there is no game before it is stepped."""
        return Outcome()

    def step(self, actions: Array, draws: Array) -> Outcome:
        """Step all games."""
        return self._step(self._state, actions, draws)


def one_by_one(spec: EnvSpec, step: Callable[[Any, list[Any], list[int]], Outcome]) -> Rules:
    """Return the oracle of rules of one game: of its state, the agents' actions, and draws."""

    def every(state: list[Array], actions: Array, draws: Array) -> Outcome:
        rows = zip(_states(spec, state), actions.tolist(), draws.tolist(), strict=True)
        return joined([step(*row) for row in rows])

    return Rules(every)


def _states(spec: EnvSpec, columns: list[Array]) -> Iterator[Any]:
    """Yield the state of each game, as golden functions have it."""
    return map(spec.layout.built, zip(*(column.tolist() for column in columns), strict=True))


def joined(outcomes: Sequence[Outcome]) -> Outcome:
    """Return the outcomes of several games as one."""
    columns: dict[str, Any] = dict(zip(Outcome._fields, zip(*outcomes, strict=True), strict=True))
    states = columns.pop("state")
    if states[0] is not None:
        states = {name: np.array([state[name] for state in states]) for name in states[0]}
    parts = {name: None if column[0] is None else np.array(column) for name, column in columns.items()}
    return Outcome(**parts, state=states if isinstance(states, dict) else None)


class Ours:
    """Golden functions, run by Python over many games at once."""

    def __init__(self, spec: EnvSpec, n: int) -> None:
        golden = spec.positional
        self.spec, self.n = spec, n
        self._initial, self._step = reference(golden.initial), reference(golden.step)
        self._observe = [reference(golden.observe, *agent) for agent in spec.views]
        masks = golden.masks
        self._masks = [] if masks is None else [reference(masks, *agent) for agent in spec.views]
        self.words: list[Array] = [np.zeros(n, field.dtype) for field in spec.state]
        """A column for each field of the state."""
        self._last_observed: tuple[list[Array], Array] | None = None

    def start(self, draws: Array, games: Any = slice(None)) -> None:
        """Begin episodes in some games by draws of shape ``(games, draws)``."""
        for column, word in zip(self.words, self._initial(*draws.T), strict=True):
            column[games] = word
        self._last_observed = None

    def values(self, games: Any = slice(None)) -> list[Array]:
        """Return what the words of the state stand for; fields with a fraction are floats."""
        pairs = zip(self.words, self.spec.state, strict=True)
        return [word[games] * 2.0**-f.fraction if f.fraction else word[games] for word, f in pairs]

    def step(self, actions: Array, draws: Array) -> Outcome:
        """Step all games by actions and draws; return rewards and ends, shape ``(games, agents)``."""
        spec = self.spec
        flat = actions.reshape(self.n * spec.agents, *actions.shape[2:])
        words = encode(flat, spec, room_for_words(spec, len(flat))).reshape(self.n, -1)
        results = np.broadcast_arrays(*self._step(*self.words, *words.T, *draws.T), np.zeros(self.n))
        count = len(spec.state)
        self.words = [word.astype(f.dtype) for word, f in zip(results[:count], spec.state, strict=True)]
        codes, ends = np.stack(results[count:-1], 1).reshape(self.n, 2, spec.agents).swapaxes(0, 1)
        worth = codes * 2.0**-spec.reward.fraction if spec.rewards is None else np.array(spec.rewards)[codes]
        return Outcome(rewards=worth, terminated=ends.astype(np.bool_))

    def observations(self) -> Array:
        """Return what all agents see, shape ``(games, agents, elements)``."""
        if self._last_observed is None or self._last_observed[0] is not self.words:
            seen = np.stack([self._observed(self._run(run)) for run in self._observe], 1)
            self._last_observed = self.words, seen
        return self._last_observed[1]

    def masks(self) -> Array:
        """Return which actions all agents may take, shape ``(games, agents, actions)``."""
        return np.stack([np.stack(self._run(run), 1) for run in self._masks], 1)

    def _run(self, function: Callable[..., Any]) -> list[Array]:
        return np.broadcast_arrays(*function(*self.words), np.zeros(self.n))[:-1]  # type: ignore[return-value]

    def _observed(self, words: list[Array]) -> Array:
        spec = self.spec
        if spec.unpack is not None:
            return observations_of(spec, words).reshape(self.n, -1)
        pairs = zip(words, spec.observation, strict=True)
        return np.stack([word * 2.0**-f.fraction if f.fraction else word for word, f in pairs], 1)


class Move(NamedTuple):
    """One step of all games, which was compared."""

    before: list[Array]
    """The state's words before the step, a column for each field."""
    actions: Array
    draws: Array
    after: list[Array]
    """The state's words after it, before any episode begins again."""
    outcome: Outcome
    """Our rewards, ends and compared observations; and the oracle's ``state`` and ``undecided``."""
    ended: Array
    """Which episodes are over."""
    errors: dict[str, Array]
    """How much each number differs, by what it is, shape ``(games, agents, elements)``."""


class DifferenceError(AssertionError):
    """Golden functions and oracle differ; the message says in what, and from which state on."""


Actions = Callable[[Ours, np.random.Generator], Array]
Draws = Callable[[np.random.Generator, int, int], Array]


def uniform_draws(generator: np.random.Generator, games: int, count: int) -> Array:
    """Return draws of shape ``(games, count)``, as a device has them."""
    return generator.integers(1 << 32, size=(games, count))


def any_actions(ours: Ours, generator: np.random.Generator) -> Array:
    """Return a random action of each agent."""
    flat = random_actions(ours.spec, generator, ours.n * ours.spec.agents)
    return flat.reshape(ours.n, ours.spec.agents, *flat.shape[1:])


def compare(
    spec: EnvSpec,
    oracle: Oracle,
    n: int,
    steps: int = 1,
    *,
    state: Sequence[Array] | None = None,
    actions: Actions | Array = any_actions,
    draws: Draws = uniform_draws,
    seed: int = 0,
    posed: bool = False,
    restarts: bool = True,
    tolerance: float | Mapping[str, float] = 0.0,
) -> Iterator[Move]:
    """Step golden functions and an oracle side by side, and yield each step after it has been compared.

    Parameters
    ----------
    spec, oracle
        The two.
    n, steps
        How many games, and how many steps of each.
    state
        Words to begin from, a column for each field of the state; by default episodes begin by ``initial``.
    actions
        Chooses actions of shape ``(n, agents, ...)``; or those of the only step.
    draws
        Makes draws of shape ``(games, count)``.
    seed
        Of actions and draws.
    posed
        Whether the oracle is put into our state before each step, as reals take it, and not only where
        episodes begin.
    restarts
        Whether an episode that is over begins again.
    tolerance
        By how much a number may differ: for all, or for those of a name: ``"observation"``, ``"reward"``,
        or a field of the state.

    Raises
    ------
    DifferenceError
        The two differ.
    """
    generator, ours = np.random.default_rng(seed), Ours(spec, n)
    every = np.arange(n)
    if state is None:
        ours.start(draws(generator, n, spec.reset_draws))
    else:
        ours.words = [np.asarray(word).astype(f.dtype) for word, f in zip(state, spec.state, strict=True)]
    elapsed, begun = np.zeros(n, np.int64), [word.copy() for word in ours.words]
    recent, judge = deque[Array](maxlen=8), _Judge(spec, tolerance)

    def where(game: int) -> str:
        taken = [given[game].tolist() for given in recent][-int(elapsed[game]) :]
        last = ", ".join(str(given[0] if spec.agents == 1 else given) for given in taken)
        return (
            f"from {named(spec, [word[game] for word in begun])} after {elapsed[game]:,} steps, the last "
            f"by the actions {last}"
        )

    oracle.pose(every, ours.values())
    judge.compare(ours, Outcome(), oracle.look(every), every, lambda game: "at the start")
    for step in range(steps):
        before = ours.words
        if posed and step:
            oracle.pose(every, ours.values())
        chosen = actions(ours, generator) if callable(actions) else actions.reshape(n, spec.agents, -1)
        if not callable(actions) and spec.action_space.shape == ():
            chosen = chosen[..., 0]
        drawn = draws(generator, n, spec.step_draws)
        mine, theirs = ours.step(chosen, drawn), oracle.step(chosen, drawn)
        elapsed += 1
        over = mine.terminated.all(1)
        late = elapsed >= spec.max_cycles if spec.max_cycles else np.zeros(n, np.bool_)
        mine = mine._replace(truncated=late & ~over)
        recent.append(chosen)
        errors = judge.compare(ours, mine, theirs, every, where)
        ended = over | late
        mine = mine._replace(state=theirs.state, undecided=theirs.undecided)
        if theirs.observations is not None:
            mine = mine._replace(observations=ours.observations())
        yield Move(before, chosen, drawn, ours.words, mine, ended, errors)
        if restarts and ended.any() and step + 1 < steps:
            games = np.flatnonzero(ended)
            ours.words = [word.copy() for word in ours.words]
            ours.start(draws(generator, len(games), spec.reset_draws), games)
            elapsed[games] = 0
            for kept, word in zip(begun, ours.words, strict=True):
                kept[games] = word[games]
            oracle.pose(games, ours.values(games))
            judge.compare(ours, Outcome(), oracle.look(games), games, lambda game: "at the start")


class _Judge:
    """Compares what both show."""

    def __init__(self, spec: EnvSpec, tolerance: float | Mapping[str, float]) -> None:
        self.spec, self.tolerance = spec, tolerance

    def compare(
        self, ours: Ours, mine: Outcome, theirs: Outcome, games: Array, where: Callable[[int], str]
    ) -> dict[str, Array]:
        """Compare what the oracle says of some games; return how much each number differs."""
        spec, errors = self.spec, dict[str, Array]()
        undecided = np.broadcast_to(theirs.undecided, len(games))

        def one(name: str, own: Array, due: Any, dtype: Any = np.float64, known: Any = False) -> None:
            own, due = (np.asarray(part).reshape(len(games), -1, *own.shape[2:]) for part in (own, due))
            due = due.reshape(own.shape)
            limit = self._limit(name)
            if limit:
                error = np.abs(own.astype(np.float64) - due)
                wrong = error > limit
            else:
                wrong = own.astype(dtype) != (due.astype(dtype) if np.dtype(dtype).kind == "f" else due)
                if due.dtype.kind == "f":
                    wrong &= ~np.isnan(due)
                error = wrong.astype(np.float64)
            wrong[known], error[known] = False, 0.0
            errors[name] = error
            if wrong.any():
                at = tuple(np.argwhere(wrong)[0].tolist())
                raise DifferenceError(
                    f"{where(int(games[at[0]]))}: {_name(spec, name, *at[1:])} is {float(own[at]):.9g}, the "
                    f"original's {float(due[at]):.9g}"
                )

        if theirs.rewards is not None and mine.rewards is not None:
            one("reward", mine.rewards, theirs.rewards, np.float32, undecided)
        if theirs.terminated is not None and mine.terminated is not None:
            one("terminated", mine.terminated, theirs.terminated, known=undecided)
        if theirs.truncated is not None and mine.truncated is not None:
            one("truncated", mine.truncated[:, None], theirs.truncated, known=undecided)
        for name, due in (theirs.state or {}).items():
            field = spec.state[[f.name for f in spec.state].index(name)]
            word = ours.words[spec.state.index(field)][games]
            one(name, (word * 2.0**-field.fraction if field.fraction else word)[:, None], due)
        if theirs.observations is not None:
            one("observation", ours.observations()[games], theirs.observations, spec.observation_dtype)
        if theirs.masks is not None:
            one("mask", ours.masks()[games], theirs.masks, np.bool_)
        return errors

    def _limit(self, name: str) -> float:
        given = self.tolerance
        return given.get(name, 0.0) if isinstance(given, Mapping) else given


def numbers(spec: EnvSpec, outcome: Outcome) -> dict[str, Array]:
    """Return rewards, ends, observations and states of many games by their names, a column a number."""
    columns = dict[str, Array]()
    shown = {"reward": outcome.rewards, "terminated": outcome.terminated, "observation": outcome.observations}
    for what, values in shown.items():
        if values is not None:
            table = np.asarray(values, np.float64)
            table = table.reshape(len(table), spec.agents, -1)
            for at in np.ndindex(table.shape[1:]):
                columns[_name(spec, what, *at)] = table[:, *at]
    for name, column in (outcome.state or {}).items():
        columns[name] = np.asarray(column, np.float64)
    return columns


def _name(spec: EnvSpec, what: str, agent: int, element: int = 0) -> str:
    """Return what a number is called."""
    name = what
    if what == "observation":
        name = f"element {element}" if spec.unpack is not None else spec.observation[element].name
    elif what == "mask":
        name = f"mask {element}"
    if spec.agents == 1 or what not in ("reward", "terminated", "observation", "mask"):
        return name
    return f"{name} of {agent}" if name != what else f"{name} {agent}"


def named(spec: EnvSpec, words: Sequence[Any]) -> str:
    """Return a state as a message names it."""
    pairs = [f"{f.name}={f.value(word)}" for f, word in zip(spec.state, words, strict=True)]
    return ", ".join(pairs if len(pairs) <= 12 else [*pairs[:12], "..."])


OFTEN = 0.1
"""The share of an outcome that has to be on both sides."""


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


def unlike_outcomes(
    spec: EnvSpec,
    words: Sequence[Any],
    actions: Any,
    theirs: Outcome,
    generator: np.random.Generator,
    tolerance: float = 0.0,
) -> str | None:
    """Compare outcomes of one step with draws: what happens often on one side happens on the other.

    Parameters
    ----------
    spec, words, actions
        The environment, the state that the step is from, and the actions of all agents.
    theirs
        What the original came to, time after time; of observations and states, what it says is compared.
    generator
        Of our draws, for as many outcomes.
    tolerance
        By how much numbers of the same outcome may differ.
    """
    n = len(theirs.rewards)
    ours = Ours(spec, n)
    ours.words = [np.full(n, word, field.dtype) for word, field in zip(words, spec.state, strict=True)]
    own = ours.step(np.stack([actions] * n), uniform_draws(generator, n, spec.step_draws))
    if theirs.observations is not None:
        own = own._replace(observations=ours.observations())
    if theirs.state is not None:
        names = (field.name for field in spec.state)
        own = own._replace(state=dict(zip(names, ours.values(), strict=True)))
    mine, due = numbers(spec, own), numbers(spec, theirs)
    said = [name for name, column in due.items() if not np.isnan(column).any()]

    def counted(columns: dict[str, Array]) -> Counter[Any]:
        return Counter(map(tuple, np.stack([columns[name] for name in said], 1).tolist()))

    def close(one: Sequence[float], two: Sequence[float]) -> bool:
        return float(np.abs(np.subtract(one, two)).max()) <= tolerance

    unlike = first_unlike(counted(mine), counted(due), close if tolerance else None)
    if unlike is None:
        return None
    result, share, right = unlike
    told = ", ".join(f"{name} {x:g}" for name, x in zip(said, result, strict=True))
    return (
        f"from {named(spec, words)} by action {np.ravel(actions).tolist()}: {told} has a "
        f"share of {share:.2f}, the original's is {right:.2f}"
    )
