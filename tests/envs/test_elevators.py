"""Elevators against those of ``rddlrepository``: steps of ``record_rddl.py``, with their arrivals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pearl_marl
from pearl_marl.envs.elevators.spec import CELL, DOOR, DOWN, INSTANCES, SHAFT, UP
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference
from pearl_marl.porting.oracle import Ours

from .record_rddl import HORIZON, checksum, inputs

RECORDED = np.load(Path(__file__).with_name("rddl.npz"))
SPEC = pearl_marl.get_spec("Elevators")


@pytest.mark.parametrize("steps", [200, pytest.param(None, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("instance", range(1, len(INSTANCES) + 1))
def test_steps(instance: int, steps: int | None) -> None:
    """All fluents and the reward after each step are the domain's, by its states, actions and arrivals."""
    spec = SPEC.with_options(instance=instance)
    cars = int(RECORDED[f"{instance}/cars"])
    floors = len(RECORDED[f"{instance}/chances"])
    given = inputs(instance, floors, cars)
    waiting, places, flags, actions, arrivals = (numbers[:steps] for numbers in given)
    n = len(actions)
    ours = Ours(spec, n)
    of_cars = np.concatenate([places[..., None], flags], 2).reshape(n, -1)
    columns = np.concatenate([waiting.reshape(n, -1), of_cars], 1).T
    ours.words = [column.astype(f.dtype) for column, f in zip(columns, spec.state, strict=True)]
    draws = np.where(arrivals.reshape(n, -1), 0, 2**32 - 1)
    made = ours.step(actions.reshape(n, 1, *spec.action_space.shape), draws)
    pairs = zip(ours.observations()[:, 0], 4 * made.rewards[:, 0], strict=True)
    np.testing.assert_array_equal([checksum(*pair) for pair in pairs], RECORDED[f"{instance}/checks"][:steps])
    assert not made.terminated.any()
    assert len(np.unique(made.rewards)) > 5


@pytest.mark.parametrize("instance", range(1, len(INSTANCES) + 1))
def test_instance(instance: int) -> None:
    """Its start, its time limit, and the chance of each arrival: the greatest draw that still is one."""
    spec = SPEC.with_options(instance=instance)
    start = call_reference(spec.positional.initial, ())
    assert spec.max_cycles == HORIZON
    seen = call_reference(spec.positional.observe, start)
    assert np.ravel(seen).tolist() == RECORDED[f"{instance}/start"].tolist()
    chances = RECORDED[f"{instance}/chances"][1:-1]
    cars, floors = int(RECORDED[f"{instance}/cars"]), len(chances)
    least = np.tile(np.rint(chances * 2**32).astype(np.int64), 2)
    for below, arrives in ((1, 1), (0, 0)):
        after = call_reference(spec.positional.step, [*start, *[0] * cars, *(least - below)])
        assert np.ravel(after[: 2 * floors]).tolist() == [arrives] * (2 * floors)


def test_picture() -> None:
    """Passengers that wait, and cars with their doors, ways and passengers."""
    assert SPEC.draw is not None
    bottom_closed, top_open = (0, 1, 1, 0, 0), (3, 0, 0, 0, 1)
    picture = SPEC.draw(SPEC.layout.built((1, 0, 0, 1, *bottom_closed, *top_open)))
    cells = picture.reshape(4, CELL, 3, CELL, 3).swapaxes(1, 2)[::-1]

    def has(colour: tuple[int, int, int]) -> list[list[int]]:
        return np.argwhere((cells == colour).all(-1).any((2, 3))).tolist()

    assert has(UP) == [[1, 0]]
    assert has(DOWN) == [[2, 0], [3, 2]]
    assert has(DOOR) == [[3, 2]]
    assert len(has(SHAFT)) == 8
    ways = [(cells[place][:, 4:-2] == 0).all((1, 2)).argmax() for place in ((0, 1), (3, 2))]
    assert ways == [2, CELL - 5]


def test_what_is_refused() -> None:
    with pytest.raises(ArgumentError, match="instance is 11; it must be an integer from 1 to 10"):
        SPEC.with_options(instance=11)
