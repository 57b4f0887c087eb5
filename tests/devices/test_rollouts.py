"""Rollouts: many steps in one call are what as many single steps with the same policy are."""

from __future__ import annotations

import signal
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl.devices import Device, Native, Sharded, rollouts
from pearl_marl.devices.base import Phase
from pearl_marl.devices.native_rollout import compiled_policy
from pearl_marl.devices.rollouts import element_dtype
from pearl_marl.errors import ArgumentError, DeviceError, OrderError
from pearl_marl.policies.integer_network import AgentNetworks

from .rolling import Stepping, assert_same, assert_same_place, opened, policy_for

STEPS = 40
MODES = AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP


# Each takes seconds to compile.
IN_SHORT = "Acrobot", "CartPole", "Catch", "CliffWalking", "ConnectFour", "LevelBasedForaging", "MemoryChain"
ENVIRONMENTS = [
    name if name in IN_SHORT else pytest.param(name, marks=pytest.mark.exhaustive)
    for name in pearl_marl.list_envs()
]


@pytest.mark.parametrize("name", pearl_marl.list_envs())
def test_elements_are_what_observations_are_made_of(name: str) -> None:
    """In plain Python, so that every environment is tried."""
    device = opened(pearl_marl.devices.make_device("reference"), name, 6)
    spec, policy = device.config.spec, policy_for(name)
    scale = 2.0 ** -np.array(spec.element_fractions)
    exact = spec.unpack is None or spec.in_elements is spec  # floats that unpack() writes are rounded
    for _ in range(4):
        elements = device.shown_to(policy).obs
        obs = device.rollout(policy, 1, record=True).observations.reshape(elements.shape)
        assert elements.dtype.kind in "biu"
        numbers = elements.astype(obs.dtype) * scale
        np.testing.assert_allclose(numbers, obs, rtol=0, atol=0 if exact else scale.max() / 2)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_rollout_is_its_steps(name: str) -> None:
    """In one loop, in parts of any length, and step by step; and everything goes on the same way."""
    n, policy = 70, policy_for(name)
    fast, slow = opened(Native(), name, n), opened(Stepping(), name, n)
    assert_same(fast.rollout(policy, STEPS, record=True), slow.rollout(policy, STEPS, record=True))
    assert_same_place(fast, slow)
    assert_same(fast.rollout(policy, 3), slow.rollout(policy, 3))
    assert_same_place(fast, slow)


@pytest.mark.parametrize("name", ["ConnectFour", "LevelBasedForaging", "SimpleTag"])
def test_a_network_for_each_agent(name: str) -> None:
    """With masks and turns, and worlds of four agents; in one loop, unless a network tells agents apart."""
    every = [policy_for(name, seed) for seed in range(pearl_marl.get_spec(name).agents)]
    telling = AgentNetworks(tuple(every))
    policy = AgentNetworks(tuple(replace(network, indicator=network.indicator[:0]) for network in every))
    elements = element_dtype(policy.form(policy.spec))
    assert compiled_policy(policy, elements) is not None
    assert (compiled_policy(telling, elements) is None) == any(len(network.indicator) for network in every)
    for each in (policy, telling):
        fast, slow = opened(Native(), name, 1_100), opened(Stepping(), name, 1_100)
        assert_same(fast.rollout(each, 20, record=True), slow.rollout(each, 20, record=True))
        assert_same(fast.rollout(each, 3), slow.rollout(each, 3))
        assert_same_place(fast, slow)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("how", [{"max_cycles": 7}, {"initial_states": "stored"}, {"first_slot": 1000}])
@pytest.mark.parametrize("name", ["CartPole", "LevelBasedForaging"])
def test_limits_starts_and_places(name: str, how: dict[str, Any], mode: AutoresetMode) -> None:
    policy = policy_for(name)
    fast, slow = (opened(d, name, 33, autoreset_mode=mode, **how) for d in (Native(), Stepping()))
    for steps in (1, STEPS):
        assert_same(fast.rollout(policy, steps, record=True), slow.rollout(policy, steps, record=True))
    assert_same_place(fast, slow)


@pytest.mark.parametrize("name", ["CliffWalking", "CartPole"])
def test_in_plain_python(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    policy = policy_for(name)
    fast, slow = opened(Native(), name, 5), opened(pearl_marl.devices.make_device("reference"), name, 5)
    monkeypatch.setattr(rollouts, "look", None)  # which runs compiled code
    slow_part = slow.rollout(policy, 2)
    monkeypatch.undo()
    assert_same(fast.rollout(policy, 2), slow_part)
    assert_same(fast.rollout(policy, STEPS, record=True), slow.rollout(policy, STEPS, record=True))
    assert_same_place(fast, slow)


def test_sizes_threads_and_shards() -> None:
    """Blocks, tiles and shards end anywhere; draws go by the number of a slot."""
    policy = policy_for("CartPole")
    for n in (1, 64, 1025, 2500):
        results = []
        for device in (
            Native(threads=1),
            Native(threads=2),
            Sharded([Native(threads=1)] * 1 + [Native(threads=1)]),
        ):
            if n == 1 and isinstance(device, Sharded):
                continue
            results.append(opened(device, "CartPole", n).rollout(policy, 20, record=True))
        for other in results[1:]:
            assert_same(results[0], other)


@pytest.mark.parametrize("mode", MODES)
def test_sums_are_those_of_the_steps(mode: AutoresetMode) -> None:
    """Counted again from the steps, of episodes that began with the rollout or in it."""
    device = opened(Native(), "CartPole", 20, autoreset_mode=mode, max_cycles=15)
    policy = policy_for("CartPole")
    device.rollout(policy, 5)
    result = device.rollout(policy, STEPS, record=True)
    assert result.rewards is not None
    assert result.terminations is not None
    assert result.truncations is not None
    returns, lengths = [], []
    for agent in range(20):
        total, length, whole, resets = 0.0, 0, False, False
        for t in range(STEPS):
            if resets:
                resets = False
                continue
            total, length = total + float(result.rewards[t, agent]), length + 1
            if result.terminations[t, agent] or result.truncations[t, agent]:
                if whole:
                    returns.append(total)
                    lengths.append(length)
                total, length, whole, resets = 0.0, 0, True, mode is AutoresetMode.NEXT_STEP
    assert result.episodes == len(returns) > 0
    assert result.mean_return == pytest.approx(np.mean(returns))
    assert result.mean_length == pytest.approx(np.mean(lengths))
    assert result.squares.sum() == pytest.approx(np.square(returns).sum())


def test_no_episode_has_no_mean() -> None:
    result = opened(Native(), "CliffWalking", 3).rollout(policy_for("CliffWalking"), 2)
    assert (result.episodes, result.mean_return, result.mean_length) == (0, None, None)


def test_both_interfaces_roll_out() -> None:
    env = pearl_marl.parallel_env("LevelBasedForaging", n_agents=6)
    policy = policy_for("LevelBasedForaging")
    env.reset(seed=0)
    result = env.unwrapped.rollout(policy, steps=50, record=True)
    assert (result.steps, result.episodes) == (50, 6)
    assert result.observations is not None
    assert result.observations.shape == (50, 6, *env.observation_space("agent_0")["observation"].shape)  # type: ignore[index]
    vector = pearl_marl.make_vec("CartPole", num_envs=4)
    vector.reset(seed=0)
    assert vector.rollout(policy_for("CartPole"), 30).steps == 30


def test_observations_are_those_of_single_steps() -> None:
    """Also where policies are shown words, and environments floats."""
    one, other = (opened(Native(), "CartPole", 9) for _ in range(2))
    result = one.rollout(policy_for("CartPole"), 10, record=True)
    assert result.observations is not None
    assert result.actions is not None
    for t in range(9):
        step = other.step(result.actions[t])
        assert np.array_equal(step.obs, result.observations[t + 1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None, 5), "policy is None; a rollout takes a policy in integers"),
        ((policy_for("Taxi"), 5), "the policy is for Taxi with the observation_space Discrete"),
        ((policy_for("CartPole"), 0), "steps is 0"),
        ((policy_for("CartPole"), True), "steps is True"),
        ((policy_for("CartPole"), 1, "yes"), "record is 'yes'"),
        ((policy_for("CartPole"), 10**12, True), "GiB"),
    ],
)
def test_what_is_refused_changes_nothing(arguments: Any, message: str) -> None:
    device = opened(Native(), "CartPole", 3)
    before = device.snapshot().to_bytes()
    with pytest.raises(ArgumentError, match=message):
        device.rollout(*arguments)
    assert device.snapshot().to_bytes() == before


def test_order() -> None:
    policy = policy_for("CartPole")
    env = pearl_marl.parallel_env("CartPole", n_agents=3)
    with pytest.raises(OrderError, match=r"rollout\(\) before reset\(\)"):
        env.rollout(policy, 5)
    leaving = pearl_marl.parallel_env("CartPole", n_agents=3, autoreset=False)
    leaving.reset(seed=0)
    with pytest.raises(OrderError, match="autoreset=True"):
        leaving.rollout(policy, 5)
    env.reset(seed=0)
    with pytest.raises(OrderError, match="a wrapped environment has no"):
        pearl_marl.wrappers.clip_reward_v0(env).rollout(policy, 5)


@pytest.mark.usefixtures("ctrl_c")
def test_an_interrupt_between_parts_undoes_the_rollout() -> None:
    device = opened(Native(), "CartPole", 3)
    before = device.snapshot().to_bytes()
    parts, run = [], device._run_part  # type: ignore[attr-defined]

    def interrupted(*arguments: Any) -> None:
        parts.append(arguments)
        run(*arguments)
        if len(parts) == 2:
            signal.raise_signal(signal.SIGINT)

    with mock.patch.object(device, "_run_part", interrupted), pytest.raises(KeyboardInterrupt):
        device.rollout(policy_for("CartPole"), 1000)
    assert device.snapshot().to_bytes() == before
    device.step([0, 0, 0])


class Failing(Native):
    """Fails at a step, as hardware may."""

    fails_at = 1 << 62

    def _rollout(self, *arguments: Any) -> Any:
        return Device._rollout(self, *arguments)

    def _step(self, actions: Any) -> Any:
        if self.tick == self.fails_at:
            raise DeviceError("the cable is out")
        return super()._step(actions)

    def _may_have_moved(self) -> bool:
        return True


def test_a_failure_under_way_counts_nothing() -> None:
    device = opened(Failing(), "CartPole", 3)
    device.fails_at = 6  # type: ignore[attr-defined]
    with pytest.raises(DeviceError, match="cable"):
        device.rollout(policy_for("CartPole"), 10)
    assert device.phase is Phase.FAILED
    assert device.tick == 0


def test_recovery_repeats_a_rollout() -> None:
    """Of parts of a batch, one of which fails in the step after a rollout."""
    policy = policy_for("CartPole")
    parts = [Native(threads=1), Failing(threads=1)]
    device = opened(Sharded(parts), "CartPole", 6)
    other = opened(Native(threads=1), "CartPole", 6)
    for each in (device, other):
        each.rollout(policy, 4)
    parts[1].fails_at = device.tick  # type: ignore[attr-defined]
    with pytest.raises(DeviceError):
        device.step(np.zeros(6, np.uint8))
    parts[1].fails_at = 1 << 62  # type: ignore[attr-defined]
    device.recover()
    assert_same_place(device, other)


def test_sums_are_rounded_as_everywhere() -> None:
    """A product that is added in one rounding would differ in the last bit, of rewards such as 0.01."""
    policy = policy_for("DeepSea")
    fast, slow = opened(Native(), "DeepSea", 5_000), opened(Stepping(), "DeepSea", 5_000)
    assert_same(fast.rollout(policy, 120), slow.rollout(policy, 120))
