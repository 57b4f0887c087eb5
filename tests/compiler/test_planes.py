"""Boards shown as planes: what CPU kernels call against the function that environments name."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from pearl_marl.compiler.llvm_planes import REPLACEMENTS
from pearl_marl.compiler.loading import with_callees
from pearl_marl.planes import interleave


@pytest.mark.parametrize("count", [1, 2, 21, 42, 63, 64])
def test_kernels_interleave_as_python_does(count: int) -> None:
    def unpack(first, second, row):
        interleave(first, second, count, row)

    compiled = with_callees(unpack, dict(REPLACEMENTS), numba.njit)
    boards = np.random.default_rng(count).integers(1 << 64, size=(20, 2), dtype=np.uint64)
    for first, second in boards:
        rows = np.full((2, 2 * count + 64), 7, np.int8)  # what lies behind a row stays as it is
        unpack(int(first), int(second), rows[0])
        compiled(first, second, rows[1])
        np.testing.assert_array_equal(*rows)
        assert set(rows[0, 2 * count :]) == {7}
