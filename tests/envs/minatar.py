"""MinAtar's games beside ours: they get the decisions that we drew, and all that either has is compared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
import pytest

from pearl_marl.devices import BatchConfig, Native
from pearl_marl.envs.minatar import action_table
from pearl_marl.golden import call_reference, rng
from pearl_marl.porting.oracle import Actions, Draws, Games, Ours, Outcome, compare, uniform_draws
from pearl_marl.spec import EnvSpec
from pearl_marl.testing import compare_pictures

Array = np.ndarray[Any, Any]
Decide = Callable[[Any, int, Sequence[int]], list[Any]]
"""Returns the decisions that a step will ask for, in their order: of MinAtar's environment, the action that
it gets, and our draws."""


class Decisions:
    """Stands for the random state of a MinAtar environment: gives out the decisions that we drew."""

    def __init__(self) -> None:
        self.queue: list[Any] = []

    def rand(self, *shape: int) -> Any:
        return self._next(shape)

    def randint(self, low: int, high: int | None = None, size: int | None = None) -> Any:
        value = self._next(() if size is None else (size,))
        low, high = (0, low) if high is None else (low, high)
        assert np.all((low <= np.asarray(value)) & (np.asarray(value) < high))
        return value

    def _next(self, shape: tuple[int, ...]) -> Any:
        value = self.queue.pop(0)
        assert np.shape(value) == shape
        return value


TENTH = 429496730
"""Of 32 bits, the first draw by which the last action is not repeated, at MinAtar's probability."""
STICKY_EDGES = 0, TENTH - 1, TENTH, (1 << 32) - 1


def repeats(environment: Any, action: int, draws: Sequence[int]) -> list[Any]:
    """Return the decision whether the last action is repeated; MinAtar asks even where it never is."""
    return [draw / 2**32 for draw in draws] or [0.5]


def at_random(ours: Ours, generator: np.random.Generator) -> Array:
    return generator.integers(ours.spec.action_counts[0], size=(ours.n, 1))


def minatar(spec: EnvSpec) -> Any:
    """Return MinAtar's environment of a spec's game and options, whose decisions we give to it."""
    env: Any = gymnasium.make(str(spec.oracle), **spec.options).unwrapped
    env.game.random = env.game.env.random = Decisions()
    return env


def edged_draws(*edges: int, mask: int = 0xFFFFFFFF) -> Draws:
    """Return draws of which one in ten is, in the bits of a mask, one at which a decision changes."""

    def draws(generator: np.random.Generator, n: int, count: int) -> Array:
        both = generator.integers(1 << 32, size=(n, count), dtype=np.uint32)
        edged = generator.random((n, count)) < 0.1
        chosen = generator.choice(np.array(edges, np.uint32), np.count_nonzero(edged))
        both[edged] = both[edged] & np.uint32(~mask & 0xFFFFFFFF) | chosen
        return both.astype(np.int64)

    return draws


class Match:
    """The golden step and MinAtar side by side, ``n`` of each.

    Parameters
    ----------
    spec
        The environment.
    minimal
        Its minimal action set.
    attributes
        Returns the attributes that MinAtar's game has in a state of ours.
    decide
        Returns the decisions of a step.
    n
        How many games.
    immortal
        Whether an end is put aside and the game goes on.
    after
        Called with each game of MinAtar's after its step.
    """

    def __init__(
        self,
        spec: EnvSpec,
        minimal: Sequence[int],
        attributes: Callable[[Any], dict[str, Any]],
        decide: Decide,
        n: int,
        immortal: bool = False,
        after: Callable[[Any], None] = lambda game: None,
    ) -> None:
        self.spec, self.n, self.immortal = spec, n, immortal
        self.effects = action_table(minimal, False)
        self.attributes, self.decide, self.after = attributes, decide, after
        self.theirs = [minatar(spec) for _ in range(n)]
        self.words = [np.full(n, word) for word in initial_words(spec)]
        self.episodes = self.transitions = 0
        self.earned = 0.0

    def play(self, policy: Actions, steps: int, seed: int, draws: Draws = uniform_draws) -> None:
        """Go on by so many steps, and compare whatever the two have after each."""
        games = Games(self.spec, self.theirs, self.pose, self.step, lambda env: Outcome(env.game.state()))
        for move in compare(
            self.spec,
            games,
            self.n,
            steps,
            state=self.words,
            actions=policy,
            draws=draws,
            seed=seed,
            restarts=not self.immortal,
        ):
            self.words = move.after
            self.episodes += int(move.ended.sum())
            self.transitions += self.n
            self.earned += float(np.sum(move.outcome.rewards))
            for k, env in enumerate(self.theirs):
                state = self.spec.layout.built(int(column[k]) for column in self.words)
                assert state.last_action == self.effects[env.game.last_action]
                assert_attributes(env.game.env, self.attributes(state))

    def pose(self, env: Any, state: Any) -> None:
        assert self.spec.pose is not None
        env.game.env.terminal = False
        self.spec.pose(env, state)

    def step(self, env: Any, actions: list[int], draws: list[int]) -> Outcome:
        action, game, decisions = env.action_set[actions[0]], env.game.env, env.game.random
        decisions.queue = self.decide(env.game, action, draws)
        reward, end = env.game.act(action)
        assert not decisions.queue
        if self.immortal:
            game.terminal = False
        self.after(game)
        return Outcome(game.state(), reward, end)


def initial_words(spec: EnvSpec, *draws: int) -> list[Any]:
    """Return the words of a new episode's state; without draws, of one whose draws are all 0."""
    return list(call_reference(spec.positional.initial, draws or [0] * spec.reset_draws))


def assert_attributes(game: Any, ours: dict[str, Any]) -> None:
    """Compare the attributes of a game of MinAtar's with ours."""
    for name, value in ours.items():
        theirs = getattr(game, name)
        assert np.array_equal(theirs, value) if isinstance(value, np.ndarray) else theirs == value, name


def assert_a_device_plays_it(
    spec: EnvSpec,
    decide: Decide,
    decide_start: Callable[[Sequence[int]], list[Any]],
    n: int,
    steps: int,
    ends: int,
) -> None:
    """Play by the CPU device's own draws, known from the seed, until at least ``ends`` episodes are over."""
    seed, reset_draws = 5, spec.reset_draws
    device = Native().open(BatchConfig(spec=spec, n_envs=n))
    theirs = [minatar(spec) for _ in range(n)]

    def drawn(tick: int, first: int, count: int) -> Array:
        columns = [rng.draws(rng.seed_words(seed), np.arange(n), tick, first + k) for k in range(count)]
        return np.stack(columns, 1) if columns else np.zeros((n, 0), np.int64)

    def start(env: Any, draws: Array) -> None:
        env.game.random.queue = decide_start(draws.tolist())
        env.game.reset()
        env.game.last_action = 0
        assert not env.game.random.queue

    starts = drawn(0, 0, reset_draws)
    for env, row in zip(theirs, starts, strict=True):
        start(env, row)
    np.testing.assert_array_equal(device.reset(seed=seed), [env.game.state() for env in theirs])
    generator, ended = np.random.default_rng(6), 0
    for step in range(steps):
        actions = generator.integers(spec.action_counts[0], size=n).astype(np.uint8)
        starts, draws = drawn(step + 1, 0, reset_draws), drawn(step, reset_draws, spec.step_draws)
        batch = device.step(actions)
        arrivals = batch.arrivals()
        for k, env in enumerate(theirs):
            action = env.action_set[actions[k]]
            env.game.random.queue = decide(env.game, action, draws[k].tolist())
            reward, end = env.game.act(action)
            assert (batch.rewards[k], batch.terminations[k]) == (reward, end), f"step {step}"
            np.testing.assert_array_equal(arrivals[k], env.game.state())
            if end:
                ended += 1
                start(env, starts[k])
            np.testing.assert_array_equal(batch.obs[k], env.game.state())
    assert ended >= ends
    device.close()


def assert_same_pictures(spec: EnvSpec, actions: Sequence[int], different: int, seed: int = 0) -> None:
    """Compare pictures with MinAtar's."""
    pytest.importorskip("seaborn", reason="MinAtar takes its colours from seaborn")
    theirs = gymnasium.make(str(spec.oracle), render_mode="rgb_array", **spec.options)
    theirs.reset()

    def drawn(state: Any) -> Any:
        assert spec.pose is not None
        spec.pose(theirs.unwrapped, state)
        return np.rint(255 * np.asarray(theirs.render())).astype(np.uint8)

    compare_pictures(spec, "rgb_array", drawn, actions, different=different, seed=seed)
    theirs.close()
