"""``unpack(view, row)``, which writes what ``observe`` returns into an array: wherever it runs."""

from __future__ import annotations

import dataclasses
import json
import pickle
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

import pearl_marl
from pearl_marl.compiler.packing import packed
from pearl_marl.devices import BatchConfig, make_device
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import Draws, Word
from pearl_marl.golden.rebinding import rebound
from pearl_marl.layout import Array, Bits, Flag, Range
from pearl_marl.layout.positional import in_fixed_point
from pearl_marl.spec import EnvSpec, Golden


class Boat(NamedTuple):
    row: Range[0, 2]
    loads: Array[Flag, 3]


class State(NamedTuple):
    boats: Array[Boat, 2]
    time: Bits[4]


class View(NamedTuple):
    """Its fields are named like what they might be confused with."""

    row: Bits[4]
    function: Boat
    boats: Array[Boat, 2]
    counts: Array[Bits[2], 2]


def initial(draws: Draws) -> State:
    return State([Boat(draws.below(3), [0, 1, 0]) for _ in range(2)], 0)


def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
    boats = [boat._replace(row=min(boat.row + draws.bits(1), 2)) for boat in state.boats]
    for boat in boats:
        boat.loads[action] = draws.bits(1)
    return State(boats, (state.time + 1) & 15), 0, state.time == 15


def observe(state: State) -> View:
    first, last = state.boats
    return View(state.time, last, [last, first], [sum(boat.loads) for boat in state.boats])


SIZE = 14


def total(numbers: Any) -> int:
    result = 0
    for number in numbers:
        result += int(number)
    return result


def unpack(seen: View, row: Any) -> None:
    row[0] = seen.row
    row[1] = seen.function.row
    place = 2
    for boat in seen.boats:
        row[place] = boat.row
        row[place + 1] = total(boat.loads)
        for k in range(3):
            row[place + 2 + k] = boat.loads[k]
        place += 5
    row[12], row[13] = seen.counts


def spec_of(**changes: Any) -> EnvSpec:
    given: dict[str, Any] = {
        "name": "Boats",
        "version": 0,
        "summary": "Boats",
        "rewards": (0.0,),
        "observation_space": Box(0, 15, (SIZE,), np.uint8),
        "action_space": Discrete(2),
        "golden": Golden(State, initial, step, observe, view=View),
        "unpack": unpack,
    }
    return EnvSpec(**given | changes)


def steps(spec: EnvSpec, device: str) -> np.ndarray[Any, Any]:
    opened = make_device(device).open(BatchConfig(spec=spec, n_envs=9))
    seen = [opened.reset(seed=1)]
    seen += [opened.step(np.arange(9, dtype=np.uint8) % 2).obs for _ in range(20)]
    opened.close()
    return np.stack(seen)


def test_everywhere() -> None:
    spec = spec_of()
    due = steps(spec, "reference")
    assert len(np.unique(due.reshape(-1, SIZE), axis=0)) > 50
    np.testing.assert_array_equal(due[..., 12], due[..., 8])
    np.testing.assert_array_equal(due[..., 13], due[..., 3])
    np.testing.assert_array_equal(steps(spec, "native"), due)
    for device in ("reference", "native"):
        rows = steps(packed(spec), device)
        np.testing.assert_array_equal(
            pearl_marl.unpacked(spec, rows.reshape(len(rows) * 9, -1)), due.reshape(-1, SIZE)
        )


def test_it_is_pickled() -> None:
    for spec in (spec_of(), packed(spec_of())):
        again = pickle.loads(pickle.dumps(spec))
        np.testing.assert_array_equal(steps(again, "reference"), steps(spec, "reference"))


def test_of_one_field() -> None:
    """Then both ways of writing it take two arguments."""

    class Single(NamedTuple):
        time: Bits[4]

    def single(seen: Any, row: Any) -> None:
        row[0], row[1] = seen.time & 3, seen.time >> 2

    golden = Golden(State, initial, step, lambda state: Single(state.time), view=Single)
    spec = spec_of(golden=golden, unpack=single, observation_space=Box(0, 3, (2,), np.uint8))
    for one in (spec, packed(spec)):
        np.testing.assert_array_equal(steps(one, "native"), steps(one, "reference"))


def test_what_is_refused() -> None:
    def too_many(seen: View, more: int, row: Any) -> None:
        pass

    with pytest.raises(
        ArgumentError, match=r"too_many\(\) is called with \(row, function_row, .*, row\): too many"
    ):
        spec_of(unpack=too_many)

    @dataclasses.dataclass
    class Plain:
        row: Bits[4]
        time: Bits[4]

    golden = Golden(State, initial, step, lambda state: (state.time, state.time), view=Plain)
    with pytest.raises(ArgumentError, match=r"takes a Plain; Numba knows NamedTuples only"):
        spec_of(golden=golden)


def unpack_of_a_text(seen: Any, row: Any) -> None:
    row[0] = 1
    row[1] = len(json.dumps([1]))


def unpack_beyond(seen: Any, row: Any) -> None:
    row[row.size] = 1


def test_a_write_beyond_the_row_is_refused() -> None:
    told = r"test_unpack.py, line \d+: unpack\(\) fails for a row of \d+ elements.*out of bounds"
    with pytest.raises(ArgumentError, match=told):
        spec_of(unpack=unpack_beyond)


def test_what_cannot_be_compiled_is_told_where_it_stands() -> None:
    """In a sentence, without a word of the compiler's."""
    line = unpack_of_a_text.__code__.co_firstlineno + 2
    spec = spec_of(unpack=unpack_of_a_text)
    device = make_device("native").open(BatchConfig(spec=spec, n_envs=3))
    told = rf"test_unpack.py, line {line}: unpack\(\) cannot be compiled here"
    with pytest.raises(ArgumentError, match=told) as error:
        device.reset(seed=0)
    assert "umba" not in str(error.value)


EDGES = 128.00001, 0.49999997 / 65536, 8388609 / 65536, 40_000.0, -np.inf, np.inf, np.nan
FLOATS = (0.0, 1.0, -0.25, 0.1, *EDGES)


@pytest.mark.parametrize("floats", [np.float32, np.float64])
def test_floats_in_fixed_point(floats: type) -> None:
    """The same compiled and in plain Python, whatever the author's variables are called."""

    def unpack(one: Any, floor: Any, function: Any) -> None:
        for k in range(len(FLOATS)):
            function[k] = FLOATS[k]
        function[0] = one + floor

    made = in_fixed_point(unpack, np.dtype(floats))
    dtype = np.dtype(f"i{np.dtype(floats).itemsize}")
    rows = np.empty((2, len(FLOATS)), dtype)
    made.plain(3, 4, rows[0])  # type: ignore[attr-defined]
    rebound(made, finish=numba.njit)(3, 4, rows[1])
    np.testing.assert_array_equal(*rows)
    assert rows[0, :4].tolist() == [7 << 16, 1 << 16, -(1 << 14), 6554]
    limits = np.iinfo(dtype)
    assert limits.min < rows[0, 8] < limits.min + (1 << 17)
    assert limits.max - (1 << 17) < rows[0, 9] < limits.max
    assert rows[0, 10] == 0
