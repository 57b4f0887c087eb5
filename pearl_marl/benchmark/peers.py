"""Other libraries of batched environments: EnvPool, Gymnasium's vector environments, MinAtar."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib import metadata
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from pearl_marl.batch.actions import random_actions
from pearl_marl.benchmark.measure import Contender, Step, UnavailableError
from pearl_marl.spec import EnvSpec

GYMNASIUM_SYNC_LIMIT = 1024
"""More sub-environments of pure Python cost memory and change nothing about their rate."""

GYMNASIUM_ASYNC_LIMIT = 16
"""A process each: with more, the machine runs out of cores long before we run out of patience."""


def peers(spec: EnvSpec, n: int) -> list[Contender]:
    """Return the peers; one that has no such environment says so when it is made."""
    sync, asynchronous = min(n, GYMNASIUM_SYNC_LIMIT), min(n, GYMNASIUM_ASYNC_LIMIT)
    arrays = "all result arrays"
    processes, own = (partial(_vectorised, mode=mode) for mode in ("async", "vector_entry_point"))
    rows: list[tuple[str, str, int, Callable[[EnvSpec, int], Step]]] = [
        ("EnvPool, sync", f"{arrays}; all cores", n, _envpool),
        ("Gymnasium SyncVectorEnv", f"{arrays}; one thread", sync, partial(_vectorised, mode="sync")),
        ("Gymnasium AsyncVectorEnv", f"{arrays}; a process a slot", asynchronous, processes),
        ("Gymnasium's own vectorisation", f"{arrays}; NumPy, one thread", n, own),
        ("MinAtar", "observations, rewards, ends; Python, one thread", sync, _minatar),
    ]
    return [Contender(name, counts, count, partial(make, spec, count)) for name, counts, count, make in rows]


@contextmanager
def quiet_spaces() -> Iterator[None]:
    """Keep Gymnasium quiet while EnvPool makes its spaces: it warns of float64 limits in float32 boxes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*precision lowered by casting")
        yield


def _actions(spec: EnvSpec, count: int, dtype: Any) -> npt.NDArray[Any]:
    return random_actions(spec, np.random.default_rng(0), count).astype(dtype)


def _required(spec: EnvSpec, package: str) -> str:
    """Return the name under which Gymnasium has the environment."""
    if spec.oracle is None:
        raise UnavailableError(f"{package} has no {spec.name}")
    return spec.oracle


def _envpool(spec: EnvSpec, n: int) -> Step:
    try:
        import envpool
    except ImportError:
        raise UnavailableError("not installed: pip install 'pearl-marl[bench]'") from None
    name, options = _required(spec, "EnvPool"), dict(spec.options)
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
        given = _actions(spec, n, envs.action_space.dtype)
    return lambda: envs.step(given)


def _vectorised(spec: EnvSpec, count: int, mode: str) -> Step:
    name = _required(spec, "Gymnasium")
    module, _, env_id = name.rpartition(":")
    if module:  # registers it
        importlib.import_module(module)
    if mode == "vector_entry_point" and gymnasium.spec(env_id).vector_entry_point is None:
        raise UnavailableError(f"Gymnasium has no vectorised {env_id}")
    envs = gymnasium.make_vec(name, num_envs=count, vectorization_mode=mode, **dict(spec.options))
    envs.reset(seed=0)
    given = _actions(spec, count, envs.single_action_space.dtype)
    return lambda: envs.step(given)


def _minatar(spec: EnvSpec, count: int) -> Step:
    game = _required(spec, "MinAtar").partition("MinAtar/")[2].rpartition("-v")[0].lower()
    if not game:
        raise UnavailableError(f"MinAtar has no {spec.name}")
    try:
        from minatar import Environment
    except ImportError:
        raise UnavailableError("not installed: pip install minatar") from None
    given = _actions(spec, count, np.int64).tolist()
    envs = [Environment(game, **dict(spec.options)) for _ in range(count)]
    for i, env in enumerate(envs):
        env.seed(i)

    def step() -> None:
        for env, action in zip(envs, given, strict=True):
            _, ended = env.act(action)
            env.state()
            if ended:
                env.reset()

    return step
