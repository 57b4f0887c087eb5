"""A step's results as tensors that share their memory."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import pearl_marl

from ..toy import ENVIRONMENTS

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")


@pytest.mark.parametrize("copy", [True, False])
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_results_are_tensors_without_a_copy(name: str, copy: bool, toys: None) -> None:
    env = pearl_marl.parallel_env(name, 70, copy=copy)
    env.reset_batch(0)
    actions = np.stack([env.action_space("agent_0").sample() for _ in range(70)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # torch warns of arrays that must not be written to
        step = env.step_batch(actions)
        tensors = [torch.from_numpy(array) for array in step]
    assert [tensor.dtype for tensor in tensors[1:4]] == [torch.float32, torch.bool, torch.bool]
    for tensor, array in zip(tensors, step, strict=True):
        assert tensor.data_ptr() == array.ctypes.data
        assert tensor.data_ptr() % 64 == 0
        assert tensor.is_contiguous()
    tensors[1] += 1
    np.testing.assert_array_equal(step.rewards, tensors[1].numpy())
    env.close()


def test_a_tensor_keeps_its_step(toys: None) -> None:
    """With ``copy=True`` the memory is not written again as long as a tensor, or a part of one, uses it."""
    env = pearl_marl.parallel_env("Drift", 70)
    env.reset_batch(0)
    held = []
    for _ in range(30):
        step = env.step_batch(np.full(70, 3))
        part = torch.from_numpy(step.obs)[5:9, 1]
        held.append((part, part.clone()))
        del step
    assert all(torch.equal(late, early) for late, early in held)
    assert len({part.data_ptr() for part, _ in held}) == len(held)


def test_without_copies_a_tensor_shows_the_latest_step(toys: None) -> None:
    env = pearl_marl.parallel_env("Drift", 70, copy=False)
    env.reset_batch(0)
    obs = torch.from_numpy(env.step_batch(np.full(70, 3)).obs)
    before = obs.clone()
    latest = env.step_batch(np.full(70, 1)).obs
    assert not torch.equal(obs, before)
    np.testing.assert_array_equal(obs.numpy(), latest)


def test_actions_may_be_tensors() -> None:
    """As what a policy gives: ``int64``, through ``numpy()`` or as they are."""
    env, twin = (pearl_marl.parallel_env("CliffWalking", 70) for _ in range(2))
    actions = torch.randint(4, (70,), generator=torch.Generator().manual_seed(0))
    for e in (env, twin):
        e.reset_batch(0)
    np.testing.assert_array_equal(env.step_batch(actions).obs, twin.step_batch(actions.numpy()).obs)
