"""PQN as PureJaxQL writes it, on gymnax: rollout and learning are one function that JAX compiles.

Written after the algorithm of PureJaxQL's ``pqn_minatar.py`` (Gallici et al., 2024, arXiv:2407.04811), of
which ``gymnax_loop.py`` has what is not PQN's own. As in our PQN, layer norm has no weights of its own, the
optimiser is Adam instead of RAdam, and the learning rate falls to 0.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.benchmark.watch import Watch
from pearl_marl.policies.dense import EPSILON
from pearl_marl.training.pqn import PQN

from .gymnax_loop import (
    GymnaxAgents,
    Learner,
    LoopState,
    advantages,
    applied,
    dense,
    filtered,
    filters,
    run,
)


class ValuedStep(NamedTuple):
    """One step of every environment, with the values of the best actions."""

    obs: Any
    actions: Any
    values: Any
    rewards: Any
    dones: Any


def weights(key: Any, shape: tuple[int, ...], actions: int, width: int) -> dict[str, Any]:
    """Return the first weights: of two layers and the outputs, and for pictures of a convolution before."""
    keys, size = jax.random.split(key, 4), shape[0]
    params: dict[str, Any] = {}
    if len(shape) == 3:
        params["kernel"], size = filters(keys[0], shape)
    layers = dense(keys[1], size, width), dense(keys[2], width, width), dense(keys[3], width, actions, 1.0)
    return {**params, "layers": list(layers)}


def normed(features: Any) -> Any:
    """Return what a layer made, standardised row by row."""
    mean, variance = features.mean(1, keepdims=True), features.var(1, keepdims=True)
    return (features - mean) * jax.lax.rsqrt(variance + EPSILON)


def network(params: Any, obs: Any) -> Any:
    """Return the action values."""
    if "kernel" not in params:
        return applied(params["layers"], obs, lambda made: jnp.tanh(normed(made)))
    features = filtered(params["kernel"], obs)
    return applied(params["layers"], features, lambda made: jax.nn.relu(normed(made)))


def train(task: TrainingTask, settings: Any, watch: Watch) -> None:
    """Train until the watch says that it is over."""
    agents, s = GymnaxAgents(task, settings), settings

    def loss(params: Any, step: ValuedStep, targets: Any) -> Any:
        values = jnp.take_along_axis(network(params, step.obs), step.actions[:, None], 1)[:, 0]
        return 0.5 * ((values - targets) ** 2).mean()

    learner = Learner(settings, loss, PQN.max_grad_norm)

    def act(carry: Any, _: Any, explored: Any) -> Any:
        params, statistics, states, obs, key = carry
        key, deciding, drawing, stepping = jax.random.split(key, 4)
        inputs = agents.inputs(statistics, obs)
        outputs = network(params, inputs)
        others = jax.random.randint(drawing, (agents.n,), 0, agents.actions)
        random = jax.random.uniform(deciding, (agents.n,)) < explored
        actions = jnp.where(random, others, outputs.argmax(1))
        statistics, states, obs, rewards, dones = agents.stepped(statistics, states, actions, stepping)
        step = ValuedStep(inputs, actions, outputs.max(1), rewards, dones)
        return (params, statistics, states, obs, key), step

    def update(state: LoopState) -> LoopState:
        params, opt_state, *others, done = state
        passed = jnp.minimum(done / s.iterations / s.exploration_fraction, 1.0)
        explored = s.epsilon + passed * (s.final_epsilon - s.epsilon)
        exploring = partial(act, explored=explored)
        carry, steps = jax.lax.scan(exploring, (params, *others), None, s.rollout_length)
        params, statistics, states, obs, key = carry
        last = network(params, agents.inputs(statistics, obs)).max(1)
        # Lambda-returns are values of best actions plus these values' advantages by the same lambda.
        targets = steps.values + advantages(steps, last, settings)
        params, opt_state, key = learner.learn(params, opt_state, (steps, targets), key)
        return LoopState(params, opt_state, statistics, states, obs, key, done + 1)

    first = partial(weights, shape=agents.shape, actions=agents.actions, width=s.width)
    run(agents, learner, first, update, network, settings, watch)
