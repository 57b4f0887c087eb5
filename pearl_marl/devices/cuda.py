"""A GPU as a device: the golden step compiled by numba-cuda, one launch a step.

The slots stay on the GPU, in the columns of :mod:`~pearl_marl.batch.slot_memory`. So do results, if they are
asked for as tensors: then a step only queues its launch and returns, and nothing waits for the GPU.
"""

from __future__ import annotations

import warnings
from bisect import bisect_right
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.batch.actions import limits
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.results import ResultArrays, ResultLayout
from pearl_marl.batch.rollout import Rollout
from pearl_marl.batch.slot_memory import SlotMemory, size
from pearl_marl.batch.step import BatchStep, Observed, on_host
from pearl_marl.checks import checked_choice
from pearl_marl.compiler.cuda_kernels import THREADS, compile_cuda_kernels, compile_cuda_rollout, simulated
from pearl_marl.devices.base import Device
from pearl_marl.devices.rollouts import Sums, in_parts
from pearl_marl.errors import ActionError, DeviceError
from pearl_marl.golden import rng
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.policies.integer_network import IntegerNetwork
from pearl_marl.policies.integer_threads import ThreadArrays, act, room_sizes, thread_network

RESIDENT_THREADS = 2048
"""Threads that a processor of a GPU holds at most. More are not started: each takes slot after slot."""

NOTHING_REFUSED = (1 << 63) - 1


class _OnGpu(NamedTuple):
    """Actions on the GPU as a kernel takes them, and whether they are numbers rather than words."""

    array: Any
    numbers: bool


class Cuda(Device):
    """An NVIDIA GPU.

    Parameters
    ----------
    results
        ``"numpy"``: results are copied to the host, as those of any other device. ``"torch"``: they are
        tensors on the GPU, and so may actions be (a tensor, or anything with ``__cuda_array_interface__``, of
        any dtype of integers, or for a ``Box`` of numbers). Nothing waits for the GPU then. So actions on
        the GPU are checked there: where one is out of range the slot takes the least action instead (of one
        with several fields, the least of each that is out of range), and the next call that waits for the
        GPU raises ActionError (:meth:`synchronize`, :meth:`reset`, :meth:`state`, :meth:`snapshot`).
    """

    name = "cuda"

    def __init__(self, results: str = "numpy") -> None:
        self.results = checked_choice("results", results, ("numpy", "torch"))
        self.tensors = results == "torch"

    def encoded(self, actions: Any) -> Any:
        """Return actions as a step takes them: words on the host, or what is on the GPU already."""
        if self._torch is not None and self.config.spec.masked == "refused":
            # Masks are looked at on the host, so it has to wait for the actions too.
            actions = on_host(actions) if isinstance(actions, self._torch.Tensor) else actions
            return super().encoded(actions)
        on_gpu = self._on_gpu(actions)
        return super().encoded(actions) if on_gpu is None else on_gpu

    def synchronize(self) -> None:
        """Wait until the GPU has done every step.

        Where an action that was on the GPU was out of range, ActionError names the first step and agent.
        """
        self.check_idle("synchronize")
        if self._torch is None:  # every step has waited
            return
        with _failures():
            self._gpu.synchronize()
            first = int(self._wrong.copy_to_host()[0])
            if first == NOTHING_REFUSED:
                return
            self._wrong.copy_to_device(np.array([NOTHING_REFUSED]))
        tick, row = divmod(first, 1 << 32)
        spec = self.config.spec
        space = spec.roles[row % spec.agents].action_space if spec.roles else spec.action_space
        raise ActionError(
            f"agent_{self.config.first_slot * spec.agents + row}: its action at step {tick}, which was on "
            f"the GPU, is out of range; {limits(space)}. The slot took the least one instead, and all since "
            "follows from that"
        )

    def _open(self, config: BatchConfig) -> None:
        self._gpu = available()
        self._torch = _torch() if self.tensors else None
        self._next_step = config.autoreset_mode is AutoresetMode.NEXT_STEP
        spec, n = config.spec, config.n_envs
        with _failures():
            _check_memory(self._gpu, config, self.results)
            self._kernels = compile_cuda_kernels(spec)
            self._grid = grid(self._gpu, n)
            self._memory = self._gpu.to_device(SlotMemory(spec, n).bytes)
            # Without stored initial states the kernels get the memory itself, and do not look.
            stored = config.initial_states == "stored"
            self._stored = self._gpu.to_device(SlotMemory(spec, n).bytes) if stored else self._memory
            count = config.n_agents * len(spec.action_fields)
            self._words = self._gpu.device_array(count, spec.action_dtype)
            self._wrong = self._gpu.to_device(np.array([NOTHING_REFUSED]))
            if self._torch is None:
                self._arrays = ResultArrays(config)
                self._result_layout = self._arrays.layout
                self._block = self._gpu.device_array(self._result_layout.size, np.uint8)
                self._pieces = self._result_layout.pieces(self._block)
                split = self._result_layout.starts[4] or self._result_layout.size
                # All but the final observations, where those have bytes of their own.
                self._first_to_host = self._block[:split]
            else:
                self._result_layout = ResultLayout(config)
                self._dtypes = [getattr(self._torch, str(dtype)) for dtype in self._result_layout.dtypes]
                self._block = None if config.copy else self._new_block()
                self._tensors = None if config.copy else self._in_tensors(self._block)
        self._streams: dict[int, Any] = {}
        self._launches: dict[tuple[Any, Any], Any] = {}
        self._uploaded: Array | None = None

    def _reset(self, mask: Array | None, seed: int | None) -> Observed:
        self.synchronize()
        use_stored = self._stored is not self._memory
        with _failures():
            observed = self._observe(mask, again=use_stored and mask is not None)
            if use_stored and mask is None:
                self._stored.copy_to_device(self._memory, stream=self._stream())
        return observed

    def _observe(self, mask: Array | None, again: bool) -> Observed:
        """Start the masked slots over (all, if ``None``); return what all agents see."""
        n = self.config.n_envs
        flags = np.ones(n, np.uint8) if mask is None else mask.astype(np.uint8)
        flags = self._gpu.to_device(flags, stream=self._stream())
        block = self._block if self._block is not None else self._new_block()
        self._launch(
            self._kernels.reset,
            *(self._memory, self._stored, flags, self._array(block), *self._result_layout.starts[5:]),
            *(*self.seed, rng.signed(self.tick), self.config.first_slot, again, n),
        )
        if self._torch is not None:
            return (self._in_tensors(block) if self._tensors is None else self._tensors).observed
        results, host = self._arrays.take_block()
        for i in (0, *range(5, len(self._pieces))):
            self._pieces[i].copy_to_host(self._result_layout.pieces(host.memory)[i])
        return results.observed

    def _step(self, actions: Array | _OnGpu) -> BatchStep:
        config, layout = self.config, self._result_layout
        with _failures():
            self._upload_rewards()
            if isinstance(actions, _OnGpu):
                words, numbers = actions
            else:
                self._words.copy_to_device(actions.reshape(-1), stream=self._stream())
                words, numbers = self._words, False
            block = self._block if self._block is not None else self._new_block()
            self._launch(
                self._kernels.step,
                *(self._memory, self._stored, words, self._rewards_there, self._array(block), self._wrong),
                *layout.starts[1:],
                *(*self.seed, rng.signed(self.tick), config.first_slot, config.limit),
                *(self._next_step, self._stored is not self._memory, numbers, config.n_envs),
            )
            if self._torch is not None:
                return self._in_tensors(block) if self._tensors is None else self._tensors
            results, host = self._arrays.take_block()
            self._first_to_host.copy_to_host(host.memory[: self._first_to_host.size])
            if layout.starts[4] and results.ended.any():
                self._pieces[4].copy_to_host(layout.pieces(host.memory)[4])
        return results

    def _upload_rewards(self) -> None:
        if self._uploaded is not self.reward_table:
            # Where rewards are computed there is no table, and the kernel does not look.
            table = self.reward_table if self.reward_table.size else np.zeros(1, np.float32)
            self._rewards_there = self._gpu.to_device(table, stream=self._stream())
            self._uploaded = self.reward_table

    def _rollout(
        self, policy: DevicePolicy, steps: int, record: bool, episodes: int | None
    ) -> tuple[Rollout, Observed]:
        if record or not isinstance(policy, IntegerNetwork):
            return super()._rollout(policy, steps, record, episodes)
        slots = SlotMemory(self.config.spec, self.config.n_envs, self._read()[0])
        config = replace(self.config, spec=self.config.spec.in_elements)
        agents, n, layout = config.spec.agents, config.n_envs, ResultLayout(config)
        in_episode = on_host(self.in_episode)
        resetting = (slots.ended & 1).astype(np.bool_).repeat(agents)
        sums: Any = Sums.of(slots.elapsed.repeat(agents), in_episode, resetting, episodes)
        nobody, position = np.zeros(n, np.uint8), (*self.seed, rng.signed(self.tick), config.first_slot)
        with _failures():
            self._upload_rewards()
            block = self._gpu.device_array(layout.size, np.uint8)
            memory = self._memory, self._stored
            first = compile_cuda_kernels(config.spec).reset
            starts = *layout.starts[5:], *position
            mask = self._gpu.to_device(nobody, stream=self._stream())
            self._launch(first, *memory, mask, block, *starts, False, n)
            network = thread_network(policy)
            inputs, outputs = room_sizes(network)
            threads = self._grid[0] * self._grid[1]
            room = ThreadArrays(
                self._gpu.device_array((2, inputs, threads), np.int16),
                self._gpu.device_array((outputs, threads), np.int32),
            )
            there, sums = self._copied(network), self._copied(sums)
            kernel = compile_cuda_rollout(config.spec, act)
            arrays = *memory, self._words, self._rewards_there, block, self._wrong, there, room, sums
            for _, some in in_parts(steps):
                position = (*self.seed, rng.signed(self.tick), config.first_slot)
                how = config.limit, self._next_step, self._stored is not self._memory
                self._launch(kernel, *arrays, *layout.starts[1:], *position, *how, some, n)
                self._gpu.synchronize()
                self.tick = (self.tick + some) & rng.LAST_TICK
            sums = Sums(*(array.copy_to_host() for array in sums))
        observed = self._observe(nobody.astype(np.bool_), again=False)
        return sums.result(steps, {}), observed

    def _copied(self, arrays: Any) -> Any:
        """Return a NamedTuple with its arrays on the GPU."""
        stream = self._stream()
        there = (self._gpu.to_device(x, stream=stream) if isinstance(x, np.ndarray) else x for x in arrays)
        return type(arrays)(*there)

    def _begin(self, words: Any) -> tuple[Any, Future[BatchStep]]:
        if isinstance(words, _OnGpu):  # queued here and now, as nothing waits for it
            results: Future[BatchStep] = Future()
            results.set_result(self._step(words))
            return words, results
        return super()._begin(words)

    def _read(self) -> tuple[Array, Array]:
        self.synchronize()
        with _failures():
            memory = self._memory.copy_to_host()
            return memory, memory[:0] if self._stored is self._memory else self._stored.copy_to_host()

    def _write(self, memory: Array, stored: Array) -> Observed:
        with _failures():
            self._memory.copy_to_device(memory, stream=self._stream())
            if stored.size:
                self._stored.copy_to_device(stored, stream=self._stream())
            self._wrong.copy_to_device(np.array([NOTHING_REFUSED]), stream=self._stream())
            return self._observe(np.zeros(self.config.n_envs, np.bool_), again=False)

    def _close(self) -> None:
        # What the GPU's memory is known by; it is freed once tensors that were handed out are gone too.
        for name in ("_memory", "_stored", "_words", "_block", "_tensors", "_pieces", "_first_to_host"):
            self.__dict__.pop(name, None)

    def _launch(self, kernel: Any, *arguments: Any) -> None:
        stream = self._stream()
        launch = self._launches.get((kernel, stream))
        if launch is None:
            with warnings.catch_warnings():  # numba's of small grids; a batch is as large as its user wants
                warnings.filterwarnings("ignore", ".*Grid size")  # on a GPU, colours stand before it
                launch = self._launches[kernel, stream] = kernel[(*self._grid, stream)]
        launch(*arguments)

    def _stream(self) -> Any:
        """Return the stream of all that is queued here; what comes back to the host waits for it first."""
        if self._torch is None or simulated():
            return 0
        # After all that torch has queued there, and before what it queues next.
        number = self._torch.cuda.current_stream().cuda_stream
        if number not in self._streams:  # made once: a launch is prepared once a stream
            self._streams[number] = self._gpu.external_stream(number) if number else 0
        return self._streams[number]

    def _new_block(self) -> Any:
        where = "cpu" if simulated() else "cuda"
        assert self._torch is not None
        return self._torch.empty(self._result_layout.size, dtype=self._torch.uint8, device=where)

    def _array(self, block: Any) -> Any:
        """Return what a kernel takes for a block or tensor."""
        if self._torch is None:
            return block
        return block.numpy() if simulated() else self._gpu.as_cuda_array(block, sync=False)

    def _in_tensors(self, block: Any) -> BatchStep:
        return self._result_layout.step(self._result_layout.arrays(block, self._dtypes))

    def _on_gpu(self, actions: Any) -> _OnGpu | None:
        """Return actions that are on the GPU as a kernel takes them; ``None`` for those on the host."""
        if self._torch is None:
            return None
        if isinstance(actions, self._torch.Tensor):
            if not (actions.is_cuda or simulated()):
                return None
            actions = actions.detach().contiguous()
            array = self._array(actions.float() if actions.dtype == self._torch.float16 else actions)
        elif hasattr(actions, "__cuda_array_interface__"):
            array = self._gpu.as_cuda_array(actions)
            if not array.is_c_contiguous():
                raise ActionError("actions on the GPU are not contiguous; copy them into an array that is")
        else:
            return None
        space, n = self.config.spec.action_space, self.config.n_agents
        whole = (n, *(space.shape or ()))
        if tuple(array.shape) != whole:
            raise ActionError(
                f"actions have shape {tuple(array.shape)}; {n} agents take {whole}: {limits(space)}"
            )
        box = isinstance(space, Box)
        if array.dtype.kind not in ("iuf" if box else "iu"):
            raise ActionError(f"actions are {array.dtype}; {limits(space)}")
        return _OnGpu(array.reshape(array.size), box)


def available() -> Any:
    """Return the module ``numba.cuda`` where it can launch kernels, or numba's simulator can.

    Otherwise DeviceError says what is missing, and what to do.
    """
    if find_spec("numba_cuda") is None:
        raise DeviceError("cuda: numba-cuda is not installed; install it with: pip install '.[cuda]'")
    cuda: Any = import_module("numba.cuda")
    if simulated():
        return cuda
    if not cuda.is_available():
        error = cuda.cuda_error()
        if error is None:
            raise DeviceError(
                "cuda: the GPU's compiler was not found; install it with: pip install '.[cuda]'"
            )
        raise DeviceError(
            f"cuda: there is no GPU that programs can use ({' '.join(str(error).split())}); `nvidia-smi` has "
            "to list one: install NVIDIA's driver, or take device='native'"
        )
    driver, toolkit = _versions(cuda)
    if driver < (toolkit[0], 0):
        raise DeviceError(
            f"cuda: the driver is too old: it knows CUDA {driver[0]}.{driver[1]}, and the compiler here is "
            f"that of CUDA {toolkit[0]}; update the driver, or pip install 'numba-cuda[cu{driver[0]}]'"
        )
    return cuda


def _versions(gpu: Any) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return which CUDA the driver knows, and which one the compiler is of."""
    return gpu.cudadrv.driver.get_version(), gpu.runtime.get_version()


def memory_needed(config: BatchConfig, results: str = "numpy") -> int:
    """Return the bytes that a batch takes on the GPU."""
    slots = size(config.spec, config.n_envs)
    stored = slots if config.initial_states == "stored" else 0
    # Tensors that are kept for one step only are two blocks: the last step's, and those of the next.
    blocks = 2 if results == "torch" and config.copy else 1
    # Actions, and a reset's mask.
    spec = config.spec
    others = config.n_agents * len(spec.action_fields) * spec.action_dtype.itemsize + config.n_envs
    return slots + stored + blocks * ResultLayout(config).size + others


def _check_memory(gpu: Any, config: BatchConfig, results: str) -> None:
    free, total = gpu.current_context().get_memory_info()
    needed = memory_needed(config, results)
    if needed <= free:
        return

    def takes(n: int) -> int:
        return memory_needed(replace(config, n_envs=max(n, 1)), results)

    fits = bisect_right(range(config.n_envs), free, key=takes) - 1
    raise DeviceError(
        f"cuda: {config.n_envs:,} agents of {config.spec.name} take {needed / 2**30:,.2f} GiB of the GPU's "
        f"memory, {needed / config.n_envs:,.0f} bytes each, and {free / 2**30:,.2f} of its "
        f"{total / 2**30:,.2f} GiB are free; {max(fits, 0):,} agents fit"
    )


def grid(gpu: Any, n: int) -> tuple[int, int]:
    """Return the blocks and threads of a launch: a slot a thread, up to the threads that a GPU holds."""
    if simulated():
        # A thread is one of Python's, slow to start. And two of a block may get two arrays for the one that
        # they are to share: the simulator looks for it and makes it without a lock.
        return 2, 1
    processors = gpu.get_current_device().MULTIPROCESSOR_COUNT
    return min(-(-n // THREADS), processors * (RESIDENT_THREADS // THREADS)), THREADS


def _torch() -> Any:
    if find_spec("torch") is None:
        raise DeviceError("cuda: results='torch' needs torch; install it with: pip install '.[train]'")
    import torch

    if not (simulated() or torch.cuda.is_available()):
        raise DeviceError(
            f"cuda: results='torch' needs a torch that can use the GPU, and torch {torch.__version__} "
            "cannot; https://pytorch.org/get-started has one for your CUDA, or take results='numpy'"
        )
    return torch


@contextmanager
def _failures() -> Iterator[None]:
    """Turn errors of the driver and the compiler into DeviceError."""
    try:
        yield
    except Exception as error:
        name, text = type(error).__name__, " ".join(str(error).split())
        if "out of memory" in text or "OUT_OF_MEMORY" in text or name == "OutOfMemoryError":
            raise DeviceError(
                f"cuda: the GPU's memory is full ({text[:200]}); take fewer agents, or end what else uses it"
            ) from error
        if "UNSUPPORTED_PTX_VERSION" in text:
            raise DeviceError(
                f"cuda: the driver is too old for the code that numba-cuda makes ({text[:200]}); update it"
            ) from error
        if type(error).__module__.startswith(("numba.cuda", "cuda.")):
            raise DeviceError(f"cuda: {name}: {text}") from error
        raise
