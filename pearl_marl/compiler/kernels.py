"""From golden functions to compiled kernels that step a whole batch on the CPU.

Their source is generated, and loaded from a cache (:mod:`pearl_marl.compiler.loading`). Its name there is a
hash of all that a kernel depends on: a changed golden step is a new file, and a warm start compiles nothing.
The loops between golden functions are written by :mod:`~pearl_marl.compiler.kernel_loops`. They depend on
nothing of a spec but what the first lines of the source tell.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import numba
import numpy as np

from pearl_marl.base import object_code
from pearl_marl.base.machine_code import kept_code
from pearl_marl.batch import slot_memory
from pearl_marl.compiler import (
    agents_alike,
    flag_runs,
    kernel_ends,
    kernel_loops,
    llvm_functions,
    llvm_loops,
    llvm_planes,
    llvm_words,
)
from pearl_marl.compiler.kernel_loops import KERNELS, KernelLoops
from pearl_marl.compiler.loading import fingerprint, load
from pearl_marl.compiler.straight_line import golden_functions, orders
from pearl_marl.golden import GoldenFunction, rebinding, rng
from pearl_marl.spec import EnvSpec, Itself

# LLVM turns no loop that still has a call in it into SIMD code, and left to itself it keeps a long
# function as one.
_FORCE_INLINE = True

# C calls none of it, and Python the kernels only: Numba need not compile versions for others.
_NOT_FOR_C: dict[str, Any] = {"no_cfunc_wrapper": True}
_FOR_KERNELS: dict[str, Any] = {"no_cpython_wrapper": True, **_NOT_FOR_C}


class Kernels(NamedTuple):
    """The compiled functions of one environment, and the file where their source can be read.

    Results are those of :attr:`pearl_marl.batch.step.BatchStep.arrays`: where there are masks, and worlds of
    several agents, ``action_masks`` and ``alive`` follow the observations that come last.

    ``reset(memory, stored, mask, views, seed_0, seed_1, tick, first_slot, use_stored, n, lo, hi)``
        starts an episode in every slot of ``lo .. hi - 1`` whose mask is set, and writes the observation of
        every slot of the range. ``views`` is a tuple of observations, then masks and ``alive``, where there
        are any. Elapsed steps are left to the caller.
    ``step(arguments, actions, table, lo, hi)``
        steps that range. ``arguments`` is a ``uint64`` array of addresses and settings: see
        :data:`~pearl_marl.compiler.kernel_loops.STEP_ARGUMENTS`. ``elapsed`` are the steps of each slot's
        episode, which ``memory`` has a column for, in narrower words. ``final_observations`` are written for
        a block in which a slot ended. Returns 1 where all actions were in the action space, if that was to be
        checked; if not, nothing has been done.
    ``deliver(words, observations, n)``
        turns the words of ``n`` observations, a tuple of an array a field, into the observations themselves.
    ``results(words, codes, end_words, stored, table, results, seed_0, seed_1, tick, first_slot,
    next_step, use_stored, n, lo, hi)``
        does so with all the words of a step: of observations, rewards and ends. Unless ``next_step``, a slot
        that ended gets the first observation of its next episode, which begins at ``tick``. Words of
        observations end with those of masks. ``end_words`` is a tuple; of several agents its second entry is
        the column ``ended`` as it was before the step, 0 for a slot that was resetting. ``results`` is a
        tuple of the results' arrays.
    ``advance(memory, actions, table, rewards, terminations, n, lo, hi)``
        does the golden step and the rewards alone, for benchmarks.

    ``memory`` and ``stored`` are laid out by :mod:`pearl_marl.batch.slot_memory`; flags are ``uint8``;
    ``lo`` is a multiple of :data:`pearl_marl.compiler.kernel_loops.BLOCK`. All release the GIL.
    """

    reset: Callable[..., None]
    step: Callable[..., None]
    deliver: Callable[..., None]
    results: Callable[..., None]
    advance: Callable[..., None]
    path: Path


def kernel_source(spec: EnvSpec, counter: np.dtype[Any] | None = None) -> str:
    """Return the source of the kernels of ``spec``, golden functions and what Numba compiles.

    ``counter`` is the dtype of elapsed steps; ``None`` is what the environment's own time limit takes.
    """
    return _source(Itself(spec), _counter(spec, counter))


def _counter(spec: EnvSpec, counter: np.dtype[Any] | None) -> str:
    return str(counter or slot_memory.counter_dtype(spec.max_cycles or 0))


@functools.lru_cache(maxsize=64)
def _source(itself: Itself, counter: str) -> str:
    spec = itself.spec
    facts = {
        "state": spec.state,
        "actions": spec.action_fields,
        "action": (spec.action_dtype, getattr(spec.action_space, "n", None)),
        "observation": (spec.observation, spec.observation_size, str(spec.observation_dtype)),
        "unpack": spec.unpack is not None,
        "masks": spec.mask_fields,
        "reward": (spec.reward, spec.rewards is not None),
        "agents": spec.agents,
        "draws": (spec.reset_draws, spec.step_draws),
        "elapsed": counter,
    }
    if agents_alike.is_crowded(spec):
        # The order decides too, and equal functions of first agents may differ in it.
        facts["orders"] = orders(spec)
    told = (f"{name}: {fact!r}" for name, fact in facts.items())
    head = [f'"""The kernels of {spec.name}, generated by PEARL-MARL from its spec.', "", *told, '"""']
    lines = [*head, *golden_functions(spec, in_turn=True)]
    for name, arguments in KERNELS.items():
        taken = ", ".join(arguments)
        lines += ["", "", "@kernel", f"def {name}({taken}):", f"    return write_{name}({taken})"]
    return "\n".join([*lines, ""])


def compile_kernels(spec: EnvSpec, counter: np.dtype[Any] | None = None) -> Kernels:
    """Return the kernels of an environment; those in the cache are loaded at their first call.

    ``counter`` is the dtype of elapsed steps, as :func:`kernel_source` takes it.
    """
    name = _name(Itself(spec), _counter(spec, counter))
    if name not in _loaded:
        golden: dict[str, Any] = {}
        unpack = spec.positional.unpack
        compiled = None if unpack is None else _compiled(unpack)
        loops = KernelLoops(spec, _counter(spec, counter), golden, compiled)
        writing = {
            f"write_{kernel}": llvm_functions.written(getattr(loops, kernel), arguments, loops.compiled)
            for kernel, arguments in KERNELS.items()
        }
        module, path = load(
            name,
            kernel_source(spec, counter),
            kernel=partial(_kernel, name),
            inlined=lambda function: golden.setdefault(function.__name__, function),
            **llvm_words.operations(),
            **writing,
        )
        made: dict[str, Any] = {kernel: getattr(module, kernel) for kernel in KERNELS}
        _loaded[name] = Kernels(**made, path=path)
    return _loaded[name]


_loaded: dict[str, Kernels] = {}
"""By name, which is a hash of all that a kernel depends on."""


@functools.lru_cache(maxsize=64)
def _name(itself: Itself, counter: str) -> str:
    """Return the name of a spec's kernels; to read and hash all that it depends on takes milliseconds."""
    spec = itself.spec
    parts = (
        agents_alike,
        *(flag_runs, kernel_ends, kernel_loops, llvm_functions, llvm_loops, llvm_planes, llvm_words),
        *(object_code, rebinding, rng, slot_memory),
    )
    versions = (
        numba.__version__,
        llvmlite.__version__,
        np.__version__,
        f"{_FORCE_INLINE=}",
        *map(inspect.getsource, parts),
    )
    return kernel_name(spec, kernel_source(spec, np.dtype(counter)), versions)


def _kernel(name: str, function: Callable[..., None]) -> Any:
    """Have Numba compile a function of the kernels of that name."""
    jit = numba.njit(nogil=True, error_model="numpy", **_NOT_FOR_C)
    return kept_code(jit(function), f"{name}-{function.__name__}")


def functions(spec: EnvSpec) -> dict[str, GoldenFunction]:
    """Return the functions that a kernel's source calls, by the names it has for them."""
    unpack = spec.positional.unpack
    drawing: dict[str, GoldenFunction] = {"key": rng.key, "draw": rng.draw}
    return drawing if unpack is None else drawing | {"unpack": unpack}


def kernel_name(spec: EnvSpec, source: str, versions: Iterable[str]) -> str:
    """Return a name with a hash of all that a kernel depends on."""
    digest = hashlib.sha256(source.encode())
    for part in versions:
        digest.update(part.encode())
    for function in functions(spec).values():
        digest.update(fingerprint(function))
    return f"{spec.name}_{digest.hexdigest()[:16]}"


def _compiled(function: GoldenFunction) -> Any:
    jit = partial(numba.njit, forceinline=_FORCE_INLINE, **_FOR_KERNELS)
    return rebinding.rebound(function, finish=jit, done=dict(llvm_planes.REPLACEMENTS))
