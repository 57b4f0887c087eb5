"""What this package does on a GPU: the bare kernel, and steps whose results stay there."""

from __future__ import annotations

import importlib
from functools import partial
from typing import Any

import numpy as np

from pearl_marl.batch.actions import encode, random_actions
from pearl_marl.batch.rewards import padded
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.benchmark.measure import Contender, Step, UnavailableError
from pearl_marl.compiler.cuda_kernels import compile_cuda_kernels, simulated
from pearl_marl.devices import Cuda, cuda
from pearl_marl.errors import DeviceError
from pearl_marl.interfaces.parallel import parallel_env
from pearl_marl.spec import EnvSpec


def on_gpu(spec: EnvSpec, n: int) -> list[Contender]:
    """Return both levels at which this package is timed on a GPU."""
    rows = [
        (
            "kernel only, device='cuda'",
            "golden step and float32 rewards; no observations, no resets",
            _kernel,
        ),
        (
            "step_batch, device='cuda'",
            "all results, yours to keep, as tensors on the GPU; actions there",
            _tensors,
        ),
    ]
    return [
        Contender(name, counts, n, partial(make, spec, n), ours=True, wait=_wait)
        for name, counts, make in rows
    ]


def _wait() -> None:
    importlib.import_module("numba.cuda").synchronize()


def _found() -> Any:
    """Return Numba's module for the GPU, if there is one to be timed."""
    try:
        found = cuda.available()
    except DeviceError as error:
        raise UnavailableError(str(error)) from None
    if simulated():
        raise UnavailableError("cuda: numba's simulator stands in for a GPU here, and its times mean nothing")
    return found


def _kernel(spec: EnvSpec, n: int) -> Step:
    module = _found()
    advance = compile_cuda_kernels(spec).advance
    memory = module.to_device(SlotMemory(spec, n).bytes)
    words = encode(random_actions(spec, np.random.default_rng(0), n), spec, np.empty(n, spec.action.dtype))
    actions = module.to_device(words)
    table = module.to_device(padded(spec, spec.rewards or ()) if spec.rewards else np.zeros(1, np.float32))
    rewards, terminations = module.device_array(n, np.float32), module.device_array(n, np.uint8)
    launch = advance[cuda.grid(module, n)]
    return lambda: launch(memory, actions, table, rewards, terminations, n)


def _tensors(spec: EnvSpec, n: int) -> Step:
    _found()
    try:
        env = parallel_env(spec.name, n, device=Cuda(results="torch"), **spec.options)
        env.reset_batch(seed=0)
    except DeviceError as error:
        raise UnavailableError(str(error)) from None
    import torch

    actions = torch.from_numpy(random_actions(spec, np.random.default_rng(0), n)).cuda()
    return lambda: env.step_batch(actions)
