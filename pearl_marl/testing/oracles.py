"""An environment beside its oracle: posed and stepped, in whole episodes, in random play, and in pictures.

:func:`~pearl_marl.porting.oracle.compare` steps the two side by side. What tests ask for besides is here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.devices import BatchConfig, BatchStep, Native
from pearl_marl.golden import rng
from pearl_marl.interfaces.parallel import parallel_env
from pearl_marl.porting.oracle import Actions, Move, Oracle, Ours, any_actions, compare
from pearl_marl.spec import EnvSpec

Policy = Callable[[Array, np.random.Generator], Array]
"""Chooses an action for each row of observations."""

LIKELY = 0.001
"""Of two samples of one distribution, how rarely a test may say that they are of two."""


def every_state(spec: EnvSpec) -> list[Array]:
    """Return all states that fields can hold with all actions: columns of words, and last one of actions."""
    words = [range(low, high + 1) for low, high in (f.range for f in spec.state)]
    return list(np.array(list(product(*words, *map(range, spec.action_counts)))).T)


def step_from(spec: EnvSpec, words: Sequence[Array], actions: Array, seed: int = 0) -> BatchStep:
    """Put slots of the CPU device into states, a column of words for each field, and step them once."""
    n = len(words[0])
    device = Native().open(BatchConfig(spec=spec, n_envs=n))
    device.reset(seed=seed)
    snapshot = device.snapshot()
    columns = SlotMemory(spec, n, snapshot.memory).columns
    for field, values in zip(spec.state, words, strict=True):
        columns[field.name][:] = values
    device.restore(snapshot)
    step = device.step(actions)
    device.close()
    return step


def compare_steps(
    spec: EnvSpec,
    oracle: Oracle,
    words: Sequence[Array],
    actions: Array | Actions = any_actions,
    tolerance: float | Mapping[str, float] = 0.0,
    seed: int = 0,
) -> Move:
    """Step golden functions, an oracle and the CPU device once from many states, and compare all three.

    Prints the greatest error of each number, which ``pytest -rP`` shows.

    Parameters
    ----------
    spec, oracle, actions, tolerance
        As :func:`~pearl_marl.porting.oracle.compare` takes them.
    words
        The states, a column for each field.
    seed
        Of the actions, and of the draws, which are the device's.
    """
    n = len(words[0])

    def draws(generator: np.random.Generator, n: int, count: int) -> Array:
        first, made = spec.reset_draws, rng.seed_words(seed)
        columns = [rng.draws(made, np.arange(n), 0, first + k).astype(np.int64) for k in range(count)]
        return np.stack(columns, 1) if columns else np.zeros((n, 0), np.int64)

    (move,) = compare(
        spec, oracle, n, state=words, actions=actions, draws=draws, tolerance=tolerance, seed=seed
    )
    for name, error in move.errors.items():
        if error.any():
            print(f"{name}: {np.nanmax(error):.2e} at worst of {n:,}")
    shown = move.outcome.observations
    if shown is None:
        after = Ours(spec, n)
        after.words = move.after
        shown = after.observations()
    step = step_from(spec, words, move.actions.reshape(n * spec.agents, *move.actions.shape[2:]), seed)
    delivered = shown.astype(spec.observation_dtype).reshape(-1, *spec.observation_shape)
    np.testing.assert_array_equal(step.arrivals(), delivered)
    np.testing.assert_array_equal(step.rewards, np.float32(move.outcome.rewards).ravel())
    np.testing.assert_array_equal(step.terminations, move.outcome.terminated.ravel())
    return move


def first_episodes(
    spec: EnvSpec, n: int, seed: int, policy: Policy, device: str = "native"
) -> tuple[Array, Array]:
    """Return length and return of the first episode of ``n`` agents, each alone in its world."""
    env = parallel_env(spec.name, n, device=device, copy=False, **spec.options)
    observations = env.reset_batch(seed=seed)
    generator = np.random.default_rng(seed + 1)
    lengths, returns, running = np.zeros(n, int), np.zeros(n), np.ones(n, bool)
    while running.any():
        step = env.step_batch(policy(observations, generator))
        lengths += running
        returns += np.where(running, step.rewards, 0)
        running &= ~step.ended
        observations = step.obs
    env.close()
    return lengths, returns


def random_actions_of(spec: EnvSpec) -> Policy:
    """Return the policy that takes any action of a ``Discrete`` space."""
    return lambda observations, generator: generator.integers(spec.action_counts[0], size=len(observations))


def assert_same_play(ours: Sequence[Array], theirs: Sequence[Array]) -> None:
    """Compare two samples of lengths and of returns, each by Kolmogorov and Smirnov; prints their p."""
    for name, mine, other in zip(("lengths", "returns"), ours, theirs, strict=True):
        p = p_of_one_law(mine, other)
        print(f"{name}: means {mine.mean():.3f} and {other.mean():.3f}, p = {p:.3f}")
        assert p > LIKELY, name


def p_of_one_law(first: Array, second: Array) -> float:
    """Return how likely two samples of one distribution differ as much, by Kolmogorov and Smirnov."""
    both = np.concatenate([first, second])
    below = [np.searchsorted(np.sort(part), both, side="right") / len(part) for part in (first, second)]
    distance = np.sqrt(len(first) * len(second) / len(both)) * np.abs(below[0] - below[1]).max()
    k = np.arange(1, 101)
    terms = 2 * (-1.0) ** (k - 1) * np.exp(-2 * (k * distance) ** 2)
    return min(1.0, float(terms.sum())) if distance > 0.2 else 1.0  # where the sum does not converge


def compare_pictures(
    spec: EnvSpec,
    mode: str,
    drawn: Callable[[Any], Any],
    actions: Sequence[Any],
    different: int,
    device: str = "native",
    seed: int = 0,
) -> None:
    """Compare the pictures of a world with those that the oracle draws of the same states.

    Parameters
    ----------
    spec, mode
        The environment, and a render mode that both have.
    drawn
        Puts the oracle into a state and returns its picture.
    actions
        The actions of all agents of the second of two worlds, step by step; the first takes them backwards.
    different
        How many of the pictures have to differ from each other.
    """
    n, shape = spec.agents, (spec.agents, *(spec.action_space.shape or ()))
    env = parallel_env(spec.name, 2 * n, render_mode=mode, device=device, **spec.options)
    env.reset(seed=seed)
    pictures = set()
    for pair in zip(reversed(actions), actions, strict=True):
        env.step_batch(np.concatenate([np.reshape(one, shape) for one in pair]))
        picture, other = env.render(f"agent_{n}"), drawn(spec.layout.built(env.state()[1].tolist()))
        np.testing.assert_array_equal(picture, other)
        pictures.add(np.asarray(picture).tobytes())
    assert len(pictures) >= different
    env.close()
