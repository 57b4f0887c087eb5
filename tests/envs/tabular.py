"""What the tests of environments share whose oracle has a table ``P`` of all transitions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl import EnvSpec
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.porting.oracle import Outcome, Rules, compare

Array = npt.NDArray[Any]


class Table(NamedTuple):
    """Gymnasium's ``P`` as arrays ``(states, actions, outcomes)``, padded with impossible outcomes."""

    probability: Array
    state: Array
    reward: Array
    terminated: Array


def table_of(oracle: Any) -> Table:
    rows = [[oracle.P[s][a] for a in sorted(oracle.P[s])] for s in sorted(oracle.P)]
    most = max(len(outcomes) for row in rows for outcomes in row)
    padded = [
        [outcomes + [(0.0, 0, 0.0, False)] * (most - len(outcomes)) for outcomes in row] for row in rows
    ]
    probability, state, reward, terminated = np.moveaxis(np.array(padded, float), -1, 0)
    return Table(probability, state.astype(int), reward, terminated.astype(bool))


def table_oracle(
    oracle: Any, number: Callable[[list[Array]], Array], outcome: Callable[[Array], Array]
) -> Rules:
    """Return a step by ``P``: of the number of a state, and of the outcome that draws decide on."""
    table = table_of(oracle)

    def step(state: list[Array], actions: Array, draws: Array) -> Outcome:
        which = number(state), actions[:, 0], outcome(draws)
        return Outcome(table.state[which], table.reward[which], table.terminated[which])

    return Rules(step)


def compare_draws(
    spec: EnvSpec, oracle: Rules, words: list[Array], actions: Array, draws: Iterable[int]
) -> None:
    """Compare steps from all these states by each of these draws."""
    for draw in draws:
        n = len(actions)
        drawn = np.full((n, spec.step_draws), draw)
        for _ in compare(spec, oracle, n, state=words, actions=actions, draws=lambda *_, d=drawn: d):
            pass


def first_observations(spec: EnvSpec, n: int, seed: int) -> Array:
    opened = Native().open(BatchConfig(spec=spec, n_envs=n))
    observations = opened.reset(seed=seed)
    opened.close()
    return observations


def table_episodes(oracle: Any, n: int, seed: int, policy: Any, limit: int) -> tuple[Array, Array]:
    """Return the same of the oracle, whose ``step`` does nothing but draw from ``P``, all at once."""
    table = table_of(oracle)
    cumulated = table.probability.cumsum(axis=2)
    generator = np.random.default_rng(seed)
    states = generator.choice(len(cumulated), size=n, p=oracle.initial_state_distrib)
    lengths, returns, running = np.zeros(n, int), np.zeros(n), np.arange(n)
    for _ in range(limit):
        actions = policy(states, generator)
        drawn = generator.random(len(states))[:, None]
        which = (states, actions, (cumulated[states, actions] > drawn).argmax(axis=1))
        lengths[running] += 1
        returns[running] += table.reward[which]
        goes_on = ~table.terminated[which]
        states, running = table.state[which][goes_on], running[goes_on]
        if not len(running):
            break
    return lengths, returns
