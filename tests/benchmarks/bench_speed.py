"""Benchmarks, which `make bench` runs; nothing here is a test."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.batch.actions import encode, random_actions
from pearl_marl.batch.rewards import padded
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.compiler.kernels import compile_kernels

N = 43008


@pytest.fixture(params=pearl_marl.list_envs())
def env(request: pytest.FixtureRequest) -> Any:
    env = pearl_marl.parallel_env(request.param, N, copy=False)
    env.reset(seed=0)
    yield env
    env.close()


def actions_of(env: Any, n: int = N) -> np.ndarray:
    return random_actions(env.spec, np.random.default_rng(0), n)


def test_kernel_only(env: Any, benchmark: Any) -> None:
    spec = env.spec
    arguments = (
        SlotMemory(spec, N).bytes,
        encode(actions_of(env), spec, np.empty(N, spec.action.dtype)),
        padded(spec, spec.rewards or ()),
        np.zeros(N, np.float32),
        np.zeros(N, np.uint8),
    )
    benchmark(compile_kernels(spec).advance, *arguments, N, 0, N)


def test_step_batch(env: Any, benchmark: Any) -> None:
    assert benchmark(env.step_batch, actions_of(env)).obs.shape[0] == N


def test_step_batch_copying(env: Any, benchmark: Any) -> None:
    copying = pearl_marl.parallel_env(env.spec.name, N)
    copying.reset(seed=0)
    assert benchmark(copying.step_batch, actions_of(env)).obs.shape[0] == N


def test_step_batch_of_few(env: Any, benchmark: Any) -> None:
    """What a call costs by itself."""
    few = pearl_marl.parallel_env(env.spec.name, 8, copy=False)
    few.reset(seed=0)
    assert benchmark(few.step_batch, actions_of(env, 8)).obs.shape[0] == 8


def test_step_with_arrays(env: Any, benchmark: Any) -> None:
    assert len(benchmark(env.step, actions_of(env))) == 5


def test_step_with_dicts(env: Any, benchmark: Any) -> None:
    """The slow way: a dict in, and every result looked into."""
    actions = dict(zip(env.agents, actions_of(env).tolist(), strict=True))

    def step() -> int:
        return sum(len(list(result.values())) for result in env.step(actions))

    assert benchmark(step) == 5 * N


def test_import(benchmark: Any) -> None:
    benchmark.pedantic(
        subprocess.run, ([sys.executable, "-c", "import pearl_marl"],), {"check": True}, rounds=3
    )
