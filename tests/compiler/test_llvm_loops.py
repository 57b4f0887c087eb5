"""Long loops are cut into parts: they do the same, and LLVM takes no longer for a word of them."""

from __future__ import annotations

import inspect
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest
from gymnasium.spaces import Discrete, MultiDiscrete
from llvmlite import ir

from pearl_marl.base.cache import cache_folder
from pearl_marl.batch.actions import random_actions
from pearl_marl.compiler import kernels, llvm_loops
from pearl_marl.compiler.llvm_functions import FAILED, Code, Value, WordArray, _Heap, written
from pearl_marl.compiler.llvm_words import operations
from pearl_marl.devices import BatchConfig, Native, Reference
from pearl_marl.envs import get_spec, names
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Bits
from pearl_marl.spec import EnvSpec, Golden

from ..sampling import sampled
from ..toy import LADDER
from ..toy_world import MEADOW
from .plain import inlined

MOST = llvm_loops.MOST
add, less, choose = (operations()[name] for name in ("int32_add", "int32_less", "int32_choose"))
LANE = 300


def swap(words: Any, numbers: Any, first: Any, m: Any) -> None:
    """Words that are needed after their place has got another one."""
    for i in range(first, m):
        a, b, c = words[i], words[i + LANE], words[i + 2 * LANE]
        words[i] = b
        words[i + LANE] = add(c, 1)
        words[i + 2 * LANE] = a
        numbers[i] = np.float32(a)


def mix(words: Any, numbers: Any, first: Any, m: Any) -> None:
    """Words of all kinds across cuts: loaded and cast, computed, floats, a constant, and the index."""
    for i in range(first, m):
        wide = np.int64(words[i]) + 5
        sum_ = add(words[i], words[i + LANE])
        flag = less(words[i + 2 * LANE], sum_)
        half = np.float32(words[i]) * np.float32(0.5)
        words[i + LANE] = choose(flag, sum_, 7)
        numbers[i * 2] = half
        words[i + 2 * LANE] = np.int32(np.int64(i) * 3 + wide)
        numbers[i * 2 + 1] = np.float32(flag) * half
        words[i] = np.int32(wide)


def around(words: Any, numbers: Any, first: Any, m: Any) -> None:
    """A loop with another one in it, which is cut, between words of its own."""
    for d in range(1, 3):
        start = words[d]
        words[d] = add(start, 1)
        for i in range(first, m):
            words[i + LANE] = add(words[i + LANE], start)
            words[i + 2 * LANE] = add(words[i + LANE], d)
            words[i + LANE] = add(words[i + 2 * LANE], start)
        numbers[d] = np.float32(start)


@pytest.mark.parametrize("function", [swap, mix, around])
@pytest.mark.parametrize("most", sampled([1, 2, 3, 4, 100], [1, 3]))
def test_a_loop_in_parts_does_the_same(
    function: Callable[..., None], most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(llvm_loops, "MOST", most)
    written = inlined(function)

    @numba.njit  # type: ignore[untyped-decorator]
    def compiled(words: Any, numbers: Any, first: Any, m: Any) -> None:
        written(words, numbers, first, m)

    def plain(words: Any, numbers: Any, first: int, m: int) -> None:
        scope = {"add": np.add, "less": np.less, "choose": np.where, "np": np, "LANE": LANE}
        exec(source_of(function), scope)
        scope[function.__name__](words, numbers, first, m)

    for first, m in ((0, 0), (0, 1), (3, 64), (0, 65), (5, LANE)):
        words = np.random.default_rng(m).integers(-1000, 1000, 3 * LANE).astype(np.int32)
        expected, found = ((words.copy(), np.zeros(2 * LANE, np.float32)) for _ in range(2))
        plain(*expected, first, m)
        compiled(*found, first, m)
        for one, other in zip(expected, found, strict=True):
            np.testing.assert_array_equal(one, other)


def test_every_part_of_a_loop_reads_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also the parts that follow the one in which it was first named."""
    monkeypatch.setattr(llvm_loops, "MOST", 1)

    def body(code: Code, arguments: dict[str, Any]) -> None:
        words = arguments["words"]
        for i in code.range(0, arguments["m"]):
            entries = code.table(np.array([5, 7, 11], np.int32))
            for k in range(3):
                words[i + k * LANE] = entries[k]

    write = written(body, ["words", "m"], {})

    @numba.njit  # type: ignore[untyped-decorator]
    def compiled(words: Any, m: int) -> None:
        write(words, m)

    words = np.zeros(3 * LANE, np.int32)
    compiled(words, LANE)
    assert words.reshape(3, LANE).T.tolist() == [[5, 7, 11]] * LANE


def source_of(function: Callable[..., None]) -> str:
    return inspect.getsource(function).replace(": Any", "").replace(" -> None", "")


@pytest.fixture
def own_kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("PEARL_CACHE_DIR", str(tmp_path))
    cache_folder.cache_clear()
    kernels._loaded.clear()
    yield
    cache_folder.cache_clear()
    kernels._loaded.clear()


BEADS = 12
"""More than a state has in columns: they are in lanes."""


class Ring(NamedTuple):
    beads: Array[Bits[4], BEADS]


def ring_step(state: Ring, action: Word, draws: Draws) -> tuple[Ring, Word, Word]:
    """Each bead takes the place of the one before, whose word is written first."""
    first, *others = state.beads
    return Ring([*others, (first + action) & 15]), 0, first == others[-1]


RING = EnvSpec(
    name="Ring",
    version=0,
    summary="Beads go around",
    observation_space=MultiDiscrete([16] * BEADS),
    action_space=Discrete(3),
    rewards=(0.0, 1.0),
    golden=Golden(
        Ring, lambda draws: Ring([draws.bits(4) for _ in range(BEADS)]), ring_step, lambda state: state.beads
    ),
    max_cycles=20,
)

SPECS = [LADDER, RING, MEADOW, *(get_spec(name) for name in names())]


@pytest.mark.parametrize("spec", sampled(SPECS, [LADDER, RING]), ids=lambda spec: spec.name)
@pytest.mark.usefixtures("own_kernels")
def test_kernels_in_parts_give_the_results_of_the_reference(
    spec: EnvSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(llvm_loops, "MOST", 5)
    cuts = []
    surround = llvm_loops.Loop._surround
    monkeypatch.setattr(llvm_loops.Loop, "_surround", lambda self: (cuts.append(self), surround(self)))
    config = BatchConfig(spec=spec, n_envs=150)
    device, reference = Native(threads=1).open(config), Reference().open(config)
    np.testing.assert_array_equal(device.reset(seed=1), reference.reset(seed=1))
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = random_actions(spec, rng, 150 * spec.agents, device.action_masks)
        found, expected = device.step(actions), reference.step(actions)
        for name in ("obs", "rewards", "terminations", "truncations"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)
    assert cuts
    device.close()


def row_of(size: int) -> Callable[..., None]:
    """Return a function that writes so many words of each slot, one by one."""
    lines = (
        f"        numbers[i * {size} + {k}] = np.float32(add(words[i], words[i + {LANE * (k % 3)}]))"
        for k in range(size)
    )
    scope: dict[str, Any] = {"add": add, "np": np}
    exec("\n".join(["def row(words, numbers, m):", "    for i in range(m):", *lines]), scope)
    row: Callable[..., None] = scope["row"]
    return row


def test_the_text_grows_as_the_loop_does_and_the_parts_do_not_grow(monkeypatch: pytest.MonkeyPatch) -> None:
    """LLVM takes a time that grows with the square of the accesses in a part."""
    accesses: list[int] = []
    end = llvm_loops.Loop._end

    def counted(self: llvm_loops.Loop, last: bool = False) -> None:
        accesses.append(self.accesses)
        end(self, last)

    monkeypatch.setattr(llvm_loops.Loop, "_end", counted)
    lines = []
    for size in (500, 1000, 2000):
        module = ir.Module()
        pointers = [ir.IntType(32).as_pointer(), ir.FloatType().as_pointer(), ir.IntType(64)]
        function = ir.Function(module, ir.FunctionType(ir.VoidType(), pointers), "row")
        code = Code(ir.IRBuilder(function.append_basic_block()), _Heap, {})
        words = (
            WordArray(code, function.args[0], numba.int32),
            WordArray(code, function.args[1], numba.float32),
        )
        code.inline(row_of(size), *words, Value(code, function.args[2], numba.int64))
        lines.append(str(module).count("\n"))
    assert 100 < max(accesses) <= MOST + 3
    assert lines[2] - lines[1] == pytest.approx(2 * (lines[1] - lines[0]), rel=0.05)


@pytest.mark.parametrize("most", [3, 100])
def test_llvm_compares_no_accesses_of_parts(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one long loop it does: that checks when it runs whether the columns overlap."""
    monkeypatch.setattr(llvm_loops, "MOST", most)
    monkeypatch.setattr(llvm_loops, "WORK", 0)
    module = ir.Module()
    pointers = [ir.IntType(32).as_pointer(), ir.FloatType().as_pointer(), ir.IntType(64), ir.IntType(64)]
    function = ir.Function(module, ir.FunctionType(FAILED, pointers), "mixed")
    code = Code(ir.IRBuilder(function.append_basic_block()), _Heap, {})
    words = WordArray(code, function.args[0], numba.int32), WordArray(code, function.args[1], numba.float32)
    code.inline(mix, *words, *(Value(code, argument, numba.int64) for argument in function.args[2:]))
    code.ret(FAILED(0))
    parsed = llvm.parse_assembly(str(module))
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    tuning.loop_vectorization = True
    machine = llvm.Target.from_default_triple().create_target_machine(opt=3)
    builder = llvm.create_pass_builder(machine, tuning)
    builder.getModulePassManager().run(parsed, builder)
    assert "vector.body" in str(parsed)
    assert ("vector.memcheck" in str(parsed)) == (most == 100)


FIRST_STEP = """
import sys
import numpy as np
import pearl_marl
env = pearl_marl.parallel_env("LevelBasedForaging", 16, field_size=[5, 5], players=16)
env.reset_batch(seed=0)
env.step_batch(np.zeros(16, np.uint8))
"""


@pytest.mark.exhaustive
def test_the_first_step_of_a_world_of_sixteen(tmp_path: Path) -> None:
    """It took 24 s of processor time where it takes 7 now; other work on the machine makes it more."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", FIRST_STEP], env={**os.environ, "PEARL_CACHE_DIR": str(tmp_path)}, check=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert sum(after[:2]) - sum(before[:2]) < 12
