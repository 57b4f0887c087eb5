"""Throughput of this package and of others, measured side by side.

Contenders are timed in turns, round after round, so that a machine that slows down or speeds up
does so for all of them, and the median round is quoted.
"""

from __future__ import annotations

import importlib
import os
import platform
import statistics
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from pearl_marl.batch.actions import encode, random_actions
from pearl_marl.batch.rewards import padded
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.compiler.cuda_kernels import compile_cuda_kernels, simulated
from pearl_marl.compiler.kernels import compile_kernels
from pearl_marl.devices import BatchConfig, Cuda, Native, Rtl, cuda
from pearl_marl.errors import DeviceError
from pearl_marl.interfaces.parallel import parallel_env
from pearl_marl.interfaces.vector import make_vec
from pearl_marl.spec import EnvSpec

GYMNASIUM_SYNC_LIMIT = 1024
"""More sub-environments of pure Python cost memory and change nothing about their rate."""

GYMNASIUM_ASYNC_LIMIT = 16
"""A process each: with more, the machine runs out of cores long before we run out of patience."""


class UnavailableError(Exception):
    """A contender cannot run here; the message says why, for the table."""


@dataclass
class Contender:
    """Something to time.

    Parameters
    ----------
    name
        For the table.
    counts
        What one of its steps includes, in words: which sport this is.
    n
        Slots it steps at a time.
    make
        Returns the function to time, which steps every slot once.
    ours
        Whether it is this package.
    wait
        Waits for what steps have only started.
    """

    name: str
    counts: str
    n: int
    make: Callable[[], Callable[[], Any]]
    ours: bool = False
    wait: Callable[[], Any] = lambda: None
    unavailable: str | None = None
    seconds: list[float] = field(default_factory=list)

    @property
    def seconds_per_step(self) -> float:
        """Median seconds of a step of all slots."""
        return statistics.median(self.seconds)

    def row(self) -> dict[str, Any]:
        """Return the figures by name, for JSON."""
        result: dict[str, Any] = {"name": self.name, "counts": self.counts, "n": self.n, "ours": self.ours}
        if self.unavailable is not None:
            return {**result, "unavailable": self.unavailable}
        return {
            **result,
            "steps_per_second": self.n / self.seconds_per_step,
            "microseconds_per_step": self.seconds_per_step * 1e6,
            "rounds_microseconds": [s * 1e6 for s in self.seconds],
        }


def measure(contenders: list[Contender], rounds: int, seconds: float) -> Iterator[str]:
    """Time contenders in turns; yields the name of each as it is about to be timed.

    Parameters
    ----------
    contenders
        Their ``seconds`` are filled; those that cannot run get ``unavailable`` instead.
    rounds
        How often each is timed.
    seconds
        About how long one timing lasts.
    """
    running: list[tuple[Contender, Callable[[], Any], int]] = []
    for contender in contenders:
        yield contender.name
        try:
            step = contender.make()
        except UnavailableError as error:
            contender.unavailable = str(error)
            continue
        step()  # compilation and first use of memory
        contender.wait()
        running.append((contender, step, max(1, round(seconds / _time(step, 1, contender.wait)))))
    for _ in range(rounds):
        for contender, step, count in running:
            yield contender.name
            contender.seconds.append(_time(step, count, contender.wait))


def _time(step: Callable[[], Any], count: int, wait: Callable[[], Any]) -> float:
    began = time.perf_counter()
    for _ in range(count):
        step()
    wait()
    return (time.perf_counter() - began) / count


def machine() -> dict[str, Any]:
    """Return what a figure has to name to be repeatable: processor, cores, versions."""
    model = platform.processor()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(
            (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model
        )
    versions = {}
    for package in ("pearl-marl", "numpy", "numba", "gymnasium", "pettingzoo", "envpool"):
        with suppress(metadata.PackageNotFoundError):
            versions[package] = metadata.version(package)
    return {
        "processor": model,
        "cores": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
        "versions": versions,
    }


def contenders(spec: EnvSpec, n: int) -> list[Contender]:
    """Return this package at each of its levels, and its peers, for one environment."""
    return [*_ours(spec, n), *_on_gpu(spec, n), *_peers(spec, n)]


def _ours(spec: EnvSpec, n: int) -> list[Contender]:
    actions = random_actions(spec, np.random.default_rng(0), n)
    words = encode(actions, spec, np.empty(n, spec.action.dtype))

    def kernel() -> Callable[[], Any]:
        kernels = compile_kernels(spec)
        memory = SlotMemory(spec, n).bytes
        table = padded(spec, spec.rewards or ())
        rewards, terminations = np.empty(n, np.float32), np.empty(n, np.uint8)
        return lambda: kernels.advance(memory, words, table, rewards, terminations, n, 0, n)

    def fill() -> Callable[[], Any]:
        config = BatchConfig(spec=spec, n_envs=n, copy=False)
        device = Native(threads=1).open(config)
        device.reset(seed=0)
        arrays = device.step(actions)[:4]

        def write() -> None:
            for array in arrays:
                array.fill(0)

        return write

    def batch(copy: bool, threads: int | None, dtype: npt.DTypeLike) -> Callable[[], Callable[[], Any]]:
        def make() -> Callable[[], Any]:
            env = parallel_env(spec.name, n, device=Native(threads), copy=copy, **spec.options)
            env.reset_batch(seed=0)
            given = actions.astype(dtype)
            return lambda: env.step_batch(given)

        return make

    def pettingzoo(read: bool) -> Callable[[], Callable[[], Any]]:
        def make() -> Callable[[], Any]:
            env = parallel_env(spec.name, n, device=Native(threads=1), **spec.options)
            env.reset(seed=0)
            if not read:
                return lambda: env.step(actions)
            by_agent = dict(zip(env.possible_agents, actions.tolist(), strict=True))
            return lambda: [len(dict(results)) for results in env.step(by_agent)]

        return make

    def vector() -> Callable[[], Any]:
        envs = make_vec(spec.name, n, device=Native(threads=1), **spec.options)
        envs.reset(seed=0)
        given = actions.astype(np.int64)
        return lambda: envs.step(given)

    def simulated() -> Callable[[], Any]:
        try:
            env = parallel_env(spec.name, n, device=Rtl(), copy=False, **spec.options)
            env.reset_batch(seed=0)
        except DeviceError as error:
            raise UnavailableError(str(error).splitlines()[0]) from None
        return lambda: env.step_batch(actions)

    delivered = "all result arrays, checked actions"
    rows = [
        ("kernel only", "golden step and float32 rewards; no observations, no resets", kernel),
        ("step_batch, copy=False", f"{delivered}; one thread", batch(False, 1, spec.action.dtype)),
        ("step_batch", f"{delivered}, yours to keep; one thread", batch(True, 1, spec.action.dtype)),
        ("step_batch, int64 actions", f"{delivered}, yours to keep; one thread", batch(True, 1, np.int64)),
        (
            "step_batch, threads=None",
            f"{delivered}, yours to keep; as many threads as pay",
            batch(True, None, spec.action.dtype),
        ),
        ("PettingZoo step, array actions", "five dicts, nobody looks inside; one thread", pettingzoo(False)),
        ("PettingZoo step, dict actions", "five dicts, every key read; one thread", pettingzoo(True)),
        ("Gymnasium VectorEnv step", "arrays and infos, int64 actions; one thread", vector),
        ("step_batch, device='rtl'", "the FPGA design under Verilator, by backdoor; one thread", simulated),
        ("(memory) filling the result arrays", "writing zeros over what a step returns: the floor", fill),
    ]
    return [Contender(name, counts, n, make, ours=True) for name, counts, make in rows]


def _on_gpu(spec: EnvSpec, n: int) -> list[Contender]:
    def gpu() -> Any:
        try:
            found = cuda.available()
        except DeviceError as error:
            raise UnavailableError(str(error)) from None
        if simulated():
            raise UnavailableError(
                "cuda: numba's simulator stands in for a GPU here, and its times mean nothing"
            )
        return found

    def kernel() -> Callable[[], Any]:
        module = gpu()
        advance = compile_cuda_kernels(spec).advance
        memory = module.to_device(SlotMemory(spec, n).bytes)
        words = encode(
            random_actions(spec, np.random.default_rng(0), n), spec, np.empty(n, spec.action.dtype)
        )
        actions = module.to_device(words)
        table = module.to_device(
            padded(spec, spec.rewards or ()) if spec.rewards else np.zeros(1, np.float32)
        )
        rewards, terminations = module.device_array(n, np.float32), module.device_array(n, np.uint8)
        launch = advance[cuda.grid(module, n)]
        return lambda: launch(memory, actions, table, rewards, terminations, n)

    def tensors() -> Callable[[], Any]:
        gpu()
        try:
            env = parallel_env(spec.name, n, device=Cuda(results="torch"), **spec.options)
            env.reset_batch(seed=0)
        except DeviceError as error:
            raise UnavailableError(str(error)) from None
        import torch

        actions = torch.from_numpy(random_actions(spec, np.random.default_rng(0), n)).cuda()
        return lambda: env.step_batch(actions)

    def wait() -> None:
        importlib.import_module("numba.cuda").synchronize()

    what = "golden step and float32 rewards; no observations, no resets"
    rows = [
        ("kernel only, device='cuda'", what, kernel),
        (
            "step_batch, device='cuda'",
            "all results, yours to keep, as tensors on the GPU; actions there",
            tensors,
        ),
    ]
    return [Contender(name, counts, n, make, ours=True, wait=wait) for name, counts, make in rows]


@contextmanager
def quiet_spaces() -> Iterator[None]:
    """Keep Gymnasium quiet while EnvPool makes its spaces: it warns of float64 limits in float32 boxes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*precision lowered by casting")
        yield


def _peers(spec: EnvSpec, n: int) -> list[Contender]:
    oracle, options = spec.oracle, dict(spec.options)

    def actions(count: int, dtype: Any) -> npt.NDArray[Any]:
        return random_actions(spec, np.random.default_rng(0), count).astype(dtype)

    def required(package: str) -> str:
        if oracle is None:
            raise UnavailableError(f"{package} has no {spec.name}")
        return oracle

    def envpool() -> Callable[[], Any]:
        try:
            import envpool
        except ImportError:
            raise UnavailableError("not installed: pip install 'pearl-marl[bench]'") from None
        name = required("EnvPool")
        known = envpool.list_all_envs()
        if name not in known:  # it may have another version of it
            family = name.rpartition("-v")[0]
            name = max((other for other in known if other.rpartition("-v")[0] == family), default="")
        if not name:
            raise UnavailableError(f"EnvPool {metadata.version('envpool')} has no {family}")
        if spec.configure is not None and options != spec.configure().options:
            raise UnavailableError(f"measured with default options only, not {options}")
        envs = envpool.make(name, env_type="gymnasium", num_envs=n)
        with quiet_spaces():
            envs.reset()
            given = actions(n, envs.action_space.dtype)
        return lambda: envs.step(given)

    def vectorised(mode: str, count: int) -> Callable[[], Callable[[], Any]]:
        def make() -> Callable[[], Any]:
            name = required("Gymnasium")
            module, _, env_id = name.rpartition(":")
            if module:  # registers it
                importlib.import_module(module)
            if mode == "vector_entry_point" and gymnasium.spec(env_id).vector_entry_point is None:
                raise UnavailableError(f"Gymnasium has no vectorised {env_id}")
            envs = gymnasium.make_vec(name, num_envs=count, vectorization_mode=mode, **options)
            envs.reset(seed=0)
            given = actions(count, envs.single_action_space.dtype)
            return lambda: envs.step(given)

        return make

    def minatar() -> Callable[[], Any]:
        game = required("MinAtar").partition("MinAtar/")[2].rpartition("-v")[0].lower()
        if not game:
            raise UnavailableError(f"MinAtar has no {spec.name}")
        try:
            from minatar import Environment
        except ImportError:
            raise UnavailableError("not installed: pip install minatar") from None
        given = actions(sync, np.int64).tolist()
        envs = [Environment(game, **options) for _ in range(sync)]
        for i, env in enumerate(envs):
            env.seed(i)

        def step() -> None:
            for env, action in zip(envs, given, strict=True):
                _, ended = env.act(action)
                env.state()
                if ended:
                    env.reset()

        return step

    sync, asynchronous = min(n, GYMNASIUM_SYNC_LIMIT), min(n, GYMNASIUM_ASYNC_LIMIT)
    arrays = "all result arrays"
    return [
        Contender("EnvPool, sync", f"{arrays}; all cores", n, envpool),
        Contender("Gymnasium SyncVectorEnv", f"{arrays}; one thread", sync, vectorised("sync", sync)),
        Contender(
            "Gymnasium AsyncVectorEnv",
            f"{arrays}; a process a slot",
            asynchronous,
            vectorised("async", asynchronous),
        ),
        Contender(
            "Gymnasium's own vectorisation",
            f"{arrays}; NumPy, one thread",
            n,
            vectorised("vector_entry_point", n),
        ),
        Contender("MinAtar", "observations, rewards, ends; Python, one thread", sync, minatar),
    ]
