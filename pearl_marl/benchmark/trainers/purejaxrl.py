"""PPO as PureJaxRL writes it, on gymnax: rollout and learning are one function that JAX compiles.

Written after the algorithm of PureJaxRL's ``ppo.py`` (Lu et al., 2022, arXiv:2210.05639), of which
``gymnax_loop.py`` has what is not PPO's own. Values are clipped; their squared errors have a weight of 1/2,
as ours.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.benchmark.watch import Watch

from .gymnax_loop import LoopStep, applied, dense, filtered, filters, run


def weights(key: Any, shape: tuple[int, ...], actions: int, width: int) -> dict[str, Any]:
    """Return the first weights of actor and critic, and of the convolution that they share for pictures."""
    keys = jax.random.split(key, 6)
    if len(shape) == 3:
        kernel, size = filters(keys[0], shape)
        return {
            "kernel": kernel,
            "shared": [dense(keys[1], size, width), dense(keys[2], width, width)],
            "actor": [dense(keys[3], width, actions, 0.01)],
            "critic": [dense(keys[4], width, 1, 1.0)],
        }
    sizes = ((shape[0], width, 2**0.5), (width, width, 2**0.5))
    return {
        name: [*(dense(k, *size) for k, size in zip(some[:2], sizes, strict=True)), dense(some[2], *last)]
        for name, some, last in (
            ("actor", keys[:3], (width, actions, 0.01)),
            ("critic", keys[3:], (width, 1, 1.0)),
        )
    }


def network(params: Any, obs: Any) -> tuple[Any, Any]:
    """Return logits and values."""
    if "kernel" not in params:
        values = applied(params["critic"], obs, jnp.tanh)
        return applied(params["actor"], obs, jnp.tanh), values[:, 0]
    features = filtered(params["kernel"], obs)
    features = jax.nn.relu(applied(params["shared"], features, jax.nn.relu))
    return applied(params["actor"], features, None), applied(params["critic"], features, None)[:, 0]


def train(task: TrainingTask, settings: Any, watch: Watch) -> None:
    """Train until the watch says that it is over."""
    s = settings

    def loss(params: Any, step: LoopStep, gains: Any, targets: Any) -> Any:
        logits, values = network(params, step.obs)
        chances = jax.nn.log_softmax(logits)
        logs = jnp.take_along_axis(chances, step.actions[:, None], 1)[:, 0]
        near = step.values + (values - step.values).clip(-s.clip, s.clip)
        value_loss = 0.5 * jnp.maximum((values - targets) ** 2, (near - targets) ** 2).mean()
        ratio = jnp.exp(logs - step.logs)
        scaled = (gains - gains.mean()) / (gains.std() + 1e-8)
        policy_loss = -jnp.minimum(ratio * scaled, ratio.clip(1 - s.clip, 1 + s.clip) * scaled).mean()
        entropy = -(jnp.exp(chances) * chances).sum(1).mean()
        return policy_loss + value_loss - s.entropy * entropy

    def choose(logits: Any, keys: Any, _: Any) -> tuple[Any, Any]:
        actions = jax.random.categorical(*keys, logits)
        logs = jnp.take_along_axis(jax.nn.log_softmax(logits), actions[:, None], 1)[:, 0]
        return actions, logs

    run(task, settings, watch, weights, network, choose, loss, draws=1, max_grad_norm=0.5)
