"""The GPU device: under numba's simulator where there is no GPU, which ``conftest.py`` sees to.

What runs on a real GPU only is marked ``gpu``; ``pytest -m gpu -rs`` runs it, or says that it was skipped.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import warnings
from typing import Any
from unittest import mock

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl import wrappers
from pearl_marl.batch.actions import random_actions
from pearl_marl.batch.step import on_host
from pearl_marl.benchmark.measure import measure
from pearl_marl.benchmark.steps import contenders
from pearl_marl.compiler.cuda_source import cuda_source
from pearl_marl.devices import BatchConfig, Cuda, Lockstep, Native, Sharded, cuda
from pearl_marl.errors import ActionError, ArgumentError, DeviceError
from pearl_marl.verification import runs, verify

from ..policies.networks import random_network
from ..sampling import sampled

pytest.importorskip("numba_cuda", reason="numba-cuda is not installed: pip install '.[cuda]'")
torch = pytest.importorskip("torch")

N = 5


def config(name: str = "CliffWalking", n: int = N, **options: Any) -> BatchConfig:
    return BatchConfig(spec=pearl_marl.get_spec(name), n_envs=n, **options)


def opened(name: str = "CliffWalking", results: str = "torch", **options: Any) -> Cuda:
    return Cuda(results).open(config(name, **options))


def on_gpu(array: Any) -> Any:
    tensor = torch.from_numpy(np.asarray(array))
    return tensor.cuda() if torch.cuda.is_available() else tensor


@pytest.mark.parametrize(
    "name",
    sampled(
        pearl_marl.list_envs(), ("Blackjack", "CartPole", "CliffWalking", "ConnectFour", "Overcooked", "Taxi")
    ),
)
def test_every_environment_is_bit_exact(name: str) -> None:
    """As ``pearl verify`` does, in all modes."""
    for run in runs(pearl_marl.get_spec(name), 6, 32):
        for _ in verify(run, Lockstep("cuda", "reference"), seed=3):
            pass
        assert run.exact
        assert run.config.limit == 0 or run.episodes


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
@pytest.mark.parametrize("copy", [True, False])
@pytest.mark.parametrize("name", ["CliffWalking", "Pendulum"])
def test_tensors_hold_what_arrays_hold(name: str, copy: bool, mode: AutoresetMode) -> None:
    """Whether actions are on the GPU, in any dtype, or on the host."""
    options: dict[str, Any] = {"autoreset_mode": mode, "max_cycles": 4, "copy": copy}
    device, native = opened(name, **options), Native().open(config(name, **options))
    np.testing.assert_array_equal(device.reset(seed=1).cpu(), native.reset(seed=1))
    generator = np.random.default_rng(0)
    wide = np.int64 if name == "CliffWalking" else np.float64
    for t in range(9):
        actions = random_actions(native.config.spec, generator, N)
        step = device.step([on_gpu(actions.astype(wide)), on_gpu(actions), actions][t % 3])
        other = native.step(actions)
        assert all(isinstance(tensor, torch.Tensor) for tensor in step)
        for ours, theirs in zip(step.on_host()[:4], tuple(other)[:4], strict=True):
            assert ours.dtype == theirs.dtype
            np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(step.arrivals().cpu(), other.arrivals())
        np.testing.assert_array_equal(device.state(), native.state())
    device.send(on_gpu(actions))
    np.testing.assert_array_equal(device.recv().obs.cpu(), native.step(actions).obs)


def test_unpack_counts_beyond_a_byte() -> None:
    """Snake's places in a row are sums of bytes, which the simulator's words must not cut."""
    ours, native = opened("Snake", "numpy"), Native().open(config("Snake"))
    np.testing.assert_array_equal(ours.reset(seed=3), native.reset(seed=3))


ROLLED = sampled(pearl_marl.list_envs(), ("CartPole", "CliffWalking", "ConnectFour", "DeepSea"))


@pytest.mark.parametrize("results", sampled(["numpy", "torch"], ("numpy",)))
@pytest.mark.parametrize("name", ROLLED)
def test_rollouts_are_those_of_the_cpu(name: str, results: str) -> None:
    """In both modes, with limits, draws of the policy and masks; and everything goes on the same way."""
    mode = {"numpy": AutoresetMode.SAME_STEP, "torch": AutoresetMode.NEXT_STEP}[results]
    options: dict[str, Any] = {"max_cycles": 6, "autoreset_mode": mode}
    ours, native = opened(name, results, **options), Native().open(config(name, **options))
    policy = random_network(native.config.spec, 5)
    for device in (ours, native):
        device.reset(seed=3)
    for steps in (2, 13):
        rolled, due = ours.rollout(policy, steps, episodes=2), native.rollout(policy, steps, episodes=2)
        for what, array in vars(due).items():
            np.testing.assert_array_equal(getattr(rolled, what), array, what)
    assert due.episodes
    assert ours.snapshot().to_bytes() == native.snapshot().to_bytes()
    np.testing.assert_array_equal(on_host(ours.in_episode), native.in_episode)


@pytest.mark.parametrize("algorithm", ["ppo", "pqn", "dqn", "q-learning"])
def test_trainers_work_where_the_agents_are(algorithm: str) -> None:
    """With the numbers of a training on the host, where the simulator computes as that does."""
    training = importlib.import_module("pearl_marl.training.run")
    small: dict[str, dict[str, Any]] = {
        "ppo": {"rollout_length": 4, "minibatch": 8, "blocks": 2},
        "pqn": {"rollout_length": 4, "minibatch": 8, "blocks": 2},
        "dqn": {"memory": 3, "warm_up": 1, "minibatch": 8},
        "q-learning": {},
    }
    settings = training.settings_for(
        algorithm, "Blackjack", {"n_agents": N, "iterations": 4, **small[algorithm]}
    )
    trainers = [
        training.ALGORITHMS[algorithm](pearl_marl.get_spec("Blackjack"), *pair)
        for pair in (("cuda", settings), ("native", settings))
    ]
    for _ in range(4):
        for trainer in trainers:
            trainer.iterate()
    ours, theirs = (trainer.policy.state_dict() for trainer in trainers)
    assert trainers[0].figures()["episodes"] > 0
    for name, tensor in ours.items():
        assert tensor.is_cuda == torch.cuda.is_available()
        assert tensor.isfinite().all()
        if not tensor.is_cuda:
            assert torch.equal(tensor, theirs[name]), name


def test_tensors_are_kept_or_written_over() -> None:
    for copy in (True, False):
        device = opened(copy=copy)
        device.reset(seed=0)
        first = device.step(on_gpu([0] * N)).obs
        before = first.clone()
        second = device.step(on_gpu([0] * N)).obs
        assert (first.data_ptr() == second.data_ptr()) is not copy
        assert torch.equal(first, before) is copy, "they moved up twice"


@pytest.mark.parametrize(("name", "bad"), [("CliffWalking", 4), ("CliffWalking", -1), ("Pendulum", np.nan)])
def test_a_wrong_action_on_the_gpu_is_reported_by_the_next_call_that_waits(name: str, bad: float) -> None:
    device, native = opened(name, first_slot=10), Native().open(config(name, first_slot=10))
    device.reset(seed=0)
    native.reset(seed=0)
    actions = np.zeros((N, *native.config.spec.action_space.shape), np.float32 if name == "Pendulum" else int)
    for t in range(3):
        wrong = actions.copy()
        if t:
            wrong[t + 1] = bad
        device.step(on_gpu(wrong))
        least = actions.copy()
        if t and name == "Pendulum":
            least[t + 1] = -2
        native.step(least)
    with pytest.raises(
        ActionError, match=r"agent_12: its action at step 1, .* out of range.* least one instead"
    ):
        device.synchronize()
    device.synchronize()  # said once
    np.testing.assert_array_equal(device.state(), native.state())
    with pytest.raises(ActionError, match=r"shape \(3"):
        device.step(on_gpu(actions[:3]))
    with pytest.raises(ActionError, match="actions are bool"):
        device.step(on_gpu(actions.astype(bool)))


@pytest.mark.parametrize("autoreset", [True, False])
def test_dicts_and_gymnasium_are_on_the_host(autoreset: bool) -> None:
    """What PettingZoo and Gymnasium define stays as it is; only ``step_batch`` returns tensors."""
    arguments: dict[str, Any] = {"autoreset": autoreset, "max_cycles": 3}
    env = pearl_marl.parallel_env("Blackjack", N, device=Cuda("torch"), **arguments)
    other = pearl_marl.parallel_env("Blackjack", N, **arguments)
    assert dict(env.reset(seed=1)[0]) == dict(other.reset(seed=1)[0])
    while env.agents and env.device.tick < 6:
        ours: Any = env.step(on_gpu(np.ones(N, np.int64)))
        theirs: Any = other.step(np.ones(N, np.int64))
        assert env.agents == other.agents
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_equal(dict(a), dict(b))
    vectors = [pearl_marl.make_vec("Pendulum", N, device=d, max_cycles=2) for d in (Cuda("torch"), "native")]
    for vector in vectors:
        vector.reset(seed=0)
    for _ in range(3):
        ours, theirs = (vector.step(np.ones((N, 1), np.float32)) for vector in vectors)
        for a, b in zip(ours[:4], theirs[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        assert ours[4].keys() == theirs[4].keys()


def test_what_works_on_the_host_refuses_tensors() -> None:
    env = pearl_marl.parallel_env("Pendulum", N, device=Cuda("torch"))
    for use in (
        lambda: Lockstep(Cuda("torch")),
        lambda: Sharded(["native", Cuda("torch")]),
        lambda: wrappers.clip_reward_v0(env),
    ):
        with pytest.raises(ArgumentError, match=r"give Cuda\(results='numpy'\)"):
            use()
    with pytest.raises(ArgumentError, match="results is 'jax'; possible are 'numpy' and 'torch'"):
        Cuda("jax")


class TestUnavailable:
    """Every error says what to do; injected, since no machine lacks everything."""

    def test_without_numba_cuda(self) -> None:
        with (
            mock.patch.object(cuda, "find_spec", return_value=None),
            pytest.raises(DeviceError, match=r"pip install '\.\[cuda\]'"),
        ):
            opened()

    @pytest.mark.parametrize(
        ("error", "message"),
        [
            (
                "CUDA driver library cannot be found.\nEnsure",
                "no GPU .*driver library cannot be found. Ensure.*nvidia-smi",
            ),
            ("CUDA_ERROR_NO_DEVICE (100)", "no GPU that programs can use .*NO_DEVICE.*device='native'"),
            (None, r"compiler was not found.*\.\[cuda\]"),
        ],
    )
    def test_without_a_gpu(self, error: str | None, message: str) -> None:
        import numba.cuda

        with (
            mock.patch.object(cuda, "simulated", return_value=False),
            mock.patch.object(numba.cuda, "is_available", return_value=False),
            mock.patch.object(numba.cuda, "cuda_error", return_value=error, create=True),
            pytest.raises(DeviceError, match=message),
        ):
            opened()

    def test_with_an_old_driver(self) -> None:
        import numba.cuda

        with (
            mock.patch.object(cuda, "simulated", return_value=False),
            mock.patch.object(numba.cuda, "is_available", return_value=True),
            mock.patch.object(cuda, "_versions", return_value=((12, 4), (13, 0))),
            pytest.raises(
                DeviceError, match=r"CUDA 12\.4, .* CUDA 13; update the driver, or .*numba-cuda\[cu12\]"
            ),
        ):
            opened()

    @pytest.mark.parametrize("results", ["numpy", "torch"])
    def test_with_too_little_memory(self, results: str) -> None:
        """The number that fits does fit, and one more does not."""
        free = 1 << 20
        context = mock.Mock(get_memory_info=lambda: (free, 2 * free))
        with (
            mock.patch("numba.cuda.current_context", return_value=context),
            pytest.raises(DeviceError, match=r"100,000 agents of CliffWalking take .* agents fit") as caught,
        ):
            opened(results=results, n=100_000)
        fits = int(str(caught.value).rpartition("; ")[2].split()[0].replace(",", ""))
        assert cuda.memory_needed(config(n=fits), results) <= free
        assert cuda.memory_needed(config(n=fits + 1), results) > free
        assert fits > 10_000

    def test_memory_that_is_gone_when_it_is_taken(self) -> None:
        with (
            mock.patch("numba.cuda.device_array", side_effect=RuntimeError("CUDA_ERROR_OUT_OF_MEMORY (2)")),
            pytest.raises(DeviceError, match=r"memory is full.*take fewer agents"),
        ):
            opened()

    def test_errors_of_the_driver(self) -> None:
        from numba.cuda.cudadrv.driver import CudaAPIError

        error = type(
            "CudaAPIError", (CudaAPIError,), {"__init__": Exception.__init__, "__module__": "numba.cuda"}
        )
        device = opened()
        with (
            mock.patch.object(device, "_launch", side_effect=error("[700] an illegal memory access")),
            pytest.raises(DeviceError, match="illegal memory access"),
        ):
            device.reset(seed=0)

    def test_tensors_without_torch(self) -> None:
        def missing(name: str) -> Any:
            return None if name == "torch" else object()

        with (
            mock.patch.object(cuda, "find_spec", side_effect=missing),
            pytest.raises(DeviceError, match="results='torch' needs torch"),
        ):
            opened()
        with (
            mock.patch.object(cuda, "simulated", return_value=False),
            mock.patch.object(cuda, "available", return_value=None),
            mock.patch.object(torch.cuda, "is_available", return_value=False),
            pytest.raises(DeviceError, match=r"torch .* cannot; .*results='numpy'"),
        ):
            opened()


class Grumbling:
    """A kernel as numba-cuda prepares it for a launch of few threads, with colorama installed beside it."""

    def __getitem__(self, grid: object) -> Any:
        warnings.warn("\x1b[1mGrid size 1 will likely result in GPU under-utilization", stacklevel=1)
        return lambda *arguments: None


def test_few_agents_do_not_warn() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        opened()._launch(Grumbling())


def test_the_command_line_says_why_there_is_nothing_to_measure(pearl: Any) -> None:
    rows = [c for c in contenders(pearl_marl.get_spec("CliffWalking"), 4) if "device='cuda'" in c.name]
    assert len(rows) == 2, "kernel only, and what step_batch returns"
    list(measure(rows, 1, 0.0))
    for row in rows:
        if cuda.simulated():
            assert "its times mean nothing" in row.row()["unavailable"]
        else:
            assert row.row()["steps_per_second"] > 0
    with mock.patch.object(cuda, "find_spec", return_value=None):
        _, output, _ = pearl("doctor", "--json")
    found = json.loads(output)["GPU"]
    assert found == {
        "ok": False,
        "found": "numba-cuda is not installed",
        "fix": "pip install '.[cuda]'",
    }


COMPILE = """
import sys, types
import numba, numpy as np
from numba import cuda
from numba.cuda import dispatcher
import pearl_marl
from pearl_marl.compiler.cuda_kernels import compile_cuda_kernels
dispatcher.get_current_device = lambda: types.SimpleNamespace(compute_capability=(9, 0))  # there is none
spec = pearl_marl.get_spec(sys.argv[1])
i, b, u1, f4 = numba.int64, numba.boolean, numba.uint8[::1], numba.float32[::1]
actions = numba.from_dtype(spec.action.dtype)[::1]
signature = numba.void(u1, u1, actions, f4, u1, numba.int64[::1], *[i] * 9, b, b, b, i)
step = compile_cuda_kernels(spec).step.py_func
print(cuda.compile(step, signature, cc=(9, 0), device=False, output="ptx", abi="numba")[0])
"""


@pytest.mark.parametrize("name", ["CartPole"])
def test_the_real_compiler_takes_it(name: str) -> None:
    """It needs no GPU. The simulator knows neither types nor PTX; this shows that both come out right."""
    environment = {**os.environ, "NUMBA_ENABLE_CUDASIM": "0"}
    command = [sys.executable, "-c", COMPILE, name]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if "Failure finding" in done.stderr or "NvvmSupportError" in done.stderr:
        pytest.skip("CUDA's compiler is not installed: pip install '.[cuda]'")
    assert done.returncode == 0, done.stderr
    assert ".target sm_90" in done.stdout
    assert ".visible .entry" in done.stdout
    assert "call" not in done.stdout.partition(".visible .entry")[2], "every golden function is inlined"
    assert ".local" not in done.stdout, "the words of a slot stay in registers"
    assert "f64" not in done.stdout, "integers never became floats"


def test_the_source_is_the_specs() -> None:
    """A spec's fields, and nothing of another's."""
    source = cuda_source(pearl_marl.get_spec("CartPole"))
    compile(source, "CartPole", "exec")
    assert "memory_int32[at_angular_velocity + i]" in source
    assert "at_row" not in source


@pytest.mark.gpu
@pytest.mark.parametrize("name", pearl_marl.list_envs())
def test_every_environment_on_a_real_gpu(name: str) -> None:
    for run in runs(pearl_marl.get_spec(name), 43_008, 120):
        for _ in verify(run, Lockstep("cuda", "native"), seed=3):
            pass
        assert run.exact


@pytest.mark.gpu
@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
@pytest.mark.parametrize("name", pearl_marl.list_envs())
def test_rollouts_on_a_real_gpu(name: str, mode: AutoresetMode) -> None:
    devices = [device.open(config(name, 5_000, autoreset_mode=mode)) for device in (Cuda("numpy"), Native())]
    policy = random_network(pearl_marl.get_spec(name), 5)
    found = []
    for device in devices:
        device.reset(seed=3)
        found.append((*vars(device.rollout(policy, 120)).values(), device.state()))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.gpu
def test_tensors_on_a_real_gpu_under_another_stream() -> None:
    """Results are there when torch's next operation on that stream reads them."""
    device, native = opened("CartPole", n=100_000), Native().open(config("CartPole", n=100_000))
    stream = torch.cuda.Stream()
    with torch.cuda.stream(stream):
        obs = device.reset(seed=0)
        native.reset(seed=0)
        for _ in range(100):
            actions = (obs[:, 2] > 0).long()
            theirs = native.step(actions.cpu().numpy())
            obs = device.step(actions).obs
            assert obs.is_cuda
            assert torch.equal(obs.cpu(), torch.from_numpy(theirs.obs))
