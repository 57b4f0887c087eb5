"""The gradients of PPO's loss, compiled: by all weights of small networks, in one pass over a minibatch.

They are those that autograd finds for ``PPO.autograd``. PyTorch calls a hundred operations for each
minibatch, and small networks would wait for these calls. The networks are those of
:mod:`pearl_marl.policies.dense`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numba.extending import overload
from torch import Tensor

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.policies import dense
from pearl_marl.policies.dense import (
    ARITHMETIC,
    ROWS,
    Layers,
    NetworkInputs,
    backward_rows,
    called,
    exponential,
    forward_rows,
    gradient_sums,
    padded,
    store_gradients,
    tile_of,
)
from pearl_marl.policies.network import MASKED, Pictures, is_dense, takes_planes
from pearl_marl.training.actor_critic import ActorCritic
from pearl_marl.training.halves import Halves
from pearl_marl.training.rollout import RolloutBuffer

_MASKED, _ONE, _NONE = np.float32(MASKED), np.float32(1), np.float32(0)
_HALF_LOG_TURN = 0.5 * math.log(2 * math.pi)


class Samples(NamedTuple):
    """A rollout's samples, a row for each."""

    actions: Array  # int64 numbers, or float32, (n, outputs)
    masks: Array  # (n, outputs), 0 for actions that were not allowed; or (0, 0)
    column: Array  # which output of the critic is the agent's; or empty, for the first
    log_probs: Array  # of the actions, in the rollout
    advantages: Array
    returns: Array


class Weights(NamedTuple):
    """The weights of a model, or gradients by them."""

    actor: Layers
    critic: Layers
    log_deviation: Array  # of continuous actions; else empty


class Loss(NamedTuple):
    """What the loss of a row depends on beside the row: settings, and statistics of the minibatch."""

    clip: float
    entropy: float
    share: float  # of a row in the loss
    mean: float  # of the advantages, and the factor that standardises them
    scale: float


def _ratio(log: float, samples: Samples, row: int, loss: Loss, figures: Array) -> float:
    """Note the loss of an action; return its gradient by the logarithm of the action's probability."""
    gain = (samples.advantages[row] - loss.mean) * loss.scale
    ratio = math.exp(log - samples.log_probs[row])
    clipped = min(max(ratio, 1 - loss.clip), 1 + loss.clip) * gain
    figures[0] -= min(ratio * gain, clipped)
    figures[3] += abs(ratio - 1) > loss.clip
    # A ratio that has gone too far is not pulled further.
    return -ratio * gain if ratio * gain <= clipped else 0.0


_ratio_of: Callable[..., float] = called(_ratio)

At = tuple[int, int]
"""Where a row's outputs begin, and how many they are."""


def _score(outputs, at, samples, row, log_deviation, loss, figures) -> Any:  # type: ignore[no-untyped-def]
    """Replace a row's outputs by gradients; return the gradient by the logarithm of the deviation."""
    of_kind: Any = _choice if samples.actions.ndim == 1 else _numbers
    return of_kind(outputs, at, samples, row, log_deviation, loss, figures)


@overload(_score, jit_options=ARITHMETIC)
def _score_of(outputs, at, samples, row, log_deviation, loss, figures) -> Any:  # type: ignore[no-untyped-def]
    actions = samples[0]  # types of Numba, whose tuples have no names
    return _choice if actions.ndim == 1 else _numbers


def _choice(outputs, at, samples, row, log_deviation, loss, figures):  # type: ignore[no-untyped-def]
    """Do so where outputs are the logits of actions, of which one was chosen."""
    start, n = at
    masks, action = samples.masks, samples.actions[row]
    masked = len(masks) > 0
    most = _MASKED
    for k in range(n):
        if masked and masks[row, k] == 0:
            outputs[start + k] = _MASKED
        most = max(most, outputs[start + k])
    total = _NONE
    for k in range(n):
        total += exponential(outputs[start + k] - most)
    log_total = most + np.log(total)
    entropy = 0.0
    for k in range(n):
        if not (masked and masks[row, k] == 0):
            log = outputs[start + k] - log_total
            entropy -= exponential(log) * log
    figures[2] += entropy
    by = _ratio_of(outputs[start + action] - log_total, samples, row, loss, figures)
    for k in range(n):
        if masked and masks[row, k] == 0:
            outputs[start + k] = 0
            continue
        log = outputs[start + k] - log_total
        probability = exponential(log)
        gradient = by * ((k == action) - probability) + loss.entropy * probability * (log + entropy)
        outputs[start + k] = gradient * loss.share
    return 0.0


def _numbers(outputs, at, samples, row, log_deviation, loss, figures):  # type: ignore[no-untyped-def]
    """Do so where outputs are means of normal distributions, from which actions were drawn."""
    start, n = at
    actions, wide = samples.actions[row], log_deviation[0]
    spread, log, squares = math.exp(wide), 0.0, 0.0
    for k in range(n):
        deviation = (actions[k] - outputs[start + k]) / spread
        squares += deviation * deviation
        log -= 0.5 * deviation * deviation + wide + _HALF_LOG_TURN
    figures[2] += n * (0.5 + _HALF_LOG_TURN + wide)
    by = _ratio_of(log, samples, row, loss, figures)
    for k in range(n):
        outputs[start + k] = by * loss.share * (actions[k] - outputs[start + k]) / (spread * spread)
    return loss.share * (by * (squares - n) - loss.entropy * n)


def _loss(advantages: Array, rows: Array, clip: float, entropy: float) -> Loss:
    """Return the loss of a minibatch of these rows."""
    n = len(rows)
    mean = squares = 0.0
    for row in rows:
        mean += advantages[row] / n
    if n == 1:  # a single one has no deviation
        return Loss(clip, entropy, 1.0, 0.0, 1.0)
    for row in rows:
        squares += (advantages[row] - mean) ** 2
    return Loss(clip, entropy, 1 / n, mean, 1 / (math.sqrt(squares / (n - 1)) + 1e-8))


def _gradients(
    weights: Weights,
    gradients: Weights,
    actor_inputs: NetworkInputs,
    critic_inputs: NetworkInputs,
    samples: Samples,
    rows: Array,
    loss: Loss,
    figures: Array,
) -> None:
    """Compute the gradients of the loss of some rows of a minibatch.

    Into ``figures``, shape (4,), go the loss of the policy, that of the critic, the entropy, and the share of
    ratios that were clipped.
    """
    n, share = len(rows), loss.share
    actor, critic, log_deviation = weights
    actor_weights, critic_weights = padded(actor), padded(critic)
    actor_tile, critic_tile = tile_of(actor), tile_of(critic)
    actor_sums, critic_sums = gradient_sums(gradients.actor), gradient_sums(gradients.critic)
    n_outputs, out, out_critic = len(actor.bias3), len(actor_weights.bias3), len(critic_weights.bias3)
    by_deviation = 0.0
    figures[:] = 0
    for first in range(0, n, ROWS):
        some = rows[first : first + ROWS]
        forward_rows(actor, actor_weights, actor_inputs, some, actor_tile)
        outputs = actor_tile.outputs
        for s in range(ROWS):
            for k in range(n_outputs if s < len(some) else 0, out):
                outputs[s * out + k] = 0
        for s in range(len(some)):
            row, at = some[s], (s * out, n_outputs)
            by_deviation += _score(outputs, at, samples, row, log_deviation, loss, figures)
        backward_rows(actor, actor_weights, actor_inputs, some, actor_tile, actor_sums, gradients.actor)
        forward_rows(critic, critic_weights, critic_inputs, some, critic_tile)
        outputs = critic_tile.outputs
        for s in range(len(some)):
            row = some[s]
            column = samples.column[row] if len(samples.column) else 0
            error = outputs[s * out_critic + column] - samples.returns[row]
            figures[1] += error * error
            for k in range(out_critic):
                outputs[s * out_critic + k] = 0
            outputs[s * out_critic + column] = error * share
        outputs[len(some) * out_critic :] = 0
        backward_rows(critic, critic_weights, critic_inputs, some, critic_tile, critic_sums, gradients.critic)
    store_gradients(actor_sums, gradients.actor)
    store_gradients(critic_sums, gradients.critic)
    if len(gradients.log_deviation):
        gradients.log_deviation[0] = by_deviation
    for k in range(4):
        figures[k] *= share


def _shared_gradients(
    layers: Layers,
    gradients: Layers,
    inputs: NetworkInputs,
    samples: Samples,
    rows: Array,
    loss: Loss,
    figures: Array,
) -> None:
    """Do the same where actor and critic share all layers but the last, whose last output is the critic's."""
    n, weights, tile, total = len(rows), padded(layers), tile_of(layers), gradient_sums(gradients)
    critic, out = len(layers.bias3) - 1, len(weights.bias3)
    outputs, none = tile.outputs, np.zeros(0, np.float32)
    figures[:] = 0
    for first in range(0, n, ROWS):
        some = rows[first : first + ROWS]
        forward_rows(layers, weights, inputs, some, tile)
        for s in range(len(some)):
            row, start = some[s], s * out
            error = outputs[start + critic] - samples.returns[row]
            figures[1] += error * error
            _score(outputs, (start, critic), samples, row, none, loss, figures)
            outputs[start + critic] = error * loss.share
            outputs[start + critic + 1 : start + out] = 0
        outputs[len(some) * out :] = 0
        backward_rows(layers, weights, inputs, some, tile, total, gradients)
    store_gradients(total, gradients)
    for k in range(4):
        figures[k] *= loss.share


_loss_of = compiled_loop(_loss, fused=True)
_gradients_of = compiled_loop(_gradients, dense, fused=True)
_shared_gradients_of = compiled_loop(_shared_gradients, dense, fused=True)


def fits(model: ActorCritic) -> bool:
    """Return whether these loops can learn a model's networks."""
    if model.shared:
        return takes_planes(model.actor) and not model.policy.heads and not model.continuous
    return is_dense(model.actor) and is_dense(model.critic) and not model.policy.heads


class PPOGradients:
    """Finds gradients for minibatches of a rollout, whose steps and agents are one axis.

    Called with the rows of a minibatch, it leaves the gradients with the model's parameters, and returns what
    ``PPO.autograd`` returns.
    """

    def __init__(self, model: ActorCritic, rollout: RolloutBuffer, clip: float, entropy: float) -> None:
        self._clip, self._entropy = clip, entropy
        inputs, column = rollout.inputs, np.empty(0, np.int64)
        if model.central and inputs.position is not None:
            column = inputs.position.contiguous().numpy()
        masks = inputs.masks
        samples = Samples(
            rollout.actions.contiguous().numpy(),
            np.zeros((0, model.policy.outputs), np.int8) if masks is None else masks.numpy(),
            column,
            *(part.contiguous().numpy() for part in (rollout.log_probs, rollout.advantages, rollout.returns)),
        )
        self._advantages = samples.advantages
        kind = _SharedLayers if model.shared else _SeparateLayers
        self._loops: _SharedLayers | _SeparateLayers = kind(model, rollout, samples)
        self._halves = Halves(model, model.policy.about["width"], self._loops.gradients)

    def __call__(self, rows: Tensor) -> Tensor:
        """Find the gradients of some rows."""
        numbers = rows.numpy()
        loss = _loss_of()(self._advantages, numbers, self._clip, self._entropy)
        return self._halves.find(numbers, partial(self._loops, loss))


class _SeparateLayers:
    """Finds those of a part of a minibatch, where actor and critic share nothing."""

    def __init__(self, model: ActorCritic, rollout: RolloutBuffer, samples: Samples) -> None:
        self._model, self._samples = model, samples
        self._weights = self.gradients(None)
        inputs = rollout.inputs
        critic_obs, critic_position = inputs.obs, inputs.position
        if model.central:
            assert inputs.state is not None
            critic_obs, critic_position = inputs.state, None
        observed = model.actor.observed(inputs.obs, inputs.position)
        self._inputs = observed, model.critic.observed(critic_obs, critic_position)

    def gradients(self, instead: Mapping[Tensor, Tensor] | None) -> Weights:
        """Return the model's weights as compiled loops take them, or the tensors that stand for them."""
        model, deviation = self._model, torch.empty(0)
        if model.continuous:
            deviation = model.log_deviation if instead is None else instead[model.log_deviation]
        layers = model.actor.layers(instead), model.critic.layers(instead)
        return Weights(*layers, deviation.detach().numpy())

    def __call__(self, loss: Loss, rows: Array, gradients: Weights) -> Array:
        """Write the gradients; return the losses."""
        figures = np.empty(4)
        _gradients_of()(self._weights, gradients, *self._inputs, self._samples, rows, loss, figures)
        return figures


class _SharedLayers:
    """Finds those of a part of a minibatch of pictures, where both share all layers but the last."""

    def __init__(self, model: ActorCritic, rollout: RolloutBuffer, samples: Samples) -> None:
        self._model, self._samples = model, samples
        self._pictures = Pictures(model.actor, rollout.inputs.obs, rollout.inputs.position)

    gradients = dict
    """Gradients are written into tensors by parameters: what the first layer makes is not there yet."""

    def __call__(self, loss: Loss, rows: Array, gradients: Mapping[Tensor, Tensor]) -> Array:
        """Write the gradients; return the losses."""
        actor, critic, figures = self._model.actor, self._model.critic, np.empty(4)
        heads = [torch.cat((actor.output.weight, critic.weight)), torch.cat((actor.output.bias, critic.bias))]
        by_heads = [torch.empty_like(head) for head in heads]
        with self._pictures.first_layer(torch.from_numpy(rows), gradients) as (made, by_made):
            weights = _with_heads(actor.layers(made=made), heads)
            by_weights = _with_heads(actor.layers(gradients, by_made), by_heads)
            inputs = self._pictures.inputs
            _shared_gradients_of()(weights, by_weights, inputs, self._samples, rows, loss, figures)
        outputs = len(actor.output.bias)
        for name, by in zip(("weight", "bias"), by_heads, strict=True):
            gradients[getattr(actor.output, name)].copy_(by[:outputs])
            gradients[getattr(critic, name)].copy_(by[outputs:])
        return figures


def _with_heads(layers: Layers, heads: Sequence[Tensor]) -> Layers:
    """Return layers whose last has these weights and biases."""
    weights, bias = (head.detach().numpy() for head in heads)
    return layers._replace(third=weights, bias3=bias)
