"""All transitions of an original that has few states: of its own table ``P``, or found by running it.

To find them, its random numbers are replaced by :class:`Ways`, which goes through all ways they can fall.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Hashable, Iterable, Iterator
from itertools import islice
from typing import Any, NamedTuple, NoReturn

import numpy as np
from gymnasium.spaces import Discrete

from pearl_marl.errors import PearlError
from pearl_marl.porting.contents import elements, frozen, replaced
from pearl_marl.porting.originals import Original

MOST_STATES = 1 << 16
MOST_ENTRIES = 1 << 19
"""Entries of a table: a compiler takes a minute for them."""
MOST_WAYS = 1 << 12
"""Ways that the draws of one step can fall."""
MOST_STARTS = 1 << 16
"""And those of a reset."""
SECONDS = 120.0
"""How long it may take to find the states."""
RUNS, RUN_STEPS = 20, 100
"""Episodes of the original, and their steps, that tables are held against."""
PROBABILITY_ERROR = 2.0**-31
"""What tables make of a probability is off by less."""


class Transition(NamedTuple):
    """One outcome of an action in a state."""

    probability: float
    after: int
    reward: float
    terminated: bool


class Finite(NamedTuple):
    """A whole environment."""

    starts: tuple[tuple[float, int], ...]
    """Probabilities of the states that an episode begins in."""
    rows: tuple[tuple[tuple[Transition, ...], ...], ...]
    """The transitions of each state and action; of a state that ends an episode, one to itself."""
    observations: tuple[tuple[float, ...], ...]
    """What is observed in each state, element by element."""
    of_table: bool
    """Whether it is of the original's own ``P``, whose states are its observations."""

    @property
    def states(self) -> int:
        """How many states there are."""
        return len(self.rows)

    @property
    def width(self) -> int:
        """The most outcomes of an action."""
        return max(len(outcomes) for actions in self.rows for outcomes in actions)


class NotFiniteError(PearlError, ValueError):
    """Why no tables can be made, as a sentence."""


def finite(original: Original) -> Finite:
    """Return all transitions of an original.

    Raises
    ------
    NotFiniteError
        It has too many states, or what it does cannot be told by running it.
    """
    if original.agents > 1:
        raise NotFiniteError(f"tables are made for one agent, and it has {original.agents}")
    if not isinstance(original.action_space, Discrete):
        raise NotFiniteError(f"tables are made for a Discrete, and its actions are a {original.action_space}")
    table = getattr(original.env, "P", None)
    if isinstance(original.observation_space, Discrete) and table is not None:
        result = _of_table(original, table)
        _hold(original, result, lambda run: int(run.observations[0]), "which its P does not list")
    else:
        result = _Search(original).run()
    size = result.states * len(result.rows[0]) * result.width
    seen = result.states * len(result.observations[0])
    if max(size, seen) > MOST_ENTRIES:
        raise NotFiniteError(
            f"its {result.states:,} states make tables of {max(size, seen):,} entries, above {MOST_ENTRIES:,}"
        )
    return result


def merged(outcomes: Iterable[Transition]) -> dict[tuple[int, float, bool], float]:
    """Return the probability of each outcome, once each."""
    result: dict[tuple[int, float, bool], float] = {}
    for probability, *what in outcomes:
        key = (int(what[0]), float(what[1]), bool(what[2]))
        result[key] = result.get(key, 0.0) + probability
    return result


# ---- An original's own table ----


def _of_table(original: Original, table: Any) -> Finite:
    n = len(table)
    states = range(n)
    space, action_space = original.observation_space, original.action_space
    assert isinstance(space, Discrete)
    assert isinstance(action_space, Discrete)
    if n != space.n or space.start != 0:
        raise NotFiniteError(f"its P has {n} states and {space} has others")
    if n > MOST_STATES:
        raise NotFiniteError(f"its P has {n:,} states, and tables take {MOST_STATES:,}")
    rows = []
    for state in states:
        actions = []
        for action in range(int(action_space.n)):
            try:
                listed = [
                    Transition(float(p), int(after), float(reward), bool(ends))
                    for p, after, reward, ends in table[state][action]
                    if p > 0
                ]
            except (KeyError, IndexError, TypeError, ValueError):
                raise NotFiniteError(
                    f"its P[{state}][{action}] is no list of (probability, next state, reward, terminated)"
                ) from None
            total = sum(t.probability for t in listed)
            if not listed or abs(total - 1) > 1e-6 or any(not 0 <= t.after < n for t in listed):
                raise NotFiniteError(f"the probabilities of its P[{state}][{action}] make {total}")
            if len(merged(listed)) == 1:
                listed = listed[:1]
                total = listed[0].probability
            actions.append(tuple(t._replace(probability=t.probability / total) for t in listed))
        rows.append(tuple(actions))
    shares = getattr(original.env, "initial_state_distrib", getattr(original.env, "isd", None))
    if shares is None:
        firsts = {int(original.reset(seed)[0]) for seed in range(RUNS)}
        if len(firsts) > 1:
            raise NotFiniteError("it has a P, but no initial_state_distrib that says where episodes begin")
        shares = [float(state in firsts) for state in states]
    if len(shares) != n:
        raise NotFiniteError(f"its initial_state_distrib has {len(shares)} entries for {n} states")
    total = float(sum(shares))
    starts = tuple((float(shares[state]) / total, state) for state in states if shares[state] > 0)
    return Finite(starts, tuple(rows), tuple((float(state),) for state in states), of_table=True)


def _hold(original: Original, found: Finite, number_of: Callable[[Original], int | None], why: str) -> None:
    """Refuse what is not what the original does, run by seeds: it may draw, or keep a state, elsewhere."""
    firsts = {state for _, state in found.starts}
    rng = np.random.default_rng(0)
    for seed in range(RUNS):
        run = original.copied()
        run.reset(seed)
        state = number_of(run)
        if state not in firsts:
            raise NotFiniteError(f"an episode begins in {_state(state)}, {why}")
        for (action,) in islice(run.habits(rng, seed), RUN_STEPS):
            outcome = run.step([action])
            after = number_of(run)
            assert state is not None
            if (after, outcome.rewards[0], outcome.terminated[0]) not in merged(found.rows[state][action]):
                raise NotFiniteError(
                    f"its step() goes from state {state} by action {action} to {_state(after)} with reward "
                    f"{outcome.rewards[0]}, {why}"
                )
            if outcome.over:
                break
            state = after


def _count(size: Any) -> int:
    """Return how many numbers an array of a size has, as NumPy takes sizes; ``None`` is one number."""
    return math.prod(np.atleast_1d(1 if size is None else size).tolist())


def _state(number: int | None) -> str:
    return "a state that was not found" if number is None else f"state {number}"


# ---- Running it in every state ----


class _RealDrawError(Exception):
    """A draw that has too many outcomes to go through."""


class Ways:
    """Random numbers that fall every way, one after the other: see :meth:`all`."""

    makes_random_numbers = True
    bit_generator = None

    def __init__(self) -> None:
        self._script: list[list[Any]] = []
        self._asked = 0
        self.probability = 1.0

    def all(self, most: int) -> Iterator[None]:
        """Yield once for each way; the draws after each yield are that way's."""
        for _ in range(most):
            self._asked, self.probability = 0, 1.0
            yield
            while self._script and self._script[-1][0] + 1 >= len(self._script[-1][1]):
                self._script.pop()
            if not self._script:
                return
            self._script[-1][0] += 1
        raise NotFiniteError(f"its random numbers fall in more than {most:,} ways in one step")

    def _choose(self, shares: list[float]) -> int:
        possible = [k for k, share in enumerate(shares) if share > 0]
        if self._asked == len(self._script):
            if len(possible) > MOST_WAYS:
                raise _RealDrawError("integers() of so many outcomes")
            self._script.append([0, possible])
        place, outcomes = self._script[self._asked]
        self._asked += 1
        self.probability *= shares[outcomes[place]]
        return int(outcomes[place])

    def _below(self, n: int) -> int:
        return self._choose([1 / n] * n) if n <= MOST_WAYS else self._real("integers() of so many outcomes")

    def _real(self, what: str) -> NoReturn:
        raise _RealDrawError(what)

    def integers(
        self, low: Any, high: Any = None, size: Any = None, dtype: Any = None, endpoint: bool = False
    ) -> Any:
        """Return one of a range, as NumPy's generator does, or an array of such."""
        low, high = (0, low) if high is None else (low, high)
        if np.ndim(low) or np.ndim(high):
            self._real("integers() of arrays")
        count = int(high) - int(low) + endpoint
        numbers = (int(low) + self._below(count) for _ in range(_count(size)))
        return next(numbers) if size is None else np.array([*numbers], dtype or np.int64).reshape(size)

    randint = integers

    def choice(self, a: Any, size: Any = None, replace: bool = True, p: Any = None, **other: Any) -> Any:
        """Return one of several, as NumPy's generator does, or an array of such."""
        options = list(range(a)) if np.ndim(a) == 0 else list(a)
        shares = [1 / len(options)] * len(options) if p is None else [float(share) for share in p]
        if size is None:
            return options[self._distinct(options, shares)]
        taken = []
        for _ in range(_count(size)):
            k = self._choose(shares)
            taken.append(options[k])
            if not replace:
                del options[k], shares[k]
                total = sum(shares)
                shares = [share / total for share in shares] if total else shares
        return np.array(taken).reshape(size)

    def _distinct(self, options: list[Any], shares: list[float]) -> int:
        """Choose among options; of equal ones the first stands for all."""
        first: dict[Hashable, int] = {}
        together = [0.0] * len(options)
        for k, (option, share) in enumerate(zip(options, shares, strict=True)):
            together[first.setdefault(frozen(option), k)] += share
        return self._choose(together)

    def permutation(self, x: Any) -> Any:
        """Return numbers, or a copy of an array, in any order."""
        options = list(range(x)) if np.ndim(x) == 0 else list(x)
        self.shuffle(options)
        return np.array(options)

    def shuffle(self, x: Any) -> None:
        """Put a list into any order, in place."""
        for k in range(len(x) - 1, 0, -1):
            other = self._below(k + 1)
            x[k], x[other] = x[other], x[k]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *_, **__: self._real(f"{name}()")

    def __deepcopy__(self, memo: Any) -> Ways:
        return self


class _Search:
    """Breadth-first over all states that can be reached."""

    def __init__(self, original: Original) -> None:
        self._original = original
        self._numbers: dict[Hashable, int] = {}
        self._at: list[Original | None] = []
        self._observations: list[tuple[float, ...]] = []
        self._continued: list[bool] = []
        self._until = time.monotonic() + SECONDS

    def run(self) -> Finite:
        self._original.reset(seed=0)
        try:
            starts = merged(
                Transition(p, self._number(there, there.observations[0], False), 0, False)
                for there, p, _ in self._ways(self._original, None, MOST_STARTS)
            )
            rows = self._expand()
        except _RealDrawError as error:
            raise NotFiniteError(
                f"it draws by {error}, whose outcomes cannot all be gone through ({self._found()})"
            ) from None
        result = Finite(
            tuple((p, state) for (state, _, _), p in starts.items()),
            rows,
            tuple(self._observations),
            of_table=False,
        )
        why = "which running it did not show: it has random numbers, or a state, elsewhere than in attributes"
        _hold(self._original, result, lambda run: self._numbers.get(frozen(run.env)), why)
        return result

    def _found(self) -> str:
        return f"{len(self._at):,} states found"

    def _expand(self) -> tuple[tuple[tuple[Transition, ...], ...], ...]:
        space = self._original.action_space
        assert isinstance(space, Discrete)
        rows: dict[int, tuple[tuple[Transition, ...], ...]] = {}
        waiting = list(range(len(self._at)))
        for state in waiting:  # which grows
            here = self._at[state]
            if here is None or not self._continued[state]:
                continue
            actions = []
            for action in range(int(space.n)):
                outcomes = []
                for after, probability, outcome in self._ways(here, action, MOST_WAYS):
                    known = len(self._at)
                    number = self._number(after, outcome.observations[0], outcome.over)
                    if number == known or not outcome.over:
                        waiting.append(number)
                    outcomes.append(
                        Transition(probability, number, outcome.rewards[0], outcome.terminated[0])
                    )
                actions.append(tuple(Transition(p, *what) for what, p in merged(outcomes).items()))
            rows[state] = tuple(actions)
            self._at[state] = None  # its copies are in the others
        reward = next((t.reward for row in rows.values() for t in row[0]), 0.0)
        return tuple(
            rows.get(k) or ((Transition(1.0, k, reward, True),),) * int(space.n) for k in range(len(self._at))
        )

    def _ways(self, here: Original, action: int | None, most: int) -> Iterator[Any]:
        ways = Ways()
        for _ in ways.all(most):
            if time.monotonic() > self._until:
                raise NotFiniteError(
                    f"after {SECONDS:.0f} seconds there were still new states ({self._found()})"
                )
            there = here.copied()
            replaced(there.env, lambda old: ways)
            outcome = None
            if action is None:
                there.reset()
            else:
                outcome = there.step([action])
                if outcome.truncated:
                    raise NotFiniteError(
                        "its step() truncates episodes by itself, which is `max_cycles` here: make it "
                        f"without a limit of its own ({self._found()})"
                    )
            yield there, ways.probability, outcome

    def _number(self, original: Original, seen: Any, over: bool) -> int:
        key = frozen(original.env)
        number = self._numbers.setdefault(key, len(self._at))
        if number == len(self._at):
            if number >= MOST_STATES:
                raise NotFiniteError(
                    f"it has too many states for tables: {number:,} were found before giving up"
                )
            self._at.append(original)
            self._observations.append(elements(seen))
            self._continued.append(False)
        self._continued[number] |= not over
        return number
