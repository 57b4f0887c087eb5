"""The kernel cache, and whether the compiler made SIMD code of the step."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import types
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

import pearl_marl
from pearl_marl.base.cache import cache_folder
from pearl_marl.compiler import kernels
from pearl_marl.compiler.cuda_source import PREFIXES, cuda_source
from pearl_marl.compiler.kernels import kernel_source
from pearl_marl.compiler.loading import fingerprint
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.golden import rng, u32
from pearl_marl.spec import EnvSpec

from ..rtl.wide_steps import renamed
from ..toy import DRIFT, LADDER, SLIDE
from .plain import returning

SPEC = pearl_marl.get_spec("CliffWalking")
State: Any = SPEC.golden.state

FIRST_STEP = """
import json, sys
import numpy as np
from numba.core import event
import pearl_marl
with event.install_recorder("numba:compile") as compiled:
    env = pearl_marl.parallel_env("CliffWalking", 5, is_slippery=True)
    obs = [env.reset_batch(seed=0)] + [env.step_batch(np.full(5, t % 2, np.uint8)).obs for t in range(9)]
loaded = env.device._kernels
print(json.dumps({
    "obs": np.array(obs).tolist(),
    "path": str(loaded.path),
    "compiled": len(compiled.buffer),
    "hits": [sum(f.stats.cache_hits.values()) for f in (loaded.reset, loaded.step)],
    "misses": [sum(f.stats.cache_misses.values()) for f in (loaded.reset, loaded.step)],
}))
"""

PATH = """
import json, pearl_marl
print(json.dumps(str(pearl_marl.parallel_env("CliffWalking", 5).device._kernels.path)))
"""

ASSEMBLY = """
import json
import numpy as np
import pearl_marl
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.compiler.kernels import compile_kernels
spec, n = pearl_marl.get_spec("CliffWalking"), 64
env = pearl_marl.parallel_env("CliffWalking", n)
env.reset_batch(seed=0)
env.step_batch(np.zeros(n, np.uint8))
found = compile_kernels(spec)
found.advance(SlotMemory(spec, n).bytes, np.zeros(n, np.uint8), np.zeros(2, np.float32),
              np.zeros(n, np.float32), np.zeros(n, np.uint8), n, 0, n)
print(json.dumps([list(f.inspect_asm().values()) for f in (found.step, found.advance)]))
"""

LANES = """
import json
import numpy as np
import pearl_marl
from llvmlite.binding import TargetMachine
texts, emit = [], TargetMachine.emit_object
def emit_object(self, module):  # of long functions, which are compiled by themselves
    texts.append(self.emit_assembly(module))
    return emit(self, module)
TargetMachine.emit_object = emit_object
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.compiler.kernels import compile_kernels
spec, n = pearl_marl.get_spec("Seaquest"), 64
advance = compile_kernels(spec).advance
advance(SlotMemory(spec, n).bytes, np.zeros(n, np.uint8), np.zeros(256, np.float32),
        np.zeros(n, np.float32), np.zeros(n, np.uint8), n, 0, n)
print(json.dumps([*texts, *advance.inspect_asm().values()]))
"""


def process(script: str, cache: Path | str) -> Any:
    """Run a script in a process of its own with its own kernel cache; return what it printed."""
    result = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "PEARL_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        cwd="/",
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Let this process keep its kernels in a folder of the test's."""
    monkeypatch.setenv("PEARL_CACHE_DIR", str(tmp_path))
    cache_folder.cache_clear()
    kernels._loaded.clear()
    yield tmp_path
    cache_folder.cache_clear()
    kernels._loaded.clear()


def test_a_second_process_compiles_nothing(tmp_path: Path) -> None:
    first, second = process(FIRST_STEP, tmp_path), process(FIRST_STEP, tmp_path)
    assert Path(first["path"]).parent.parent == tmp_path
    assert second["path"] == first["path"]
    assert first["misses"] == [1, 1], "a fresh cache cannot have had them"
    assert first["compiled"] > 0
    assert second["misses"] == [0, 0]
    assert second["hits"] == [1, 1]
    assert second["compiled"] == 0
    assert second["obs"] == first["obs"]


def test_processes_that_begin_together_compile_once(tmp_path: Path) -> None:
    """Shards do, on a machine that has not had their kernel yet."""
    with ThreadPoolExecutor(2) as pool:
        begun = list(pool.map(process, [FIRST_STEP] * 2, [tmp_path] * 2))
    assert np.sum([each["misses"] for each in begun], 0).tolist() == [1, 1]


def test_a_new_kernel_is_announced_once(cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compiling takes seconds."""
    path = kernels.compile_kernels(SPEC).path
    text = f"pearl: compiling {path.stem} at its first calls; kept in {path.parent}\n"
    assert capsys.readouterr().err == text
    kernels._loaded.clear()
    kernels.compile_kernels(SPEC)
    assert capsys.readouterr().err == ""


def test_a_cache_that_cannot_be_written(tmp_path: Path) -> None:
    """A file where the folder should be refuses everyone, root included."""
    (tmp_path / "file").write_text("")
    path = Path(process(PATH, tmp_path / "file"))
    assert tmp_path not in path.parents
    assert not path.exists(), "a temporary folder goes with its process"
    assert (tmp_path / "file").read_text() == ""


def test_a_folder_that_is_read_only(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: Any, **kwargs: Any) -> Any:
        raise PermissionError(13, "read-only file system")

    assert cache_folder("kernels") == cache / "kernels"
    cache_folder.cache_clear()
    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    folder = cache_folder("kernels")
    assert cache not in folder.parents
    assert folder.is_dir()


def test_the_source_can_be_read(cache: Path) -> None:
    for spec in (SPEC, DRIFT, LADDER):
        path = kernels.compile_kernels(spec).path
        assert path.parent == cache / "kernels"
        text = path.read_text()
        assert spec.name in text
        assert not re.search(r"\$\w", text), "a part of the template was left out"
        compile(text, str(path), "exec")


@pytest.mark.parametrize("spec", [SPEC, DRIFT, LADDER, SLIDE, pearl_marl.get_spec("Seaquest")])
def test_no_name_of_a_field_can_be_in_the_way(spec: EnvSpec) -> None:
    """What is named after a field begins with one of the prefixes, and nothing else does."""
    observed = tuple(dataclasses.replace(f, name=f"{f.name}_mine") for f in spec.observation)
    mine = renamed(dataclasses.replace(spec, observation=observed), [f"{f.name}_mine" for f in spec.state])
    text = cuda_source(mine)
    kernels_alone = text.split("@kernel", 1)[1]
    names = set(re.findall(r"\b[A-Za-z_]\w*", kernels_alone))
    ours = {name for name in names if name.endswith("_mine")}
    assert ours
    for name in names:
        prefixes = [prefix for prefix in PREFIXES if name.startswith(f"{prefix}_")]
        if name in ours:
            assert len(prefixes) == 1
            assert f"    {prefixes[0]}_x " in text, "the first lines say what it is"
        else:
            # What follows is no name that a field can have.
            assert not prefixes or re.fullmatch(r"at_(elapsed|ended)", name)


@pytest.mark.parametrize("names", [("uint8_equal", "np"), ("for", "golden_step")])
def test_fields_may_be_named_like_anything_in_a_kernel(cache: Path, names: tuple[str, str]) -> None:
    specs = SPEC, renamed(SPEC, names)
    expected, found = (Native().open(BatchConfig(spec=spec, n_envs=3)) for spec in specs)
    for device in (expected, found):
        device.reset(seed=1)
    actions = np.array([0, 1, 2], np.uint8)
    np.testing.assert_array_equal(expected.step(actions).obs, found.step(actions).obs)


# What has to make another kernel. Each pair of functions differs in one thing only.


def with_step(move: Callable[..., Any]) -> EnvSpec:
    """Return a spec whose step moves to another row."""

    def step(state: Any, action: Any, draws: Any) -> Any:
        return state._replace(row=move(state.row) & 3), 0, 0

    return dataclasses.replace(SPEC, golden=SPEC.golden._replace(step=step))


def by_closure(k: int) -> Callable[..., Any]:
    def move(row: Any) -> Any:
        return row + k

    return move


def by_default(k: int) -> Callable[..., Any]:
    def move(row: Any, more: int = k) -> Any:
        return row + more

    return move


def using_global(row: Any) -> Any:
    return row + AMOUNT


def using_table(row: Any) -> Any:
    return AMOUNTS[row]


def using_helper(row: Any) -> Any:
    return row + add(row)


def using_module(row: Any) -> Any:
    return row + numbers.AMOUNT


def in_globals(function: Any, **names: Any) -> Callable[..., Any]:
    """Return the function with other things behind the names it uses."""
    return types.FunctionType(function.__code__, {**function.__globals__, **names})


AMOUNT = 0
AMOUNTS = np.arange(4)
add: Any = None
numbers = types.ModuleType("numbers_of_a_test")


def helper(k: int) -> Callable[..., Any]:
    def add(row: Any) -> Any:
        return row + k

    return add


def helper_of_helper(k: int) -> Callable[..., Any]:
    inner = helper(k)

    def add(row: Any) -> Any:
        return inner(row)

    return add


def module(k: int) -> types.ModuleType:
    result = types.ModuleType("numbers_of_a_test")
    result.AMOUNT = k  # type: ignore[attr-defined]
    return result


CHANGES = [
    pytest.param(by_closure, id="closure"),
    pytest.param(by_default, id="default argument"),
    pytest.param(lambda k: in_globals(using_global, AMOUNT=k), id="global"),
    pytest.param(lambda k: in_globals(using_table, AMOUNTS=np.arange(k, k + 4)), id="global array"),
    pytest.param(lambda k: in_globals(using_helper, add=helper(k)), id="helper"),
    pytest.param(lambda k: in_globals(using_helper, add=helper_of_helper(k)), id="helper of a helper"),
    pytest.param(lambda k: in_globals(using_helper, add=numba.njit(helper(k))), id="compiled helper"),
    pytest.param(lambda k: in_globals(using_module, numbers=module(k)), id="constant of a module"),
]


@pytest.mark.parametrize("make", CHANGES)
def test_a_change_makes_another_kernel(cache: Path, make: Callable[[int], Any]) -> None:
    same, again, other = (kernels.compile_kernels(with_step(make(k))).path for k in (1, 1, 2))
    assert same == again, "or every process would compile anew"
    assert same != other, "or a stale kernel would be loaded"


class Amounts:
    """A class of an author's, of which each test has its own."""


def amounts(k: int) -> Any:
    return type("Amounts", (Amounts,), {"AMOUNT": k, "added": helper(k)})


OBJECTS: dict[str, Callable[[int], Any]] = {
    "dict": lambda k: {"amount": k},
    "set": lambda k: {k, 7},
    "class": amounts,
    "object of a class": lambda k: amounts(k)(),
    "functions": lambda k: [helper(k), helper(3)],
    "functions of a dict": lambda k: {"add": (helper(k),)},
    "part of a function": lambda k: functools.partial(helper(3), k),
    "method": lambda k: amounts(k)().added,
}


@pytest.mark.parametrize("what", OBJECTS)
def test_a_change_in_an_object_is_another_fingerprint(what: str) -> None:
    """Or a core that was generated before would stand for the new function."""
    same, again, other = (fingerprint(in_globals(using_global, AMOUNT=OBJECTS[what](k))) for k in (1, 1, 2))
    assert same == again
    assert same != other


def test_other_changes_make_another_kernel(cache: Path) -> None:
    paths = {
        kernels.compile_kernels(spec).path
        for spec in (
            SPEC,
            SPEC.with_options(is_slippery=True),
            dataclasses.replace(SPEC, rewards=(-1.0, -100.0, 3.0), reward=DRIFT.state[1]),
            dataclasses.replace(SPEC, golden=SPEC.golden._replace(initial=lambda draws: State(0, 0))),
            dataclasses.replace(SPEC, golden=SPEC.golden._replace(observe=lambda state: state.column)),
        )
    }
    assert len(paths) == 5
    assert kernels.compile_kernels(SPEC.with_options(is_slippery=False)).path in paths


def test_nested_functions_hash_alike_in_every_process(tmp_path: Path) -> None:
    """The code of an inner function must not be told apart by where it lies in memory."""
    script = """
import json, dataclasses, pearl_marl
from pearl_marl.compiler import kernels
spec = pearl_marl.get_spec("CliffWalking")
waste = [object() for _ in range(%d)]
def observe(state):
    def inner(x):
        return x
    return inner(state.column)
golden = spec.golden._replace(observe=observe)
print(json.dumps(str(kernels.compile_kernels(dataclasses.replace(spec, golden=golden)).path)))
"""
    assert process(script % 1, tmp_path) == process(script % 100_000, tmp_path)


def test_helpers_stay_plain_python() -> None:
    """Compiling a golden function must not change it, nor what it calls, for anyone else."""
    before = dict(vars(rng))
    kernels.compile_kernels(SPEC.with_options(is_slippery=True))
    assert dict(vars(rng)) == before
    assert isinstance(rng.mix32, types.FunctionType)


def has_avx2() -> bool:
    if platform.machine() not in ("x86_64", "AMD64"):
        return False
    try:
        return " avx2 " in Path("/proc/cpuinfo").read_text()
    except OSError:
        return False


@pytest.mark.skipif(not has_avx2(), reason="looks for AVX2 instructions, which this CPU has not")
def test_the_step_is_simd_code(tmp_path: Path) -> None:
    """Sums of bytes in 32- or 64-byte registers can only come from rows and columns of many slots."""
    step, advance = process(ASSEMBLY, tmp_path)
    for name, versions in (("step", step), ("advance", advance)):
        for text in versions:
            wide = re.findall(r"\bvp(?:add|sub)b\s[^\n]*%[yz]mm", text)
            assert len(wide) >= 3, f"{name} adds and subtracts bytes one by one"
            if name == "advance":  # a gather would be put together byte by byte
                assert not re.search(r"\bvpinsr[bw]\b", text), f"{name} looks bytes up one by one"
            assert re.search(r"\bvpcmp\w*b\s[^\n]*%[yz]mm", text), f"{name} compares bytes one by one"


@pytest.mark.skipif(not has_avx2(), reason="looks for AVX2 instructions, which this CPU has not")
def test_a_step_of_many_fields_is_simd_code(tmp_path: Path) -> None:
    """Where it has too many words to check for overlaps, LLVM leaves the loop scalar: a fifth as fast."""
    text = "".join(process(LANES, tmp_path))
    # With a scalar step 173 were left, in the loops that copy fields.
    assert len(re.findall(r"\bvp\w+\s[^\n]*%[xyz]mm", text)) > 400


def test_u32_of_a_draw_is_what_numpy_has() -> None:
    """The generator's twin in a kernel: one draw a slot, at both ends of the slot numbers."""
    compiled = returning(rng.draw)
    with np.errstate(over="ignore"):
        for slot in (0, 1, 2**31, 2**32 - 1):
            keys = u32(0x80000001), u32(0xFFFFFFFF)
            assert compiled(u32(slot), *keys) == (rng.draw(u32(slot), *keys),)


def test_the_source_of_a_spec_is_made_once() -> None:
    spec = SPEC.with_options(is_slippery=True)
    assert kernel_source(spec) is kernel_source(spec)
