"""What loops on gymnax have in common: agents, layers, advantages, and updates that JAX compiles.

They are written after PureJaxRL and PureJaxQL: scans over steps, epochs and minibatches, environments that
start over by themselves, and a time limit that is an end like any other. Those compile the whole training;
here it is one update, so that the policy can be evaluated in between. Compilation is not counted.
"""

from __future__ import annotations

from collections.abc import Callable
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

FILTERS = 16
"""Those of a picture's convolution, as ours has them."""


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


class LoopStep(NamedTuple):
    """One step of every environment, as learning needs it."""

    obs: Any
    actions: Any
    logs: Any  # of the actions' probabilities, where actions are drawn
    values: Any
    rewards: Any
    dones: Any


class LoopState(NamedTuple):
    """What an update begins with, and leaves for the next one."""

    params: Any
    opt_state: Any
    statistics: Any  # of vectors, else None
    states: Any  # of the environments
    obs: Any
    key: Any
    done: Any  # updates so far


class GymnaxAgents:
    """The agents of a task, each in an environment of gymnax of its own.

    Attributes
    ----------
    shape
        The shape of a network's inputs.
    actions
        How many there are.
    """

    def __init__(self, task: TrainingTask, settings: Any) -> None:
        self._env, self._env_params = gymnax_of(task.spec)
        self.n, self._reward_scale = settings.n_agents, settings.reward_scale
        space: Any = self._env.observation_space(self._env_params)
        self._numbers, self._vector = not space.shape, len(space.shape) == 1
        self.shape = (int(space.n),) if self._numbers else space.shape
        self.actions: int = self._env.num_actions

    def started(self, key: Any) -> tuple[Any, Any, Any]:
        """Return the first statistics, states and observations."""
        keys = jax.random.split(key, self.n)
        obs, states = jax.vmap(self._env.reset, in_axes=(0, None))(keys, self._env_params)
        statistics: Any = None
        if self._vector:
            first = jnp.zeros(self.shape), jnp.ones(self.shape), jnp.float32(1e-4)
            statistics = RunningStatistics(*first).updated(obs)
        return statistics, states, obs

    def inputs(self, statistics: Any, obs: Any) -> Any:
        """Return observations as networks take them."""
        if self._numbers:
            return jax.nn.one_hot(obs, self.shape[0])
        return statistics.scaled(obs) if self._vector else obs.astype(jnp.float32)

    def stepped(self, statistics: Any, states: Any, actions: Any, key: Any) -> tuple[Any, ...]:
        """Return statistics, states and observations after a step, and its rewards and ends."""
        step = jax.vmap(self._env.step, in_axes=(0, 0, 0, None))
        obs, states, rewards, terminated, truncated, _ = step(
            jax.random.split(key, self.n), states, actions, self._env_params
        )
        if self._vector:
            statistics = statistics.updated(obs)
        rewards = rewards.astype(jnp.float32) * self._reward_scale
        return statistics, states, obs, rewards, terminated | truncated


def dense(key: Any, inputs: int, outputs: int, scale: float = 2**0.5) -> Any:
    """Return a layer's first weights."""
    return jax.nn.initializers.orthogonal(scale)(key, (inputs, outputs)), jnp.zeros(outputs)


def filters(key: Any, shape: tuple[int, ...]) -> tuple[Any, int]:
    """Return the first weights of the filters for pictures, and how many numbers they make."""
    height, breadth, channels = shape
    kernel = jax.nn.initializers.orthogonal(2**0.5)(key, (3, 3, channels, FILTERS))
    return (kernel, jnp.zeros(FILTERS)), FILTERS * (height - 2) * (breadth - 2)


def applied(layers: Any, features: Any, activation: Any) -> Any:
    """Return what layers make of features; after the last there is no activation."""
    *hidden, (weights, bias) = layers
    for matrix, offset in hidden:
        features = activation(features @ matrix + offset)
    return features @ weights + bias


def filtered(weights: Any, obs: Any) -> Any:
    """Return what the filters make of pictures, a row for each."""
    # A product of slices is the same as XLA's convolution, and on a CPU many times as fast within a scan.
    kernel, bias = weights
    height, breadth = obs.shape[1] - 2, obs.shape[2] - 2
    slices = [obs[:, i : i + height, j : j + breadth] for i in range(3) for j in range(3)]
    planes = jax.nn.relu(jnp.concatenate(slices, 3) @ kernel.reshape(-1, kernel.shape[3]) + bias)
    return planes.reshape(len(obs), -1)


def advantages(steps: Any, last: Any, settings: Any) -> Any:
    """Return the advantages of a rollout's steps, whose last one led to observations of these values."""

    def before(carry: Any, step: Any) -> Any:
        gain, following = carry
        going_on = 1.0 - step.dones
        gain = (
            step.rewards
            + settings.discount * following * going_on
            - step.values
            + settings.discount * settings.gae_lambda * going_on * gain
        )
        return (gain, step.values), gain

    return jax.lax.scan(before, (jnp.zeros_like(last), last), steps, reverse=True)[1]


class Learner:
    """Learns from rollouts: in epochs and minibatches, by Adam, at a rate that falls to 0 over the updates.

    Parameters
    ----------
    loss
        The loss of parameters and a minibatch, which is what ``learn`` is given.
    max_grad_norm
        The length that gradients are clipped to.
    """

    def __init__(self, settings: Any, loss: Callable[..., Any], max_grad_norm: float) -> None:
        self._rows, self._epochs = settings.n_agents * settings.rollout_length, settings.epochs
        self._batches = max(self._rows // settings.minibatch, 1)
        self._gradients = jax.grad(loss)

        def rate(count: Any) -> Any:
            passed = count // (self._batches * settings.epochs) / settings.iterations
            return settings.learning_rate * (1 - passed)

        self._optimiser = optax.chain(optax.clip_by_global_norm(max_grad_norm), optax.adam(rate, eps=1e-5))

    def started(self, params: Any) -> Any:
        """Return the optimiser's first state."""
        return self._optimiser.init(params)

    def learn(self, params: Any, opt_state: Any, samples: Any, key: Any) -> tuple[Any, Any, Any]:
        """Return parameters and the optimiser's state after learning from a rollout, and the next key."""
        rows = jax.tree.map(lambda x: x.reshape(self._rows, *x.shape[2:]), samples)
        key, *shuffling = jax.random.split(key, self._epochs + 1)
        epoch = partial(self._epoch, rows=rows)
        (params, opt_state), _ = jax.lax.scan(epoch, (params, opt_state), jnp.stack(shuffling))
        return params, opt_state, key

    def _epoch(self, carry: Any, key: Any, rows: Any) -> Any:
        order = jax.random.permutation(key, self._rows)
        minibatches = jax.tree.map(lambda x: x[order].reshape(self._batches, -1, *x.shape[1:]), rows)
        return jax.lax.scan(self._descend, carry, minibatches)

    def _descend(self, carry: Any, minibatch: Any) -> Any:
        params, opt_state = carry
        updates, opt_state = self._optimiser.update(self._gradients(params, *minibatch), opt_state)
        return (optax.apply_updates(params, updates), opt_state), None


def run(
    task: TrainingTask,
    settings: Any,
    watch: Watch,
    weights: Callable[[Any, tuple[int, ...], int, int], Any],
    network: Callable[[Any, Any], tuple[Any, Any]],
    choose: Callable[[Any, Any, Any], tuple[Any, Any]],
    loss: Callable[..., Any],
    *,
    draws: int,
    max_grad_norm: float,
) -> None:
    """Update until the watch says that it is over.

    Parameters
    ----------
    weights
        Returns a network's first weights, given a key, the shape of inputs, how many actions, and a width.
    network
        Returns a number for each action, and values, given weights and inputs; the best action's is greatest.
    choose
        Returns actions, and the logarithms of their probabilities or None, given those numbers, as many keys
        as ``draws`` says, and the updates so far.
    loss, max_grad_norm
        As :class:`Learner` takes them; a minibatch has steps, their advantages, and targets of their values.
    """
    agents, learner = GymnaxAgents(task, settings), Learner(settings, loss, max_grad_norm)

    def act(carry: Any, _: Any, done: Any) -> Any:
        params, statistics, states, obs, key = carry
        key, *choosing, stepping = jax.random.split(key, draws + 2)
        inputs = agents.inputs(statistics, obs)
        outputs, values = network(params, inputs)
        actions, logs = choose(outputs, choosing, done)
        statistics, states, obs, rewards, dones = agents.stepped(statistics, states, actions, stepping)
        step = LoopStep(inputs, actions, logs, values, rewards, dones)
        return (params, statistics, states, obs, key), step

    def update(state: LoopState) -> LoopState:
        params, opt_state, *others, done = state
        acting = partial(act, done=done)
        carry, steps = jax.lax.scan(acting, (params, *others), None, settings.rollout_length)
        params, statistics, states, obs, key = carry
        last = network(params, agents.inputs(statistics, obs))[1]
        gains = advantages(steps, last, settings)
        samples = steps, gains, gains + steps.values
        params, opt_state, key = learner.learn(params, opt_state, samples, key)
        return LoopState(params, opt_state, statistics, states, obs, key, done + 1)

    key, starting, resetting = jax.random.split(jax.random.key(settings.seed), 3)
    params = weights(starting, agents.shape, agents.actions, settings.width)
    state = LoopState(params, learner.started(params), *agents.started(resetting), key, jnp.int32(0))
    compiled = jax.jit(update, donate_argnums=0).lower(state).compile()

    best = jax.jit(
        lambda params, statistics, obs: network(params, agents.inputs(statistics, obs))[0].argmax(1)
    )

    def policy(observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.asarray(best(state.params, state.statistics, jnp.asarray(observations)))

    watch.start()
    for iteration in range(settings.iterations):
        state = jax.block_until_ready(compiled(state))
        if watch((iteration + 1) * agents.n * settings.rollout_length, policy):
            return
