"""What MinAtar's games have in common, against MinAtar's: spaces, options, starts and whole episodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

import pearl_marl
from pearl_marl.envs.asterix.spec import minatar_attributes as attributes_of_asterix
from pearl_marl.envs.space_invaders.spec import minatar_attributes as attributes_of_space_invaders
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec
from pearl_marl.testing import assert_same_play, first_episodes
from pearl_marl.testing.oracles import random_actions_of

from .minatar import assert_attributes, initial_words, minatar

Array = np.ndarray[Any, Any]
BITS = {
    "Asterix": [85, 3, 64, 1],
    "Breakout": [55, 2, 50, 1],
    "Freeway": [108, 2, 68, 1],
    "Seaquest": [694, 3, 440, 4],
    "SpaceInvaders": [80, 2, 64, 2],
}
"""Of each game's state, action, observation and reward; Seaquest's are no more than the paper's."""


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize("name", BITS)
def test_spaces_are_minatars(name: str, version: int) -> None:
    """MinAtar's two versions have the two action sets."""
    ours = pearl_marl.get_spec(name)
    theirs: Any = gymnasium.make(f"{str(ours.oracle).removesuffix('1')}{version}")
    if name == "Seaquest":  # both have all six actions in one order, for it has a use for each
        assert theirs.unwrapped.action_set == list(range(6))
    else:
        ours = ours.with_options(use_minimal_action_set=version == 1)
    assert ours.observation_space == theirs.observation_space
    assert ours.observation_space.dtype == theirs.observation_space.dtype
    assert ours.action_space == theirs.action_space


@pytest.mark.parametrize("name", BITS)
def test_words_are_no_wider_than_they_have_to_be(name: str) -> None:
    spec = pearl_marl.get_spec(name)
    words = (spec.state, (spec.action,), spec.observation, (spec.reward,))
    assert [sum(field.bits for field in fields) for fields in words] == BITS[name]


@pytest.mark.parametrize("name", BITS)
def test_bad_options(name: str) -> None:
    spec = pearl_marl.get_spec(name)
    for bad in (-0.1, 1.5, float("nan"), "often", True, None):
        with pytest.raises(ArgumentError, match=r"sticky_action_prob is .*from 0 to 1"):
            spec.with_options(sticky_action_prob=bad)
    for flag in spec.options.keys() - {"sticky_action_prob"}:
        with pytest.raises(ArgumentError, match=f"{flag} is 1; it must be True or False"):
            spec.with_options(**{flag: 1})


@pytest.mark.parametrize(
    ("name", "attributes"),
    [("Asterix", attributes_of_asterix), ("SpaceInvaders", attributes_of_space_invaders)],
)
def test_start_is_minatars(name: str, attributes: Callable[[Any], dict[str, Any]]) -> None:
    """Where a start takes draws, the file of the game compares it."""
    spec = pearl_marl.get_spec(name)
    game = minatar(spec).game
    game.reset()
    assert_attributes(game.env, attributes(spec.layout.built(initial_words(spec))))


@pytest.mark.parametrize(
    ("name", "ours", "theirs"),
    [
        pytest.param("Asterix", 6_000, 600, marks=pytest.mark.slow),
        pytest.param("Breakout", 20_000, 4_000, marks=pytest.mark.slow),
        pytest.param("Freeway", 2_000, 200, marks=pytest.mark.exhaustive),
        pytest.param("Seaquest", 20_000, 20_000, marks=pytest.mark.exhaustive),
        pytest.param("SpaceInvaders", 6_000, 400, marks=pytest.mark.slow),
    ],
)
def test_episodes_of_a_random_policy(name: str, ours: int, theirs: int) -> None:
    """Lengths and returns of so many episodes have one distribution, by Kolmogorov and Smirnov."""
    spec = pearl_marl.get_spec(name)
    played = first_episodes(spec, ours, 1, random_actions_of(spec))
    assert_same_play(played, episodes_of_minatar(spec, theirs, 2))


def episodes_of_minatar(spec: EnvSpec, n: int, seed: int) -> tuple[Array, Array]:
    """Return length and return of ``n`` episodes of MinAtar's own under the random policy."""
    env: Any = gymnasium.make(str(spec.oracle), **spec.options).unwrapped
    env.seed(seed)
    lengths, returns, game = np.zeros(n, int), np.zeros(n), env.game
    actions = np.random.default_rng(seed)
    for k in range(n):
        game.reset()
        game.last_action = 0
        end = False
        while not end:
            reward, end = game.act(env.action_set[actions.integers(len(env.action_set))])
            lengths[k] += 1
            returns[k] += reward
    return lengths, returns
