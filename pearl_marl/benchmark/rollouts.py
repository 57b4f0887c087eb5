"""What ``pearl bench rollouts`` times: policies beside the environments, and loops through the host."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import BatchConfig, worlds_of
from pearl_marl.benchmark.measure import Contender, Step, UnavailableError
from pearl_marl.benchmark.peers import envpool_of, gymnax_of, installed, quiet_spaces
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
    sizes = "a network of the same sizes"
    envpool = f"{sizes} in torch, on one thread; EnvPool, on all cores"
    gymnax = f"{sizes} in JAX; on all cores"
    own = partial(Contender, ours=True)
    return [
        own("rollout", f"{integers}; one thread", n * STEPS, partial(_rollout, network, n, 1)),
        own(f"rollout, threads={cores}", integers, n * STEPS, partial(_rollout, network, n, cores)),
        own("policy, then step", floats, n, partial(_through_host, run, network.spec, n)),
        own("pearl eval", evaluated, n * steps, lambda: evaluation),
        Contender("EnvPool, torch", envpool, n, partial(_envpool, network, n)),
        Contender("gymnax, JAX", gymnax, n * STEPS, partial(gymnax_rollout, network, n)),
    ]


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


def _shapes(network: IntegerNetwork) -> list[tuple[int, int]]:
    """Return outputs and inputs of each layer, or rows and actions of a table, for others' policies."""
    spec, inputs = network.spec, network.inputs
    if spec.agents > 1 or not spec.action_counts:
        raise UnavailableError("compared for one agent that chooses a number")
    if isinstance(inputs, Scaling):
        return [layer.weights.shape for layer in network.layers]
    if isinstance(inputs, Rows) and len(network.layers) == 1:
        return [inputs.table.shape]
    raise UnavailableError("compared for vectors and tables")


def _envpool(network: IntegerNetwork, n: int) -> Step:
    spec, shapes = network.spec, _shapes(network)
    with installed("'.[train]'"):
        import torch
    torch.set_num_threads(1)
    if isinstance(network.inputs, Rows):
        chosen: torch.nn.Module = torch.nn.Embedding(*shapes[0])
    else:
        parts: list[torch.nn.Module] = []
        for outputs, width in shapes:
            parts += [torch.nn.Linear(width, outputs), torch.nn.Tanh()]
        chosen = torch.nn.Sequential(*parts[:-1])
    envs = envpool_of(spec, n)
    with quiet_spaces():
        last = [envs.reset()[0]]

    def step() -> None:
        with torch.inference_mode():
            actions = chosen(torch.from_numpy(np.asarray(last[0]))).argmax(-1).numpy()
        last[0] = envs.step(actions.astype(envs.action_space.dtype))[0]

    return step


def gymnax_rollout(network: IntegerNetwork, n: int) -> Step:
    """Return a rollout of gymnax's form of an environment, with a network of the same sizes, in JAX."""
    spec, shapes = network.spec, _shapes(network)
    env, params = gymnax_of(spec)
    import jax

    random = np.random.default_rng(0)
    weights = [random.normal(size=shape).astype(np.float32) for shape in shapes]
    step = jax.vmap(env.step, in_axes=(0, 0, 0, None))

    def choose(obs: Any) -> Any:
        if isinstance(network.inputs, Rows):
            return jax.numpy.asarray(weights[0])[obs].argmax(1)
        for layer in weights[:-1]:
            obs = jax.numpy.tanh(obs @ layer.T)
        return (obs @ weights[-1].T).argmax(1)

    def once(carry: Any, _: Any) -> Any:
        obs, states, key = carry
        key, own = jax.random.split(key)
        obs, states, rewards, *_ = step(jax.random.split(own, n), states, choose(obs), params)
        return (obs, states, key), rewards.sum()

    @partial(jax.jit, donate_argnums=0)
    def rollout(carry: Any) -> Any:
        return jax.lax.scan(once, carry, None, STEPS)

    key, resetting = jax.random.split(jax.random.key(0))
    last = [(*jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(resetting, n), params), key)]

    def run() -> None:
        last[0], rewards = rollout(last[0])
        rewards.block_until_ready()

    return run
