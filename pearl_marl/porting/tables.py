"""The tables of a finite original: as a module writes them, and held against the original again."""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Iterable, Sequence
from itertools import islice, pairwise
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.golden import call_reference
from pearl_marl.porting.finite import PROBABILITY_ERROR, Finite, NotFiniteError, Transition, finite, merged
from pearl_marl.porting.oracle import Ours
from pearl_marl.porting.originals import Original
from pearl_marl.spec import EnvSpec

ALL = 1 << 32
"""Draws are below it."""

IN_TEXT = 20_000
"""Entries that are written as Python; of more there is a file of NumPy's."""

SIDE_BY_SIDE = 8
"""Outcomes that hardware compares a draw with at once; of more it searches by halves."""

MOST_FRACTION = 24

MOST_CUTS = 64
"""Draws at which outcomes change, up to which every row is tried around all of them; then around its own."""


class Tables(NamedTuple):
    """What a golden step looks into."""

    rewards: tuple[float, ...]
    outcomes: int
    """How many entries a row has: one for each outcome of an action in a state."""
    after: tuple[int, ...]
    reward: tuple[int, ...]
    terminated: tuple[int, ...]
    least: tuple[tuple[int, ...], ...]
    """The least draw of each outcome but the first, for each of the kinds of chances that rows have."""
    chances: tuple[int, ...]
    """The kind of each row."""
    starts: tuple[int, ...]
    start_least: tuple[int, ...] | None
    """The least draw of each start but the first; ``None`` where all are alike."""
    observations: tuple[tuple[int, ...], ...] | None
    """The words of each state's observation; ``None`` where that is its number."""
    fraction: int
    """Bits of those behind the binary point."""


def tables(found: Finite) -> Tables:
    """Return the tables of an environment.

    Raises
    ------
    NotFiniteError
        They would be larger, or of finer numbers, than tables can be.
    """
    rewards: dict[float, int] = {}
    kinds: dict[tuple[int, ...], int] = {}
    rows = [outcomes for actions in found.rows for outcomes in actions]
    width = found.width
    for outcomes in rows:
        for outcome in outcomes:
            rewards.setdefault(outcome.reward, len(rewards))
        if len(outcomes) > 1:
            kinds.setdefault(_least([t.probability for t in outcomes]), len(kinds))
    if len(rewards) > 1 << 16:
        raise NotFiniteError(f"it has {len(rewards):,} different rewards, and a table takes 65,536")
    flat: list[Transition] = []
    chances = []
    for outcomes in rows:
        # Of one outcome every entry is the same, and then any kind does.
        chances.append(kinds[_least([t.probability for t in outcomes])] if len(outcomes) > 1 else 0)
        flat += [*outcomes, *[outcomes[-1]] * (width - len(outcomes))]
    shares = [p for p, _ in found.starts]
    alike = max(shares) - min(shares) < 1e-12
    return Tables(
        tuple(rewards),
        width,
        tuple(t.after for t in flat),
        tuple(rewards[t.reward] for t in flat),
        tuple(int(t.terminated) for t in flat),
        tuple(kinds),
        tuple(chances),
        tuple(state for _, state in found.starts),
        None if alike else _least(shares),
        *_observation_words(found),
    )


def _least(shares: Sequence[float]) -> tuple[int, ...]:
    total = math.fsum(shares)
    return tuple(round(math.fsum(shares[:k]) / total * ALL) for k in range(1, len(shares)))


def _observation_words(found: Finite) -> tuple[tuple[tuple[int, ...], ...] | None, int]:
    seen = np.array(found.observations)
    if not np.isfinite(seen).all():
        raise NotFiniteError("its observations are not all finite")
    if seen.shape[1] == 1 and np.array_equal(seen[:, 0], np.arange(len(seen))):
        return None, 0
    for fraction in range(MOST_FRACTION + 1):
        scaled = np.ldexp(seen, fraction)
        if np.array_equal(scaled, np.rint(scaled)) and np.abs(scaled).max() < 2**62:
            return tuple(map(tuple, scaled.astype(np.int64).tolist())), fraction
    first = next(value for value in seen.ravel() if np.ldexp(value, MOST_FRACTION) % 1)
    raise NotFiniteError(
        f"it shows numbers such as {first:g}, which take more than {MOST_FRACTION} bits behind the point"
    )


# ---- As a module ----


class Written(NamedTuple):
    """A module of tables, and the file of NumPy's beside it, if they are many."""

    text: str
    arrays: bytes | None
    names: tuple[str, ...]
    """What of it a step needs, beyond the rewards."""


def written(made: Tables, name: str, source: str) -> Written:
    """Return the module of tables of an environment called ``name``."""
    padded = padded_size(made)
    columns: list[tuple[str, str, Any]] = [
        ("NEXT", "The state after", made.after),
        ("REWARD", "The category of the reward", made.reward),
        ("TERMINATED", "Whether the episode ends", made.terminated),
    ]
    if len(made.starts) > 1:
        columns.append(("STARTS", "States that episodes begin in", made.starts))
    if made.start_least is not None:
        size = 1 << (len(made.starts) - 1).bit_length()
        columns.append(("START_LEAST", "The least draw of each start", _filled((0, *made.start_least), size)))
    if side_by_side(made):
        columns.append(("LEAST", "The least draw of each outcome but the first", made.least[0]))
    elif made.outcomes > 1:
        least = tuple(word for kind in made.least for word in _filled((0, *kind), padded))
        columns.append(("LEAST", f"The least draw of each outcome, {padded} for each kind of chances", least))
        if len(made.least) > 1:
            columns.append(("CHANCES", "The kind of chances of each row", made.chances))
    if made.observations is not None:
        one = len(made.observations[0]) == 1
        observations: Any = tuple(row[0] for row in made.observations) if one else made.observations
        columns.append(("OBSERVATIONS", "The observation in each state", observations))
    entries = sum(np.size(values) for _, _, values in columns)
    large = entries > IN_TEXT
    parts = [f'"""The tables of {name}: what {source} does in every state, written by `pearl new`.\n']
    parts.append("A row is `ACTIONS * state + action`, and has an entry for each outcome.")
    parts.append('"""\n\n# fmt: off\n')
    if large:
        parts.append("from pathlib import Path\n\nimport numpy as np\n")
        parts.append('with np.load(Path(__file__).with_name("tables.npz")) as _arrays:')
        parts.append("    _tables = {name: array.tolist() for name, array in _arrays.items()}\n")
    parts.append(_assignment("REWARDS", "tuple[float, ...]", made.rewards))
    parts.append('"""The reward of each category."""\n')
    for column, meaning, values in columns:
        nested = isinstance(values[0], tuple)
        kind = "tuple[tuple[int, ...], ...]" if nested else "tuple[int, ...]"
        if large:
            read = f'tuple(map(tuple, _tables["{column}"]))' if nested else f'tuple(_tables["{column}"])'
            parts.append(f"{column}: {kind} = {read}")
        else:
            parts.append(_assignment(column, kind, values))
        parts.append(f'"""{meaning}."""\n')
    file = None
    if large:
        stream = io.BytesIO()
        np.savez_compressed(stream, **{column: _narrow(values) for column, _, values in columns})  # type: ignore[arg-type]
        file = stream.getvalue()
    return Written("\n".join(parts), file, tuple(sorted((column for column, _, _ in columns), key=str.lower)))


def side_by_side(made: Tables) -> bool:
    """Return whether a draw is compared with all outcomes at once: there are few, everywhere as likely."""
    return len(made.least) == 1 and made.outcomes <= SIDE_BY_SIDE


def padded_size(made: Tables) -> int:
    """Return how many entries a kind of chances has in the module: a power of two."""
    return 1 << (made.outcomes - 1).bit_length()


def _filled(least: Sequence[int], size: int) -> tuple[int, ...]:
    """Return least draws with those of outcomes that never come, up to a size."""
    return (*least, *[ALL] * (size - len(least)))


def _narrow(values: Any) -> np.ndarray[Any, Any]:
    array = np.array(values)
    low, high = int(array.min()), int(array.max())
    return array.astype(np.result_type(np.min_scalar_type(low), np.min_scalar_type(high)))


def _assignment(name: str, kind: str, values: Sequence[Any]) -> str:
    """Return a tuple as ruff formats it, but as many numbers a line as fit."""
    listed = ", ".join(map(repr, values))
    lines = [f"    {listed},"]
    if values and isinstance(values[0], tuple):
        lines = [f"    {value!r}," for value in values]
    elif len(whole := f"{name}: {kind} = ({listed}{',' if len(values) == 1 else ''})") <= 110:
        return whole
    wrapped = (part for line in lines for part in textwrap.wrap(line, 110, subsequent_indent="    "))
    return "\n".join([f"{name}: {kind} = (", *wrapped, ")"])


# ---- Held against the original ----


def first_wrong_transition(spec: EnvSpec, original: Original) -> str | None:
    """Compare all transitions of an environment made of tables with its original's; return what differs.

    The original is run in every state again. Probabilities may differ by less than ``2**-31``.
    """
    found = finite(original)
    rewards = np.array(spec.rewards or (0.0,))
    rows = [(state, action) for state in range(found.states) for action in range(len(found.rows[0]))]
    least = [_least([t.probability for t in found.rows[state][action]]) for state, action in rows]
    every = sorted({cut for cuts in least for cut in cuts})
    points = [_points(every if len(every) <= MOST_CUTS else cuts) for cuts in least]
    lengths = [len(of_row) for of_row in points]
    states, actions = (np.repeat(column, lengths) for column in np.array(rows).T)
    draws = np.concatenate(points)
    words = call_reference(spec.positional.step, (states, actions, *[draws] * spec.step_draws))
    after, category, ends = (np.broadcast_to(word, len(draws)) for word in words)
    outcomes = zip(after.tolist(), rewards[category].tolist(), map(bool, ends), strict=True)
    for (state, action), of_row in zip(rows, points, strict=True):
        got = _shares(list(islice(outcomes, len(of_row))), of_row)
        wrong = _compared(got, merged(found.rows[state][action]))
        if wrong:
            return f"state {state}, action {action}: {wrong}"
    cuts = _points(_least([p for p, _ in found.starts]))
    (begun,) = call_reference(spec.positional.initial, [np.array(cuts)] * spec.reset_draws)
    got = _shares([(int(state),) for state in np.broadcast_to(begun, len(cuts))], cuts)
    wrong = _compared(got, {(state,): p for p, state in found.starts})
    if wrong:
        return f"the start of an episode: {wrong}"
    return _wrong_observation(spec, found)


def _wrong_observation(spec: EnvSpec, found: Finite) -> str | None:
    ours = Ours(spec, found.states)
    ours.words = [np.arange(found.states)]
    seen = ours.observations()[:, 0]
    wrong = np.flatnonzero((seen != np.array(found.observations)).any(1))
    if not wrong.size:
        return None
    state = int(wrong[0])
    own, due = tuple(map(float, seen[state])), found.observations[state]
    return f"state {state}: observed is {own}, the original's {due}"


def _points(cuts: Iterable[int]) -> list[int]:
    """Return draws around every cut: both ends of each interval in which the outcome stays."""
    edges = sorted({0, ALL, *(min(max(c + d, 0), ALL) for c in cuts for d in (-1, 0, 1))})
    return [point for low, high in pairwise(edges) for point in (low, high - 1)]


def _shares(outcomes: Sequence[Any], points: Sequence[int]) -> dict[Any, float]:
    """Return the probability of each outcome, given those at both ends of each interval of draws."""
    result: dict[Any, float] = {}
    for k, outcome in enumerate(outcomes):  # those of both ends count by half
        first = k - k % 2
        half = (points[first + 1] - points[first] + 1) / 2
        result[outcome] = result.get(outcome, 0.0) + half / ALL
    return result


def _compared(ours: dict[Any, float], theirs: dict[Any, float]) -> str | None:
    for outcome in {**theirs, **ours}:
        got, due = ours.get(outcome, 0.0), theirs.get(outcome, 0.0)
        if abs(got - due) >= PROBABILITY_ERROR:
            told = " and ".join(map(str, (f"to {outcome[0]}", *outcome[1:])))
            return f"{told} has probability {got:.10g}, the original's is {due:.10g}"
    return None
