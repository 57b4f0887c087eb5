"""What ``pearl bench rollouts`` times: a policy beside the environments, and loops through the host."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from pearl_marl.batch.config import BatchConfig, worlds_of
from pearl_marl.batch.step import Array
from pearl_marl.benchmark.measure import Contender, Step, UnavailableError
from pearl_marl.benchmark.peers import envpool_of, installed, quiet_spaces
from pearl_marl.devices import Native
from pearl_marl.evaluation.run import Evaluation
from pearl_marl.policies import Policy
from pearl_marl.policies.integer_network import IntegerNetwork, Rows, Scaling
from pearl_marl.spec import EnvSpec

STEPS = 500
"""Steps of a rollout that is timed."""

EVALUATED = 100
"""Steps after which an evaluation that is timed ends all episodes."""


def contenders(run: Path, network: IntegerNetwork, n: int) -> list[Contender]:
    """Return the ways to act and step with the policy of a run, for ``n`` agents.

    Of a rollout, ``n`` counts the agents of all its steps.
    """
    integers, cores = "the policy in integers", os.cpu_count() or 1
    floats = "the policy as it was trained; then a step; one thread"
    evaluated = "the same, with every step's statistics and digest"
    evaluation = partial(_evaluation, run, network.spec, n)
    steps = evaluation().steps
    peer = "a network of the same sizes in torch, on one thread; EnvPool, on all cores"
    ours: dict[str, tuple[str, int, Callable[[], Step]]] = {
        "rollout": (f"{integers}; one thread", n * STEPS, partial(_rollout, network, n, 1)),
        f"rollout, threads={cores}": (integers, n * STEPS, partial(_rollout, network, n, cores)),
        "policy, then step": (floats, n, partial(_through_host, run, network.spec, n)),
        "pearl eval": (evaluated, n * steps, lambda: evaluation),
    }
    rows = [Contender(name, counts, size, make, ours=True) for name, (counts, size, make) in ours.items()]
    return [*rows, Contender("EnvPool, torch", peer, n, partial(_envpool, network, n))]


def _opened(spec: EnvSpec, n: int, threads: int) -> tuple[Native, Array]:
    """Return a device after its reset, and the observations."""
    device = Native(threads=threads)
    device.open(BatchConfig(spec=spec, n_envs=worlds_of(spec, n)))
    return device, device.reset(0)


def _rollout(network: IntegerNetwork, n: int, threads: int) -> Step:
    device, _ = _opened(network.spec, n, threads)
    return partial(device.rollout, network, STEPS)


def _as_trained(run: Path) -> Policy:
    from pearl_marl.policies import trained  # which takes torch

    choose: Policy = trained.load(run).function
    return choose


def _through_host(run: Path, spec: EnvSpec, n: int) -> Step:
    policy = _as_trained(run)
    device, observations = _opened(spec, n, 1)
    last = [observations]

    def step() -> None:
        masks = () if device.action_masks is None else (device.action_masks,)
        last[0] = device.step(policy(last[0], *masks)).obs

    return step


def _evaluation(run: Path, spec: EnvSpec, n: int) -> Evaluation:
    """Return an evaluation that has been run."""
    policy = _as_trained(run)
    evaluation = Evaluation(spec, policy, n, Native(threads=1), max_cycles=EVALUATED)
    for _ in evaluation.run():
        pass
    return evaluation


def _envpool(network: IntegerNetwork, n: int) -> Step:
    spec, inputs, layers = network.spec, network.inputs, network.layers
    with installed("'.[train]'"):
        import torch
    if spec.agents > 1 or not spec.action_counts:
        raise UnavailableError("compared for one agent that chooses a number")
    torch.set_num_threads(1)
    if isinstance(inputs, Scaling):
        parts: list[torch.nn.Module] = []
        for layer in layers:
            parts += [torch.nn.Linear(*reversed(layer.weights.shape)), torch.nn.Tanh()]
        chosen: torch.nn.Module = torch.nn.Sequential(*parts[:-1])
    elif isinstance(inputs, Rows) and len(layers) == 1:
        chosen = torch.nn.Embedding(*inputs.table.shape)
    else:
        raise UnavailableError("compared for vectors and tables")
    envs = envpool_of(spec, n)
    with quiet_spaces():
        last = [envs.reset()[0]]

    def step() -> None:
        with torch.inference_mode():
            actions = chosen(torch.from_numpy(np.asarray(last[0]))).argmax(-1).numpy()
        last[0] = envs.step(actions.astype(envs.action_space.dtype))[0]

    return step
