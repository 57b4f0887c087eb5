"""What ``pearl bench steps`` times: this package, from its bare kernel to dicts by agent, and its peers."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.base.arrays import Array
from pearl_marl.batch.actions import encode, random_actions, room_for_words
from pearl_marl.batch.config import worlds_of
from pearl_marl.batch.results import check_memory
from pearl_marl.batch.rewards import padded
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.batch.step import on_host
from pearl_marl.benchmark.measure import Contender, Game, Step, UnavailableError
from pearl_marl.benchmark.peers import ASYNCHRONOUS, peers
from pearl_marl.benchmark.tables import BATCH, KERNEL
from pearl_marl.compiler import cuda_kernels
from pearl_marl.compiler.kernels import compile_kernels
from pearl_marl.devices import BatchConfig, Cuda, Device, Native, Rtl, cuda
from pearl_marl.errors import DeviceError
from pearl_marl.interfaces.parallel import parallel_env
from pearl_marl.interfaces.vector import make_vec
from pearl_marl.spec import EnvSpec

one_thread = partial(Native, threads=1)


def contenders(spec: EnvSpec, n: int) -> list[Contender]:
    """Return this package at each of its levels, and its peers, for ``n`` agents of one environment."""
    check_memory(BatchConfig(spec=spec, n_envs=worlds_of(spec, n)))
    actions = random_actions(spec, np.random.default_rng(0), n)
    kernel = "golden step and float32 rewards; no observations, no resets"
    if spec.mask_fields:
        kernel += "; actions legal or not"
    checked = "all result arrays, checked actions"
    kept = f"{checked}, yours to keep"
    unread, read = (partial(_pettingzoo, read=read) for read in (False, True))
    rtl = "the FPGA design under Verilator, by backdoor; one thread"
    floor = "writing zeros over what a step returns: the floor"
    tensors = "all results, yours to keep, as tensors on the GPU; actions there"

    def ours(name: str, counts: str, make: Callable[[EnvSpec, Array], Step | Game], **more: Any) -> Contender:
        return Contender(name, counts, n, partial(make, spec, actions), ours=True, **more)

    return [
        ours(KERNEL, kernel, _kernel),
        ours("step_batch, copy=False", f"{checked}; one thread", partial(_batch, copy=False)),
        ours(BATCH, f"{kept}; one thread", _batch),
        ours("step_batch, int64 actions", f"{kept}; one thread", partial(_batch, dtype=np.int64)),
        ours("step_batch, threads=None", f"{kept}; as many threads as pay", partial(_batch, device=Native)),
        ours("PettingZoo step, array actions", "five dicts that are not read; one thread", unread),
        ours("PettingZoo step, dict actions", "five dicts, every key read; one thread", read),
        ours("Gymnasium VectorEnv step", "arrays and infos, int64 actions; one thread", _vector),
        ours("step_batch, device='rtl'", rtl, simulated),
        ours("(memory) filling the result arrays", floor, _write_results),
        ours("kernel only, device='cuda'", kernel, _gpu_kernel, wait=_wait_for_gpu),
        ours("step_batch, device='cuda'", tensors, _tensors, wait=_wait_for_gpu),
        *peers(spec, n),
    ]


def compared(spec: EnvSpec, n: int) -> list[Contender]:
    """Return those of the contenders that the table of all environments has."""
    ours = KERNEL, BATCH
    return [c for c in contenders(spec, n) if c.name in ours or not (c.ours or c.name == ASYNCHRONOUS)]


def _kernel(spec: EnvSpec, actions: Array) -> Step:
    n, worlds = len(actions), worlds_of(spec, len(actions))
    words = encode(actions, spec, room_for_words(spec, n)).reshape(-1)
    kernels = compile_kernels(spec)
    memory = SlotMemory(spec, worlds).bytes
    table = padded(spec, spec.rewards or ())
    rewards, terminations = np.empty(n, np.float32), np.empty(n, np.uint8)
    return lambda: kernels.advance(memory, words, table, rewards, terminations, worlds, 0, worlds)


def _repeated(
    spec: EnvSpec,
    env: Any,
    actions: Array,
    step: Callable[[Any], Any],
    convert: Callable[[Array], Any] = lambda actions: actions,
) -> Step | Game:
    """Return a step with the same actions again and again; where there are masks, with legal ones each time.

    ``convert`` turns actions into the argument of ``step``.
    """
    if not spec.mask_fields:
        converted = convert(actions)
        return lambda: step(converted)
    rng, n = np.random.default_rng(0), len(actions)
    return Game(lambda: convert(random_actions(spec, rng, n, on_host(env.device.action_masks))), step)


def _batch(
    spec: EnvSpec,
    actions: Array,
    device: Callable[[], Device] = one_thread,
    copy: bool = True,
    dtype: npt.DTypeLike | None = None,
) -> Step | Game:
    env = parallel_env(spec.name, len(actions), device=device(), copy=copy, **spec.options)
    env.reset_batch(seed=0)
    return _repeated(
        spec, env, actions, env.step_batch, lambda chosen: chosen.astype(dtype or spec.action_dtype)
    )


def simulated(spec: EnvSpec, actions: Array, device: Callable[[], Rtl] = Rtl) -> Step | Game:
    """Return the step of a simulated device, which not every machine can build."""
    try:
        return _batch(spec, actions, device, copy=False, dtype=actions.dtype)
    except DeviceError as error:
        raise UnavailableError(str(error).splitlines()[0]) from None


def _pettingzoo(spec: EnvSpec, actions: Array, read: bool) -> Step | Game:
    env = parallel_env(spec.name, len(actions), device=one_thread(), **spec.options)
    env.reset(seed=0)
    if not read:
        return _repeated(spec, env, actions, env.step)
    return _repeated(
        spec,
        env,
        actions,
        lambda by_agent: [len(dict(results)) for results in env.step(by_agent)],
        lambda chosen: dict(zip(env.possible_agents, chosen.tolist(), strict=True)),
    )


def _vector(spec: EnvSpec, actions: Array) -> Step | Game:
    if spec.agents > 1:
        raise UnavailableError(
            f"Gymnasium's vector form has one agent each; worlds of {spec.name} have several"
        )
    envs = make_vec(spec.name, len(actions), device=one_thread(), **spec.options)
    envs.reset(seed=0)
    return _repeated(spec, envs, actions, envs.step, lambda chosen: chosen.astype(np.int64))


def _write_results(spec: EnvSpec, actions: Array) -> Step:
    worlds = worlds_of(spec, len(actions))
    device = one_thread().open(BatchConfig(spec=spec, n_envs=worlds, copy=False))
    device.reset(seed=0)
    masks = device.action_masks
    if masks is not None:
        actions = random_actions(spec, np.random.default_rng(0), len(actions), masks)
    step = device.step(actions)
    arrays = step.arrays[:4] + step.arrays[5:]  # few final observations are written

    def write() -> None:
        for array in arrays:
            array.fill(0)

    return write


def _wait_for_gpu() -> None:
    importlib.import_module("numba.cuda").synchronize()


def _gpu() -> Any:
    """Return Numba's module for the GPU, if there is one to be timed."""
    try:
        found = cuda.available()
    except DeviceError as error:
        raise UnavailableError(str(error)) from None
    if cuda_kernels.simulated():
        raise UnavailableError("cuda: numba's simulator stands in for a GPU here, and its times mean nothing")
    return found


def _gpu_kernel(spec: EnvSpec, actions: Array) -> Step:
    module, n, worlds = _gpu(), len(actions), worlds_of(spec, len(actions))
    advance = cuda_kernels.compile_cuda_kernels(spec).advance
    memory = module.to_device(SlotMemory(spec, worlds).bytes)
    words = module.to_device(encode(actions, spec, room_for_words(spec, n)).reshape(-1))
    table = module.to_device(padded(spec, spec.rewards or ()) if spec.rewards else np.zeros(1, np.float32))
    rewards, terminations = module.device_array(n, np.float32), module.device_array(n, np.uint8)
    launch = advance[cuda.grid(module, worlds)]
    return lambda: launch(memory, words, table, rewards, terminations, worlds)


def _tensors(spec: EnvSpec, actions: Array) -> Step | Game:
    _gpu()
    try:
        env = parallel_env(spec.name, len(actions), device=Cuda(results="torch"), **spec.options)
        env.reset_batch(seed=0)
    except DeviceError as error:
        raise UnavailableError(str(error)) from None
    import torch

    return _repeated(spec, env, actions, env.step_batch, lambda chosen: torch.from_numpy(chosen).cuda())
