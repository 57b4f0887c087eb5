"""Policy steps per second of rollouts on a GPU, with policies of random numbers.

``python -m tests.devices.gpu_rollouts ENV ...`` prints them, with 43,008 agents and with a million.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from gymnasium.spaces import Discrete

import pearl_marl
from pearl_marl.devices import BatchConfig, Cuda
from pearl_marl.policies.integer_network import IntegerNetwork, table_network
from pearl_marl.spec import EnvSpec

from ..policies.networks import random_network

ROUNDS, SECONDS = 5, 0.5


def policy_for(spec: EnvSpec) -> IntegerNetwork:
    """Return a table where observations are numbers, else a network: a wider one, of planes."""
    seen, actions = spec.observation_space, spec.action_space
    if isinstance(seen, Discrete) and isinstance(actions, Discrete):
        return table_network(spec, np.random.default_rng(0).integers(0, 9, (int(seen.n), int(actions.n))))
    return random_network(spec, 5, (64, 64) if len(spec.observation_shape) == 3 else (32, 32))


def rate(spec: EnvSpec, n_agents: int) -> float:
    """Return the fastest round's policy steps per second."""
    device, policy = Cuda(), policy_for(spec)
    device.open(BatchConfig(spec=spec, n_envs=n_agents // spec.agents, copy=False))
    device.reset(0)
    device.rollout(policy, 8)  # compiles
    best, steps = 0.0, 32
    for _ in range(ROUNDS):
        began = time.perf_counter()
        device.rollout(policy, steps)
        seconds = time.perf_counter() - began
        best = max(best, device.config.n_agents * steps / seconds)
        steps = max(1, int(steps * min(8.0, SECONDS / seconds)))
    device.close()
    return best


if __name__ == "__main__":
    for name in sys.argv[1:]:
        for n in (43_008, 1 << 20):
            print(f"{name}, {n:,} agents: {rate(pearl_marl.get_spec(name), n) / 1e6:,.1f} M", flush=True)
