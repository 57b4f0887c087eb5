"""Long functions of kernels are compiled once, by themselves, and kept with the code that calls them."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest

from pearl_marl.base import object_code
from pearl_marl.compiler import llvm_functions
from pearl_marl.compiler.llvm_words import operations

from .plain import inlined

add = operations()["int32_add"]

STEPS = """
import ctypes
import json
import numpy as np
import pearl_marl
from pearl_marl.base import object_code
kept, called = [], object_code.called
object_code.called = lambda text: kept.append(sorted(called(text))) or called(text)
env = pearl_marl.parallel_env("LevelBasedForaging", 32, field_size=(5, 5), players=16)
env.reset_batch(seed=0)
rewards = 0
for k in range(60):  # beyond the time limit of 50
    rewards += float(env.step_batch(np.full(32, (k % 5 + 1), np.uint8)).obs.sum())
print(json.dumps([kept, rewards]))
"""


def steps(cache: Path) -> tuple[list[list[str]], float]:
    """Run the steps in a process of its own; return which symbols each kept kernel calls, and a sum."""
    result = subprocess.run(
        [sys.executable, "-c", STEPS],
        env={**os.environ, "PEARL_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    kept, rewards = json.loads(result.stdout)
    return kept, rewards


def test_kernels_share_long_functions_and_keep_them(tmp_path: Path) -> None:
    kernels, first = steps(tmp_path)
    *_, reset, step = sorted(kernels, key=len)
    # Both observe the agents, which are alike, by one function, and find their masks by another.
    assert len({*reset} & {*step}) >= 2
    # A later process finds them in the files of the kernels; each file holds all that it needs.
    assert steps(tmp_path) == ([], first)


def counted(words: Any, m: Any) -> None:
    """A loop in parts, which keeps words from one to the next in scratch space."""
    for i in range(m):
        a = words[i]
        b = add(a, 1)
        c = add(b, 2)
        words[i] = c
        words[i + 8] = b
        words[i + 16] = add(b, c)


def kernel() -> Any:
    count = inlined(counted, alone=True)

    @numba.njit  # type: ignore[untyped-decorator]
    def run(words: Any, m: int) -> None:
        count(words, m)

    return run


@pytest.fixture
def _alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(llvm_functions, "LONG", 1)
    monkeypatch.setattr("pearl_marl.compiler.llvm_loops.MOST", 1)


@pytest.mark.usefixtures("_alone")
def test_a_function_compiled_by_itself_does_the_same() -> None:
    words = np.arange(24, dtype=np.int32)
    kernel()(words, 8)
    start = np.arange(8)
    np.testing.assert_array_equal(words, [*(start + 3), *(start + 1), *(2 * start + 4)])


@pytest.mark.usefixtures("_alone")
def test_it_says_that_there_is_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    allocate = llvm_functions._Heap.allocate
    huge = staticmethod(lambda builder, size: allocate(builder, builder.or_(size, size.type(1 << 62))))
    monkeypatch.setattr(llvm_functions._Heap, "allocate", huge)
    words = np.arange(24, dtype=np.int32)
    with pytest.raises(MemoryError, match="scratch space"):
        kernel()(words, 8)
    np.testing.assert_array_equal(words, np.arange(24))


def test_symbols_are_found_in_what_calls_them() -> None:
    text = 'define i8 @"alone"() {\n  ret i8 0\n}\n'
    symbol = object_code.compiled(text, "alone")
    assert symbol == object_code.compiled(text, "alone")
    (code,) = object_code.called(f"declare i8 @{symbol}()\ndeclare i8 @other()").values()
    assert symbol.encode() in code


def test_so_are_those_that_they_call() -> None:
    """Each after what it calls: it is added when that is there."""
    inner = object_code.compiled('define i8 @"inner"() {\n  ret i8 1\n}\n', "inner")
    calls = f'  %"a" = call i8 @{inner}()\n  ret i8 %"a"\n'
    outer = object_code.compiled(f'declare i8 @{inner}()\ndefine i8 @"outer"() {{\n{calls}}}\n', "outer")
    assert list(object_code.called(f"declare i8 @{outer}()")) == [inner, outer]
    assert list(object_code.called(f"declare i8 @{inner}()\ndeclare i8 @{outer}()")) == [inner, outer]


@pytest.mark.parametrize("passes", [True, False])
@pytest.mark.parametrize("effort", [0, 3])
def test_code_does_the_same_however_it_is_compiled(passes: bool, effort: int) -> None:
    text = 'define i32 @"alone"(i32 %x) {\n  %y = mul i32 %x, 3\n  %z = add i32 %y, 4\n  ret i32 %z\n}\n'
    symbol = object_code.compiled(text, "alone", passes, effort)
    call = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int32)(llvm.address_of_symbol(symbol))
    assert [call(x) for x in (-5, 0, 7)] == [-11, 4, 25]
    (code,) = object_code.called(symbol).values()
    other = object_code.compiled(text, "alone", passes, 3 - effort)
    assert code not in object_code.called(other).values()
