"""Every level of this package, from the bare kernel to dicts an agent."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from pearl_marl.batch.actions import encode, random_actions
from pearl_marl.batch.rewards import padded
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.batch.step import Array
from pearl_marl.benchmark.measure import Contender, Step, UnavailableError
from pearl_marl.compiler.kernels import compile_kernels
from pearl_marl.devices import BatchConfig, Device, Native, Rtl
from pearl_marl.errors import DeviceError
from pearl_marl.interfaces.parallel import parallel_env
from pearl_marl.interfaces.vector import make_vec
from pearl_marl.spec import EnvSpec


def ours(spec: EnvSpec, n: int) -> list[Contender]:
    """Return every level of this package on the CPU, and the simulated hardware."""
    actions = random_actions(spec, np.random.default_rng(0), n)
    narrow, delivered = spec.action.dtype, "all result arrays, checked actions"

    def batch(copy: bool, threads: int | None, dtype: npt.DTypeLike) -> Callable[[], Step]:
        return partial(_batch, spec, actions, partial(Native, threads), copy, dtype)

    rows: list[tuple[str, str, Callable[[], Step]]] = [
        (
            "kernel only",
            "golden step and float32 rewards; no observations, no resets",
            partial(_kernel, spec, actions),
        ),
        ("step_batch, copy=False", f"{delivered}; one thread", batch(False, 1, narrow)),
        ("step_batch", f"{delivered}, yours to keep; one thread", batch(True, 1, narrow)),
        ("step_batch, int64 actions", f"{delivered}, yours to keep; one thread", batch(True, 1, np.int64)),
        (
            "step_batch, threads=None",
            f"{delivered}, yours to keep; as many threads as pay",
            batch(True, None, narrow),
        ),
        (
            "PettingZoo step, array actions",
            "five dicts, nobody looks inside; one thread",
            partial(_pettingzoo_arrays, spec, actions),
        ),
        (
            "PettingZoo step, dict actions",
            "five dicts, every key read; one thread",
            partial(_pettingzoo_dicts, spec, actions),
        ),
        (
            "Gymnasium VectorEnv step",
            "arrays and infos, int64 actions; one thread",
            partial(_vector, spec, actions),
        ),
        (
            "step_batch, device='rtl'",
            "the FPGA design under Verilator, by backdoor; one thread",
            partial(simulated, spec, actions, Rtl),
        ),
        (
            "(memory) filling the result arrays",
            "writing zeros over what a step returns: the floor",
            partial(_filling, spec, actions),
        ),
    ]
    return [Contender(name, counts, n, make, ours=True) for name, counts, make in rows]


def _kernel(spec: EnvSpec, actions: Array) -> Step:
    n = len(actions)
    words = encode(actions, spec, np.empty(n, spec.action.dtype))
    kernels = compile_kernels(spec)
    memory = SlotMemory(spec, n).bytes
    table = padded(spec, spec.rewards or ())
    rewards, terminations = np.empty(n, np.float32), np.empty(n, np.uint8)
    return lambda: kernels.advance(memory, words, table, rewards, terminations, n, 0, n)


def _batch(
    spec: EnvSpec, actions: Array, device: Callable[[], Device], copy: bool, dtype: npt.DTypeLike
) -> Step:
    env = parallel_env(spec.name, len(actions), device=device(), copy=copy, **spec.options)
    env.reset_batch(seed=0)
    given = actions.astype(dtype)
    return lambda: env.step_batch(given)


def simulated(spec: EnvSpec, actions: Array, device: Callable[[], Rtl]) -> Step:
    """Return the step of a simulated device, which not every machine can build."""
    try:
        return _batch(spec, actions, device, copy=False, dtype=actions.dtype)
    except DeviceError as error:
        raise UnavailableError(str(error).splitlines()[0]) from None


def _pettingzoo_arrays(spec: EnvSpec, actions: Array) -> Step:
    env = parallel_env(spec.name, len(actions), device=Native(threads=1), **spec.options)
    env.reset(seed=0)
    return lambda: env.step(actions)


def _pettingzoo_dicts(spec: EnvSpec, actions: Array) -> Step:
    env = parallel_env(spec.name, len(actions), device=Native(threads=1), **spec.options)
    env.reset(seed=0)
    by_agent = dict(zip(env.possible_agents, actions.tolist(), strict=True))
    return lambda: [len(dict(results)) for results in env.step(by_agent)]


def _vector(spec: EnvSpec, actions: Array) -> Step:
    envs = make_vec(spec.name, len(actions), device=Native(threads=1), **spec.options)
    envs.reset(seed=0)
    given = actions.astype(np.int64)
    return lambda: envs.step(given)


def _filling(spec: EnvSpec, actions: Array) -> Step:
    device = Native(threads=1).open(BatchConfig(spec=spec, n_envs=len(actions), copy=False))
    device.reset(seed=0)
    arrays = device.step(actions)[:4]

    def write() -> None:
        for array in arrays:
            array.fill(0)

    return write
