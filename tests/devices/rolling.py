"""Rollouts and what they are held against."""

from __future__ import annotations

from typing import Any

import numpy as np

import pearl_marl
from pearl_marl.batch.rollout import Rollout
from pearl_marl.devices import BatchConfig, Device, Native
from pearl_marl.memory_map import Engine
from pearl_marl.policies.integer_network import IntegerNetwork

from ..policies.networks import random_network

NETWORK = Engine("network", drawn=True, products=4, side=2, rounds=2, hidden=8, layers=3)
TABLE = Engine("table", drawn=True, table_rows=64, logit_bits=8)


class Stepping(Native):
    """Rolls out by single steps, with the policy in NumPy."""

    def _rollout(self, *arguments: Any) -> Any:
        return Device._rollout(self, *arguments)


def opened(device: Device, name: str, n: int, **how: Any) -> Device:
    spec = pearl_marl.get_spec(name)
    device.open(BatchConfig(spec=spec, n_envs=n, **how))
    device.reset(seed=3)
    return device


def policy_for(name: str, seed: int = 5) -> IntegerNetwork:
    return random_network(pearl_marl.get_spec(name), seed)


def assert_same(one: Rollout, other: Rollout) -> None:
    for name, value in vars(one).items():
        theirs = getattr(other, name)
        assert (value is None) == (theirs is None), name
        assert value is None or np.array_equal(value, theirs), name


def assert_same_place(one: Device, other: Device) -> None:
    assert one.snapshot().to_bytes() == other.snapshot().to_bytes()
    assert np.array_equal(one.in_episode, other.in_episode)
    if one.action_masks is not None:
        assert np.array_equal(one.action_masks, other.action_masks)
