"""Parameters of slots: fields of states that a step leaves as they are, drawn or given at a reset."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pytest
from gymnasium.spaces import Discrete
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl import envs
from pearl_marl.errors import ArgumentError
from pearl_marl.layout import Range
from pearl_marl.spec import EnvSpec, Golden


class State(NamedTuple):
    place: Range[0, 15]
    speed: Range[1, 4]
    """How far a step goes: another one in every slot."""


def initial(draws: Any) -> State:
    return State(0, 1 + draws.below(4))


def step(state: State, action: Any, draws: Any) -> tuple[State, Any, Any]:
    place = min(state.place + state.speed, 15) if action else 0
    return State(place, state.speed), place == 15, place == 15


def observe(state: State) -> Any:
    return state.place


SPEC = EnvSpec(
    name="Runner",
    version=0,
    summary="Run, some faster than others",
    rewards=(0.0, 1.0),
    observation_space=Discrete(16),
    action_space=Discrete(2),
    golden=Golden(State, initial, step, observe),
)
SPEEDS = np.array([1, 2, 3, 4, 4, 2])


@pytest.fixture(autouse=True)
def runner() -> Iterator[None]:
    with mock.patch.dict(envs._specs):
        pearl_marl.register(SPEC)
        yield


def states(env: Any) -> Any:
    return env.unwrapped.state()


@pytest.mark.parametrize("device", ["reference", "native", "rtl"])
@pytest.mark.parametrize("starts", ["random", "stored"])
def test_given_parameters_hold(device: str, starts: str) -> None:
    env = pearl_marl.parallel_env("Runner", n_agents=6, device=device, initial_states=starts)
    obs, _ = env.reset(seed=3, options={"state": {"speed": SPEEDS, "place": 2}})
    assert [int(o) for o in obs.values()] == [2] * 6
    for k in (1, 2, 3):
        obs, *_ = env.step(np.ones(6, int))
        assert [int(o) for o in obs.values()] == (2 + k * SPEEDS).tolist()
    for _ in range(12):
        env.step(np.ones(6, int))
    again = states(env)[:, 1]
    # Stored starts begin every episode; random ones are drawn anew.
    assert (again == SPEEDS).all() == (starts == "stored")


def test_a_slot_that_does_not_end_keeps_what_was_drawn() -> None:
    env = pearl_marl.parallel_env("Runner", n_agents=200)
    env.reset(seed=0)
    drawn = states(env)[:, 1].copy()
    assert set(drawn.tolist()) == {1, 2, 3, 4}
    for _ in range(5):
        env.step(np.zeros(200, int))
    assert (states(env)[:, 1] == drawn).all()


def test_only_the_masked_slots_are_set() -> None:
    env = pearl_marl.make_vec("Runner", num_envs=4, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0, options={"state": {"place": [1, 2, 3, 4]}})
    mask = np.array([True, False, True, False])
    env.reset(options={"reset_mask": mask, "state": {"place": 9}})
    assert env.unwrapped.device.state()[:, 0].tolist() == [9, 2, 9, 4]


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({"sped": 1}, "has no 'sped', did you mean 'speed'?"),
        ({"speed": 5}, "speed of slot 0 is 5; possible are 1 to 4"),
        ({"speed": [1, 2, 0, 1]}, "speed of slot 2 is 0"),
        ({"speed": [1, 2]}, "must be a number, or 4 of them"),
        ({"speed": 1.5}, "takes integers"),
        ({"speed": float("nan")}, "possible are 1 to 4"),
        (7, "must be a dict"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_moves(state: Any, words: str) -> None:
    env = pearl_marl.parallel_env("Runner", n_agents=4)
    env.reset(seed=0)
    env.step(np.ones(4, int))
    before = env.save_state()
    with pytest.raises(ArgumentError, match=words.replace("?", r"\?")):
        env.reset(options={"state": state})
    assert env.save_state() == before
