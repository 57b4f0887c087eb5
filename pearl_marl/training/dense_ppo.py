"""The gradients of PPO's loss, compiled: by all weights of small networks, in one pass over a minibatch.

They are those that autograd finds for ``PPO.autograd``. PyTorch calls a hundred operations for each
minibatch, and small networks would wait for these calls. For small minibatches, one loop goes through all of
an update, and moves the weights too. The networks are those of :mod:`pearl_marl.policies.dense`.
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
from pearl_marl.compiler import barrier
from pearl_marl.compiler.barrier import arrive
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
from pearl_marl.policies.network import MASKED, PictureGradients, Pictures, is_dense, takes_planes
from pearl_marl.policies.second_thread import both
from pearl_marl.training import adam
from pearl_marl.training.actor_critic import ActorCritic
from pearl_marl.training.adam import Adam, Moves
from pearl_marl.training.halves import SECOND_THREAD, Halves
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


class Task(NamedTuple):
    """Networks that share no layers, and the samples that they learn from."""

    weights: Weights
    gradients: Weights
    actor_inputs: NetworkInputs
    critic_inputs: NetworkInputs  # a row for each state
    agents_per_state: int  # rows of samples that share one; the critic is asked once where these follow
    samples: Samples


class Loss(NamedTuple):
    """What the loss of a row depends on beside the row: settings, and statistics of the minibatch."""

    clip: float
    entropy: float
    share: float  # of a row in the loss
    mean: float  # of the advantages, and the factor that standardises them
    scale: float


@called
def _ratio(log: float, samples: Samples, row: int, loss: Loss, figures: Array) -> float:
    """Note the loss of an action; return its gradient by the logarithm of the action's probability."""
    gain = (samples.advantages[row] - loss.mean) * loss.scale
    ratio = math.exp(log - samples.log_probs[row])
    clipped = min(max(ratio, 1 - loss.clip), 1 + loss.clip) * gain
    figures[0] -= min(ratio * gain, clipped)
    figures[3] += abs(ratio - 1) > loss.clip
    # A ratio that has gone too far is not pulled further.
    return -ratio * gain if ratio * gain <= clipped else 0.0


class Scored(NamedTuple):
    """Some rows' outputs, one after the other, and memory for what is made of them."""

    outputs: Array
    stride: int  # from a row to the next
    n: int  # outputs of a row
    greatest: Array  # memory for a number of each row
    logs: Array  # memory for n numbers of each row; as has the next
    probabilities: Array


def _score(scored, samples, rows, log_deviation, loss, figures) -> Any:  # type: ignore[no-untyped-def]
    """Replace outputs by gradients; return the gradient by the logarithm of the deviation."""
    of_kind: Any = _choices if samples.actions.ndim == 1 else _numbers
    return of_kind(scored, samples, rows, log_deviation, loss, figures)


@overload(_score, jit_options=ARITHMETIC)
def _score_of(scored, samples, rows, log_deviation, loss, figures) -> Any:  # type: ignore[no-untyped-def]
    actions = samples[0]  # types of Numba, whose tuples have no names
    return _choices if actions.ndim == 1 else _numbers


def _choices(scored, samples, rows, log_deviation, loss, figures):  # type: ignore[no-untyped-def]
    """Do so where outputs are the logits of actions, of which one was chosen.

    Exponentials are found for all rows at once, by vectors.
    """
    outputs, stride, n, greatest, logs, probabilities = scored
    first, count = rows
    masks = samples.masks
    masked = len(masks) > 0
    for s in range(count):
        start, most = s * stride, _MASKED
        for k in range(n):
            if masked and masks[first + s, k] == 0:
                outputs[start + k] = _MASKED
            most = max(most, outputs[start + k])
        greatest[s] = most
        for k in range(n):
            logs[s * n + k] = outputs[start + k] - most
    for i in range(count * n):
        probabilities[i] = exponential(logs[i])
    for s in range(count):
        start, total = s * stride, _NONE
        for k in range(n):
            total += probabilities[s * n + k]
        log_total = greatest[s] + np.log(total)
        for k in range(n):
            logs[s * n + k] = outputs[start + k] - log_total
    for i in range(count * n):
        probabilities[i] = exponential(logs[i])
    for s in range(count):
        row, start, entropy = first + s, s * stride, 0.0
        for k in range(n):
            if not (masked and masks[row, k] == 0):
                entropy -= probabilities[s * n + k] * logs[s * n + k]
        figures[2] += entropy
        action = samples.actions[row]
        by = _ratio(logs[s * n + action], samples, row, loss, figures)
        for k in range(n):
            if masked and masks[row, k] == 0:
                outputs[start + k] = 0
                continue
            log, probability = logs[s * n + k], probabilities[s * n + k]
            gradient = by * ((k == action) - probability) + loss.entropy * probability * (log + entropy)
            outputs[start + k] = gradient * loss.share
    return 0.0


def _numbers(scored, samples, rows, log_deviation, loss, figures):  # type: ignore[no-untyped-def]
    """Do so where outputs are means of normal distributions, from which actions were drawn."""
    outputs, stride, n, _, _, _ = scored
    first, count = rows
    wide, by_deviation = log_deviation[0], 0.0
    spread = math.exp(wide)
    for s in range(count):
        start, actions = s * stride, samples.actions[first + s]
        log = squares = 0.0
        for k in range(n):
            deviation = (actions[k] - outputs[start + k]) / spread
            squares += deviation * deviation
            log -= 0.5 * deviation * deviation + wide + _HALF_LOG_TURN
        figures[2] += n * (0.5 + _HALF_LOG_TURN + wide)
        by = _ratio(log, samples, first + s, loss, figures)
        for k in range(n):
            outputs[start + k] = by * loss.share * (actions[k] - outputs[start + k]) / (spread * spread)
        by_deviation += loss.share * (by * (squares - n) - loss.entropy * n)
    return by_deviation


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


_loss_called: Callable[..., Loss] = called(_loss)
_move: Callable[..., None] = called(adam.adam_step)


@called
def _gathered(samples: Samples, rows: Array) -> Samples:
    """Return some rows without their columns, side by side, so that the loss does not wait for each."""
    return Samples(
        samples.actions[rows],
        samples.masks[rows] if len(samples.masks) else samples.masks,
        samples.column,
        samples.log_probs[rows],
        samples.advantages[rows],
        samples.returns[rows],
    )


@called
def _room(outputs: Array, stride: int, n: int) -> Scored:
    """Return outputs with the memory that their loss needs."""
    greatest, logs = np.empty(ROWS, np.float32), np.empty(ROWS * n, np.float32)
    return Scored(outputs, stride, n, greatest, logs, np.empty_like(logs))


@called
def _actor_gradients(task: Task, rows: Array, loss: Loss, figures: Array) -> None:
    """Compute the gradients by the actor's weights; write all of ``figures`` but the critic's loss."""
    actor, gradients, deviation = task.weights.actor, task.gradients.actor, task.weights.log_deviation
    by_padded, tile, sums = padded(actor), tile_of(actor), gradient_sums(gradients)
    n, out, taken = len(actor.bias3), len(by_padded.bias3), _gathered(task.samples, rows)
    score, by_deviation = _room(tile.outputs, out, n), 0.0
    for first in range(0, len(rows), ROWS):
        some = rows[first : first + ROWS]
        forward_rows(actor, by_padded, task.actor_inputs, some, tile)
        for s in range(ROWS):
            for k in range(n if s < len(some) else 0, out):
                tile.outputs[s * out + k] = 0
        by_deviation += _score(score, taken, (first, len(some)), deviation, loss, figures)
        backward_rows(actor, by_padded, task.actor_inputs, some, tile, sums, gradients)
    store_gradients(sums, gradients)
    if len(deviation):
        task.gradients.log_deviation[0] = by_deviation


@called
def _critic_gradients(task: Task, rows: Array, share: float, figures: Array) -> None:
    """Compute the gradients by the critic's weights; write the critic's loss."""
    critic, gradients, samples = task.weights.critic, task.gradients.critic, task.samples
    by_padded, tile, sums = padded(critic), tile_of(critic), gradient_sums(gradients)
    out, outputs, returns = len(by_padded.bias3), tile.outputs, samples.returns[rows]
    column = samples.column[rows] if len(samples.column) else samples.column
    asked, answer, errors = np.empty(ROWS, np.int64), np.empty(ROWS, np.int64), np.empty(ROWS, np.float32)
    for first in range(0, len(rows), ROWS):
        some, n_asked = rows[first : first + ROWS], 0
        for s in range(len(some)):
            state = some[s] // task.agents_per_state
            if n_asked == 0 or asked[n_asked - 1] != state:
                asked[n_asked] = state
                n_asked += 1
            answer[s] = (n_asked - 1) * out
            if len(column):
                answer[s] += column[first + s]
        of_critic = asked[:n_asked]
        forward_rows(critic, by_padded, task.critic_inputs, of_critic, tile)
        for s in range(len(some)):
            errors[s] = outputs[answer[s]] - returns[first + s]
            figures[1] += errors[s] * errors[s]
        outputs[:] = 0
        for s in range(len(some)):
            outputs[answer[s]] += errors[s] * share
        backward_rows(critic, by_padded, task.critic_inputs, of_critic, tile, sums, gradients)
    store_gradients(sums, gradients)


def _gradients(task: Task, rows: Array, loss: Loss, figures: Array) -> None:
    """Compute the gradients of the loss of some rows of a minibatch.

    Into ``figures``, shape (4,), go the loss of the policy, that of the critic, the entropy, and the share of
    ratios that were clipped.
    """
    figures[:] = 0
    _actor_gradients(task, rows, loss, figures)
    _critic_gradients(task, rows, loss.share, figures)
    figures *= loss.share


ACTOR, CRITIC, BOTH = 0, 1, 2
"""Which network a thread learns."""


def _descend(
    network: int,
    task: Task,
    rows: Array,
    edges: Array,
    clip: float,
    entropy: float,
    moves: Moves,
    figures: Array,
    shared: Array,
) -> None:
    """Learn from minibatches, one after the other: from ``rows`` between two neighbours of ``edges``.

    ``network`` says which network this thread learns: :data:`ACTOR`, :data:`CRITIC` or :data:`BOTH`. Two
    threads meet at the barrier of ``shared``, and that of the critic moves the weights of both. ``figures``,
    shape (2, minibatches, 4), are zeros; losses of the actor go into the first half, of the critic into the
    second.
    """
    state = moves.values, moves.gradient, moves.mean, moves.square
    for k in range(len(moves.rates)):
        some = rows[edges[k] : edges[k + 1]]
        if network != CRITIC:
            loss, mine = _loss_called(task.samples.advantages, some, clip, entropy), figures[ACTOR, k]
            _actor_gradients(task, some, loss, mine)
            mine *= loss.share
        if network != ACTOR:
            _critic_gradients(task, some, 1 / len(some), figures[CRITIC, k])
            figures[CRITIC, k] *= 1 / len(some)
        if network != BOTH and not arrive(shared, network, 2 * k + 1):
            return
        if network != ACTOR:
            _move(*state, moves.rates[k, 0], moves.rates[k, 1], moves.epsilon, moves.max_grad_norm)
        if network != BOTH and not arrive(shared, network, 2 * k + 2):
            return


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
    taken, score = _gathered(samples, rows), _room(outputs, out, critic)
    figures[:] = 0
    for first in range(0, n, ROWS):
        some = rows[first : first + ROWS]
        forward_rows(layers, weights, inputs, some, tile)
        for s in range(len(some)):
            row, start = first + s, s * out
            error = outputs[start + critic] - taken.returns[row]
            figures[1] += error * error
            outputs[start + critic] = error * loss.share
            outputs[start + critic + 1 : start + out] = 0
        _score(score, taken, (first, len(some)), none, loss, figures)
        outputs[len(some) * out :] = 0
        backward_rows(layers, weights, inputs, some, tile, total, gradients)
    store_gradients(total, gradients)
    figures *= loss.share


_loss_of = compiled_loop(_loss, fused=True)
_descend_of = compiled_loop(_descend, dense, adam, barrier, fused=True)
_gradients_of = compiled_loop(_gradients, dense, fused=True)
_shared_gradients_of = compiled_loop(_shared_gradients, dense, fused=True)


def fits(model: ActorCritic) -> bool:
    """Return whether these loops can learn a model's networks."""
    if model.shared:
        return takes_planes(model.actor) and not model.policy.heads and not model.continuous
    return is_dense(model.actor) and is_dense(model.critic) and not model.policy.heads


def in_one_loop(model: ActorCritic, minibatch: int) -> bool:
    """Return whether :func:`descend` learns a model by minibatches of so many rows."""
    return fits(model) and not model.shared and minibatch * model.policy.about["width"] < SECOND_THREAD


def _samples_of(model: ActorCritic, rollout: RolloutBuffer) -> Samples:
    """Return a rollout's samples, for a model."""
    inputs, column = rollout.inputs, np.empty(0, np.int64)
    if model.central and inputs.position is not None:
        column = inputs.position.contiguous().numpy()
    masks = inputs.masks
    return Samples(
        rollout.actions.contiguous().numpy(),
        np.zeros((0, model.policy.outputs), np.int8) if masks is None else masks.numpy(),
        column,
        *(part.contiguous().numpy() for part in (rollout.log_probs, rollout.advantages, rollout.returns)),
    )


class PPOGradients:
    """Finds gradients for minibatches of a rollout, whose steps and agents are one axis.

    Called with the rows of a minibatch, it leaves the gradients with the model's parameters, and returns what
    ``PPO.autograd`` returns.
    """

    def __init__(self, model: ActorCritic, rollout: RolloutBuffer, clip: float, entropy: float) -> None:
        self._clip, self._entropy, self._samples = clip, entropy, _samples_of(model, rollout)
        kind = _SharedLayers if model.shared else _SeparateLayers
        self._loops: _SharedLayers | _SeparateLayers = kind(model, rollout, self._samples)
        self._halves = Halves(model, model.policy.about["width"], self._loops.gradients)

    def __call__(self, rows: Tensor) -> Tensor:
        """Find the gradients of some rows."""
        numbers = rows.numpy()
        loss = _loss_of()(self._samples.advantages, numbers, self._clip, self._entropy)
        return self._halves.find(numbers, partial(self._loops, loss))


def descend(
    model: ActorCritic,
    rollout: RolloutBuffer,
    minibatches: Sequence[Tensor],
    optimiser: Adam,
    rate: float,
    settings: Any,
    threads: int,
) -> Tensor:
    """Learn from minibatches one after the other, in one compiled loop; return the losses of each.

    Of several threads, one finds the gradients of the actor and another those of the critic, which share no
    layers. The result is that of :class:`PPOGradients`, bit by bit, where minibatches are not halved.
    """
    loops = _SeparateLayers(model, rollout, _samples_of(model, rollout))
    rows = torch.cat(list(minibatches)).numpy()
    edges = np.cumsum([0, *map(len, minibatches)])
    moves = optimiser.steps_by_others(rate, len(minibatches))
    figures, shared = np.zeros((2, len(minibatches), 4)), barrier.arrivals()
    parameters: Any = optimiser.parameters
    task = loops.task(loops.gradients({parameter: parameter.grad for parameter in parameters}))

    def learn(network: int) -> None:
        with barrier.released_by_errors(shared):
            _descend_of()(network, task, rows, edges, settings.clip, settings.entropy, moves, figures, shared)

    if threads > 1:
        with barrier.released_by_errors(shared):
            both(partial(learn, ACTOR), partial(learn, CRITIC))
    else:
        learn(BOTH)
    return torch.from_numpy(figures.sum(0))


class _SeparateLayers:
    """Finds those of a part of a minibatch, where actor and critic share nothing."""

    def __init__(self, model: ActorCritic, rollout: RolloutBuffer, samples: Samples) -> None:
        self._model, self._samples = model, samples
        self._weights = self.gradients(None)
        inputs = rollout.inputs
        critic_obs, critic_position = inputs.obs, inputs.position
        if model.central:
            assert inputs.state is not None
            critic_obs, critic_position = inputs.state[:: model.agents_per_state], None
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
        _gradients_of()(self.task(gradients), rows, loss, figures)
        return figures

    def task(self, gradients: Weights) -> Task:
        """Return what compiled loops are given to write these gradients."""
        return Task(self._weights, gradients, *self._inputs, self._model.agents_per_state, self._samples)


class _SharedLayers:
    """Finds those of a part of a minibatch of pictures, where both share all layers but the last."""

    def __init__(self, model: ActorCritic, rollout: RolloutBuffer, samples: Samples) -> None:
        self._samples, actor, critic = samples, model.actor.output, model.critic
        # Of the actor's last layer and the critic's, the weights and the biases.
        self._heads = [[actor.weight, critic.weight], [actor.bias, critic.bias]]
        self._pictures = Pictures(model.actor, rollout.inputs.obs, rollout.inputs.position)

    def gradients(self, instead: Mapping[Tensor, Tensor]) -> tuple[PictureGradients, list[list[Tensor]]]:
        """Return where gradients by the network and by the heads go: to what stands for the weights."""
        heads = [[instead[weight] for weight in head] for head in self._heads]
        return self._pictures.gradients(instead), heads

    def __call__(
        self, loss: Loss, rows: Array, gradients: tuple[PictureGradients, list[list[Tensor]]]
    ) -> Array:
        """Write the gradients; return the losses."""
        by_network, into_heads = gradients
        heads, figures = [torch.cat(head).detach() for head in self._heads], np.empty(4)
        by_heads = [torch.empty_like(head) for head in heads]
        with self._pictures.first_layer(rows, by_network) as layers:
            # Their last layer has both heads.
            weights, by_weights = (
                some._replace(third=weight.numpy(), bias3=bias.numpy())
                for some, (weight, bias) in zip(layers, (heads, by_heads), strict=True)
            )
            inputs = self._pictures.inputs
            _shared_gradients_of()(weights, by_weights, inputs, self._samples, rows, loss, figures)
        for found, by in zip(into_heads, by_heads, strict=True):
            torch.split_with_sizes_copy(by, [len(some) for some in found], out=found)
        return figures
