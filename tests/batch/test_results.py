"""Memory for results is used again when nobody has it any more, and not before."""

from __future__ import annotations

import copy

import numpy as np

from pearl_marl.batch.results import MAX_BLOCKS, Recycler


def address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def test_dropped_arrays_are_used_again() -> None:
    new = Recycler()
    assert len({address(new.empty((5, 3), np.float32)) for _ in range(20)}) == 1
    first = address(new.empty((5, 3), np.float32))
    assert address(new.empty((15,), np.int32)) == first  # as many bytes


def test_held_ones_are_not() -> None:
    new = Recycler()
    held = [new.copy(np.full((4, 4), k)) for k in range(3 * MAX_BLOCKS)]
    views = [new.copy(np.full(16, -k))[3:5] for k in range(3)]
    memories = [memoryview(new.copy(np.full(16, 100 + k))) for k in range(3)]
    for _ in range(9):
        new.empty((16,), np.int64)[:] = 7
    for k, array in enumerate(held):
        np.testing.assert_array_equal(array, np.full((4, 4), k))
    for k in range(3):
        assert set(views[k]) == {-k}
        assert set(memories[k]) == {100 + k}


def test_sizes_do_not_pile_up() -> None:
    new = Recycler()
    for size in range(1, 500):
        new.empty((size,), np.uint8)
    assert len(new._blocks) == MAX_BLOCKS


def test_copies_share_nothing() -> None:
    new = Recycler()
    array = new.empty((9,), np.uint8)
    array[:] = 1
    copy.deepcopy(new).empty((9,), np.uint8)[:] = 2
    assert set(array) == {1}


def test_arrays_that_stay_in_a_block_tell_of_it_too() -> None:
    new = Recycler(lambda memory: (memory[:4], memory[4:].view(np.float32)))
    first, second = new.block(12).arrays
    assert new.block(12).arrays[0] is not first, "the first block's are held"
    kept = second[1:]
    kept[:] = 5
    number = id(first)
    del first, second
    for _ in range(5):
        new.block(12).arrays[1][:] = 7
    assert set(kept) == {5}
    del kept
    assert id(new.block(12).arrays[0]) == number
    assert len(new._blocks) == 2
