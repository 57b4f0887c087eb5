"""PQN as PureJaxQL writes it, on gymnax: rollout and learning are one function that JAX compiles.

Written after the algorithm of PureJaxQL's ``pqn_minatar.py`` (Gallici et al., 2024, arXiv:2407.04811), of
which ``gymnax_loop.py`` has what is not PQN's own. As in our PQN, layer norm has no weights of its own, the
optimiser is Adam instead of RAdam, and the learning rate falls to 0.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.benchmark.watch import Watch
from pearl_marl.policies.dense import EPSILON
from pearl_marl.training.pqn import PQN

from .gymnax_loop import LoopStep, applied, dense, filtered, filters, run


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
    s = settings

    def loss(params: Any, step: LoopStep, _: Any, targets: Any) -> Any:
        values = jnp.take_along_axis(network(params, step.obs), step.actions[:, None], 1)[:, 0]
        return 0.5 * ((values - targets) ** 2).mean()

    def valued(params: Any, inputs: Any) -> tuple[Any, Any]:
        outputs = network(params, inputs)
        return outputs, outputs.max(1)

    def choose(outputs: Any, keys: Any, done: Any) -> tuple[Any, None]:
        deciding, drawing = keys
        passed = jnp.minimum(done / s.iterations / s.exploration_fraction, 1.0)
        explored = s.epsilon + passed * (s.final_epsilon - s.epsilon)
        n, actions = outputs.shape
        others = jax.random.randint(drawing, (n,), 0, actions)
        random = jax.random.uniform(deciding, (n,)) < explored
        return jnp.where(random, others, outputs.argmax(1)), None

    # Targets, which are lambda-returns, are values of best actions plus their advantages by the same lambda.
    run(task, settings, watch, weights, valued, choose, loss, draws=2, max_grad_norm=PQN.max_grad_norm)
