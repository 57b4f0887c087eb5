"""From golden functions to compiled kernels for a GPU.

The golden functions are those of the CPU's kernels (:mod:`~pearl_marl.compiler.kernels`), compiled once more,
by numba-cuda; :mod:`~pearl_marl.compiler.cuda_source` makes what stands around them. Under numba's simulator
the same source runs as plain Python.
"""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.base.machine_code import Entries
from pearl_marl.compiler import scalar_words
from pearl_marl.compiler.cuda_source import cuda_rollout_source, cuda_source
from pearl_marl.compiler.kernels import functions, kernel_name
from pearl_marl.compiler.loading import fingerprint, load
from pearl_marl.golden import GoldenFunction
from pearl_marl.golden.rebinding import rebound
from pearl_marl.spec import EnvSpec

THREADS = 128
"""Threads of a block. A processor holds two such blocks even of Seaquest's step, with its 248 registers."""


class CudaKernels(NamedTuple):
    """The kernels of one environment, for numba-cuda to launch, and the file where their source can be read.

    ``reset(memory, stored, mask, results, seed_0, seed_1, tick, first_slot, use_stored, n)``
        starts an episode in every slot whose mask is set, and writes all observations.
    ``step(memory, stored, actions, table, results, wrong, rewards_at, terminations_at, truncations_at,
    final_at, seed_0, seed_1, tick, first_slot, limit, next_step, use_stored, numbers, n)``
        steps every slot. ``actions`` are numbers of any dtype, or words unless ``numbers``. Where one is out
        of range the slot takes the least instead, and ``wrong`` keeps the lowest ``tick << 32 | slot`` so
        far. Final observations are written for a slot that ended, and in SAME_STEP mode only.
    ``advance(memory, actions, table, rewards, terminations, n)``
        does the golden step and the rewards alone, for benchmarks.

    ``memory`` and ``stored`` are laid out by :mod:`pearl_marl.batch.slot_memory`, ``results`` by
    :class:`pearl_marl.batch.results.Layout`, both as bytes.
    """

    reset: Any
    step: Any
    advance: Any
    path: Path


def compile_cuda_kernels(spec: EnvSpec) -> CudaKernels:
    """Return the kernels of an environment; they are compiled, or taken from the cache, at their first call.

    A ModuleNotFoundError says that numba-cuda is not installed.
    """
    module, path = _module("cuda", spec, cuda_source(spec), {})
    return CudaKernels(module.reset, module.step, module.advance, path)


def compile_cuda_rollout(spec: EnvSpec, act: GoldenFunction) -> Any:
    """Return the rollout of an environment, for numba-cuda to launch.

    ``rollout(memory, stored, actions, table, results, wrong, network, room, sums, rewards_at,
    terminations_at, truncations_at, final_at, seed_0, seed_1, tick, first_slot, limit, next_step, use_stored,
    steps, n)`` does so many steps of every slot, with what :func:`compile_cuda_kernels` describes. It begins
    with the observations in ``results``. ``act(network, room, observations, at, agent, masks, masks_at,
    where, actions, actions_at, thread)`` writes the words of an agent's action, where ``where`` are slot,
    tick and seed; ``sums`` has the arrays of :class:`pearl_marl.devices.rollouts.Sums`.
    """
    return _module("cuda_rollout", spec, cuda_rollout_source(spec), {"act": act})[0].rollout


def _module(kind: str, spec: EnvSpec, source: str, others: dict[str, GoldenFunction]) -> tuple[Any, Path]:
    """Return the module of a source, and its file; of the functions that it calls, ``others`` stay calls."""
    cuda: Any = import_module("numba.cuda")
    versions = (
        metadata.version("numba"),
        metadata.version("numba-cuda"),
        np.__version__,
        inspect.getsource(scalar_words),
        *(fingerprint(function).hex() for function in others.values()),
    )
    name = f"{kind}_{kernel_name(spec, source, versions)}"
    key = name, simulated()
    if key not in _loaded:
        called: dict[str, Any] = {**functions(spec), **scalar_words.operations()}
        if simulated():
            kernel, inlined = cuda.jit, _wrapping
            if "unpack" in called:
                called["unpack"] = _of_wide_words(called["unpack"])
            called = {name: _wrapping(f) for name, f in {**called, **others}.items()}
        else:
            kernel, compiled = partial(_kernel, cuda, name), partial(cuda.jit, device=True)
            inlined = partial(compiled, forceinline=True)
            done: dict[types.FunctionType, Any] = {}
            called = {name: rebound(f, finish=inlined, done=done) for name, f in called.items()}
            called |= {name: rebound(f, finish=compiled, done=done) for name, f in others.items()}
        _loaded[key] = load(name, source, kernel=kernel, inlined=inlined, cuda=cuda, **called)
    return _loaded[key]


_loaded: dict[tuple[str, bool], tuple[Any, Path]] = {}


def _kernel(cuda: Any, name: str, function: Callable[..., Any]) -> Any:
    """Have numba-cuda compile a function of the kernels of that name, and keep the result with a checksum."""
    entries = Entries(f"{name}-{function.__name__}", import_module("numba.cuda.serialize").dumps)

    class Checked(import_module("numba.cuda.dispatcher").CUDACache):  # type: ignore[misc]
        """Its cache, over our entries."""

        def __init__(self) -> None:
            super().__init__(function)
            self._cache_file = entries

    made = cuda.jit(function)
    vars(made).update(_cache=Checked())  # as its enable_caching() does
    return made


def simulated() -> bool:
    """Return whether numba's simulator stands in for the GPU, as ``NUMBA_ENABLE_CUDASIM=1`` has it."""
    return bool(import_module("numba.cuda.core").config.ENABLE_CUDASIM)


def _of_wide_words(unpack: Callable[..., None]) -> Callable[..., None]:
    """Return what the simulator calls as ``unpack``: sums of NumPy's bytes wrap, compiled ones do not."""

    def called(*words_and_row: Any) -> None:
        *words, row = words_and_row
        unpack(*map(int, words), row)

    return called


def _wrapping(function: GoldenFunction) -> GoldenFunction:
    """Return what the simulator calls, in a new thread: NumPy's scalars warn where they wrap around."""

    def wrapping(*arguments: Any) -> Any:
        with np.errstate(over="ignore"):
            return function(*arguments)

    return wrapping
