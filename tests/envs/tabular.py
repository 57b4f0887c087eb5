"""What the tests of environments share.

Statistics of an option are taken on the reference: a kernel takes longer to compile than that to step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl import EnvSpec
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.batch.step import BatchStep
from pearl_marl.devices import BatchConfig, Native

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


def step_from(spec: EnvSpec, fields: list[Array], actions: Array, seed: int = 0) -> BatchStep:
    """Put slots into the states whose fields are given, and step them once."""
    n = len(actions)
    opened = Native().open(BatchConfig(spec=spec, n_envs=n))
    opened.reset(seed=seed)
    snapshot = opened.snapshot()
    columns = SlotMemory(spec, n, snapshot.memory).columns
    for k, values in enumerate(fields):
        columns[spec.state[k].name][:] = values
    opened.restore(snapshot)
    step = opened.step(actions)
    opened.close()
    return step


def first_observations(spec: EnvSpec, n: int, seed: int) -> Array:
    opened = Native().open(BatchConfig(spec=spec, n_envs=n))
    observations = opened.reset(seed=seed)
    opened.close()
    return observations


def first_episodes(spec: EnvSpec, n: int, seed: int, policy: Any) -> tuple[Array, Array]:
    """Return length and return of the first episode of ``n`` slots; ``policy(obs, generator)`` acts."""
    opened = Native().open(BatchConfig(spec=spec, n_envs=n, copy=False))
    observations = opened.reset(seed=seed)
    generator = np.random.default_rng(seed + 1)
    lengths, returns, running = np.zeros(n, int), np.zeros(n), np.ones(n, bool)
    while running.any():
        step = opened.step(policy(observations, generator))
        lengths += running
        returns += np.where(running, step.rewards, 0)
        running &= ~step.ended
        observations = step.obs
    opened.close()
    return lengths, returns


def table_episodes(oracle: Any, n: int, seed: int, policy: Any, limit: int) -> tuple[Array, Array]:
    """Return the same of the oracle, whose ``step`` does nothing but draw from ``P``, all at once."""
    table = table_of(oracle)
    cumulated = table.probability.cumsum(axis=2)
    generator = np.random.default_rng(seed)
    states = generator.choice(len(cumulated), size=n, p=oracle.initial_state_distrib)
    lengths, returns, running = np.zeros(n, int), np.zeros(n), np.ones(n, bool)
    while running.any():
        actions = policy(states, generator)
        drawn = generator.random(n)[:, None]
        which = (states, actions, (cumulated[states, actions] > drawn).argmax(axis=1))
        lengths += running
        returns += np.where(running, table.reward[which], 0)
        running &= ~table.terminated[which] & (lengths < limit)
        states = table.state[which]
    return lengths, returns
