"""PPO as PureJaxRL writes it, on gymnax: rollout and learning are one function that JAX compiles.

Written after the algorithm of PureJaxRL's ``ppo.py`` (Lu et al., 2022, arXiv:2210.05639): scans over steps,
epochs and minibatches, environments that start over by themselves, a time limit that is an end like any
other, values that are clipped; their squared errors have a weight of 1/2, as ours. It compiles the whole
training; here it is one update, so that the policy can be evaluated in between. Compilation is not counted.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import optax

from pearl_marl.benchmark.peers import gymnax_of
from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.benchmark.watch import Watch


class LearningStep(NamedTuple):
    """One step of every environment, as learning needs it."""

    obs: Any
    actions: Any
    logs: Any
    values: Any
    rewards: Any
    dones: Any


class RunningStatistics(NamedTuple):
    """Mean and variance of all vectors so far."""

    mean: Any
    variance: Any
    count: Any

    def updated(self, obs: Any) -> RunningStatistics:
        """Return the statistics with one batch more."""
        mean, variance, rows = obs.mean(0), obs.var(0), len(obs)
        total, change = self.count + rows, mean - self.mean
        squares = self.variance * self.count + variance * rows + change**2 * self.count * rows / total
        return RunningStatistics(self.mean + change * rows / total, squares / total, total)

    def scaled(self, obs: Any) -> Any:
        """Return a batch standardised."""
        return ((obs - self.mean) / jnp.sqrt(self.variance + 1e-8)).clip(-10, 10)


def dense(key: Any, inputs: int, outputs: int, scale: float = 2**0.5) -> Any:
    """Return a layer's first weights."""
    return jax.nn.initializers.orthogonal(scale)(key, (inputs, outputs)), jnp.zeros(outputs)


def applied(layers: Any, features: Any, activation: Any) -> Any:
    """Return what layers make of features; after the last there is no activation."""
    *hidden, (weights, bias) = layers
    for matrix, offset in hidden:
        features = activation(features @ matrix + offset)
    return features @ weights + bias


def weights(key: Any, shape: tuple[int, ...], actions: int, width: int) -> dict[str, Any]:
    """Return the first weights of actor and critic, and of the convolution that they share for pictures."""
    keys = jax.random.split(key, 6)
    if len(shape) == 3:
        height, breadth, channels = shape
        size = 16 * (height - 2) * (breadth - 2)
        kernel = jax.nn.initializers.orthogonal(2**0.5)(keys[0], (3, 3, channels, 16))
        return {
            "kernel": (kernel, jnp.zeros(16)),
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
    # A product of slices is the same as XLA's convolution, and on a CPU many times as fast within a scan.
    kernel, bias = params["kernel"]
    height, breadth = obs.shape[1] - 2, obs.shape[2] - 2
    slices = [obs[:, i : i + height, j : j + breadth] for i in range(3) for j in range(3)]
    planes = jax.nn.relu(jnp.concatenate(slices, 3) @ kernel.reshape(-1, kernel.shape[3]) + bias)
    features = planes.reshape(len(obs), -1)
    features = jax.nn.relu(applied(params["shared"], features, jax.nn.relu))
    return applied(params["actor"], features, None), applied(params["critic"], features, None)[:, 0]


def train(task: TrainingTask, settings: Any, watch: Watch) -> None:
    """Train until the watch says that it is over."""
    env, env_params = gymnax_of(task.spec)
    space: Any = env.observation_space(env_params)
    numbers, vector = not space.shape, len(space.shape) == 1
    shape = (int(space.n),) if numbers else space.shape
    n, depth, s = settings.n_agents, settings.rollout_length, settings
    batches = max(n * depth // s.minibatch, 1)

    def prepared(statistics: Any, obs: Any) -> Any:
        if numbers:
            return jax.nn.one_hot(obs, shape[0])
        return statistics.scaled(obs) if vector else obs.astype(jnp.float32)

    def rate(count: Any) -> Any:
        return s.learning_rate * (1 - count // (batches * s.epochs) / s.iterations)

    optimiser = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(rate, eps=1e-5))

    def loss(params: Any, step: LearningStep, gains: Any, targets: Any) -> Any:
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

    def act(carry: Any, _: Any) -> Any:
        params, statistics, states, obs, key = carry
        key, drawing, stepping = jax.random.split(key, 3)
        inputs = prepared(statistics, obs)
        logits, values = network(params, inputs)
        actions = jax.random.categorical(drawing, logits)
        logs = jnp.take_along_axis(jax.nn.log_softmax(logits), actions[:, None], 1)[:, 0]
        step = jax.vmap(env.step, in_axes=(0, 0, 0, None))
        after, states, rewards, terminated, truncated, _ = step(
            jax.random.split(stepping, n), states, actions, env_params
        )
        if vector:
            statistics = statistics.updated(after)
        dones = terminated | truncated
        rewards = rewards.astype(jnp.float32) * s.reward_scale
        return (params, statistics, states, after, key), LearningStep(
            inputs, actions, logs, values, rewards, dones
        )

    def advantage(carry: Any, step: LearningStep) -> Any:
        gain, following = carry
        going_on = 1.0 - step.dones
        gain = (
            step.rewards
            + s.discount * following * going_on
            - step.values
            + s.discount * s.gae_lambda * going_on * gain
        )
        return (gain, step.values), gain

    def descend(carry: Any, batch: Any) -> Any:
        params, opt_state = carry
        updates, opt_state = optimiser.update(jax.grad(loss)(params, *batch), opt_state)
        return (optax.apply_updates(params, updates), opt_state), None

    def epoch(carry: Any, key: Any, everything: Any) -> Any:
        order = jax.random.permutation(key, n * depth)
        minibatches = jax.tree.map(lambda x: x[order].reshape(batches, -1, *x.shape[1:]), everything)
        return jax.lax.scan(descend, carry, minibatches)

    def update(runner: Any) -> Any:
        params, opt_state, *others = runner
        (params, statistics, states, obs, key), steps = jax.lax.scan(act, (params, *others), None, depth)
        last = network(params, prepared(statistics, obs))[1]
        _, gains = jax.lax.scan(advantage, (jnp.zeros(n), last), steps, reverse=True)
        everything = jax.tree.map(
            lambda x: x.reshape(n * depth, *x.shape[2:]), (steps, gains, gains + steps.values)
        )
        key, *shuffling = jax.random.split(key, s.epochs + 1)
        learn = partial(epoch, everything=everything)
        (params, opt_state), _ = jax.lax.scan(learn, (params, opt_state), jnp.stack(shuffling))
        return params, opt_state, statistics, states, obs, key

    key, starting, resetting = jax.random.split(jax.random.key(s.seed), 3)
    params = weights(starting, shape, env.num_actions, s.width)
    obs, states = jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(resetting, n), env_params)
    statistics: Any = None
    if vector:
        statistics = RunningStatistics(jnp.zeros(shape), jnp.ones(shape), jnp.float32(1e-4)).updated(obs)
    runner = (params, optimiser.init(params), statistics, states, obs, key)
    compiled = jax.jit(update, donate_argnums=0).lower(runner).compile()
    best = jax.jit(lambda params, statistics, obs: network(params, prepared(statistics, obs))[0].argmax(1))

    def choose(observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.asarray(best(runner[0], runner[2], jnp.asarray(observations)))

    watch.start()
    for iteration in range(s.iterations):
        runner = jax.block_until_ready(compiled(runner))
        if watch((iteration + 1) * n * depth, choose):
            return
