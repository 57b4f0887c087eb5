"""What PPO learns from a minibatch, compiled: the gradients by all weights, in one pass over the rows.

For networks that :mod:`pearl_marl.policies.dense` can do. It does what PPO's own operations of PyTorch do, of
which there are a hundred for each minibatch, and small networks would wait for their calls.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from numba.extending import overload
from torch import Tensor

from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.policies import dense
from pearl_marl.policies.dense import (
    ARITHMETIC,
    ROWS,
    Given,
    Layers,
    ahead,
    back,
    called,
    exponential,
    given_back,
    padded,
    sums,
    tile,
)
from pearl_marl.policies.network import MASKED, is_dense
from pearl_marl.training.actor_critic import ActorCritic, View

Array = npt.NDArray[Any]

_MASKED, _ONE, _NONE = np.float32(MASKED), np.float32(1), np.float32(0)
_HALF_LOG_TURN = 0.5 * math.log(2 * math.pi)


class Samples(NamedTuple):
    """What is learned from, a row each."""

    actions: Array  # int64 numbers, or float32, (n, outputs)
    masks: Array  # (n, outputs), 0 for what was not allowed; or (0, 0)
    column: Array  # which output of the critic is the agent's; or empty, for the first
    logs: Array  # of the actions' probabilities, as they were
    advantages: Array
    returns: Array


class Weights(NamedTuple):
    """Those of a model, or gradients by them."""

    actor: Layers
    critic: Layers
    log_deviation: Array  # of continuous actions; else empty


class Batch(NamedTuple):
    """What the loss of a row depends on beside the row: settings, and what all rows together are."""

    clip: float
    entropy: float
    share: float  # of a row in the loss
    mean: float  # of the advantages, and the factor that standardises them
    scale: float


def _ratio(log: float, samples: Samples, row: int, batch: Batch, found: Array) -> float:
    """Note the loss of an action; return its gradient by the logarithm of the action's probability."""
    gain = (samples.advantages[row] - batch.mean) * batch.scale
    ratio = math.exp(log - samples.logs[row])
    clipped = min(max(ratio, 1 - batch.clip), 1 + batch.clip) * gain
    found[0] -= min(ratio * gain, clipped)
    found[3] += abs(ratio - 1) > batch.clip
    # A ratio that has gone too far is not pulled further.
    return -ratio * gain if ratio * gain <= clipped else 0.0


_ratio_of: Callable[..., float] = called(_ratio)

At = tuple[int, int]
"""Where a row's outputs begin, and how many they are."""


def _score(made, at, samples, row, log_deviation, batch, found) -> Any:  # type: ignore[no-untyped-def]
    """Put gradients in the place of a row's outputs; return that by the logarithm of the deviation."""
    of_kind: Any = _choice if samples.actions.ndim == 1 else _numbers
    return of_kind(made, at, samples, row, log_deviation, batch, found)


@overload(_score, jit_options=ARITHMETIC)
def _score_of(made, at, samples, row, log_deviation, batch, found) -> Any:  # type: ignore[no-untyped-def]
    actions = samples[0]  # types here, of which a tuple's have no names
    return _choice if actions.ndim == 1 else _numbers


def _choice(made, at, samples, row, log_deviation, batch, found):  # type: ignore[no-untyped-def]
    """Of outputs that are the logits of actions, of which one was chosen."""
    start, n = at
    masks, action = samples.masks, samples.actions[row]
    masked = len(masks) > 0
    most = _MASKED
    for k in range(n):
        if masked and masks[row, k] == 0:
            made[start + k] = _MASKED
        most = max(most, made[start + k])
    total = _NONE
    for k in range(n):
        total += exponential(made[start + k] - most)
    log_total = most + np.log(total)
    entropy = 0.0
    for k in range(n):
        if not (masked and masks[row, k] == 0):
            log = made[start + k] - log_total
            entropy -= exponential(log) * log
    found[2] += entropy
    by = _ratio_of(made[start + action] - log_total, samples, row, batch, found)
    for k in range(n):
        if masked and masks[row, k] == 0:
            made[start + k] = 0
            continue
        log = made[start + k] - log_total
        probability = exponential(log)
        gradient = by * ((k == action) - probability) + batch.entropy * probability * (log + entropy)
        made[start + k] = gradient * batch.share
    return 0.0


def _numbers(made, at, samples, row, log_deviation, batch, found):  # type: ignore[no-untyped-def]
    """Of outputs that are means, from which actions were drawn by a normal distribution."""
    start, n = at
    actions, wide = samples.actions[row], log_deviation[0]
    spread, log, squares = math.exp(wide), 0.0, 0.0
    for k in range(n):
        apart = (actions[k] - made[start + k]) / spread
        squares += apart * apart
        log -= 0.5 * apart * apart + wide + _HALF_LOG_TURN
    found[2] += n * (0.5 + _HALF_LOG_TURN + wide)
    by = _ratio_of(log, samples, row, batch, found)
    for k in range(n):
        made[start + k] = by * batch.share * (actions[k] - made[start + k]) / (spread * spread)
    return batch.share * (by * (squares - n) - batch.entropy * n)


def _batch(advantages: Array, rows: Array, clip: float, entropy: float) -> Batch:
    """Return what a minibatch of these rows is."""
    n = len(rows)
    mean = squares = 0.0
    for row in rows:
        mean += advantages[row] / n
    if n == 1:  # one alone has no deviation
        return Batch(clip, entropy, 1.0, 0.0, 1.0)
    for row in rows:
        squares += (advantages[row] - mean) ** 2
    return Batch(clip, entropy, 1 / n, mean, 1 / (math.sqrt(squares / (n - 1)) + 1e-8))


def _learn(
    weights: Weights,
    gradients: Weights,
    seen: Given,
    judged: Given,
    samples: Samples,
    rows: Array,
    batch: Batch,
    found: Array,
) -> None:
    """Compute the gradients of the loss of some rows of a minibatch.

    ``seen`` is what the policy was given, ``judged`` the critic. Into ``found``, shape (4,), go the loss of
    the policy, that of the critic, the entropy, and the share of ratios that were clipped.
    """
    n, share = len(rows), batch.share
    actor, critic, log_deviation = weights
    actor_weights, critic_weights = padded(actor), padded(critic)
    actor_room, critic_room = tile(actor), tile(critic)
    actor_sums, critic_sums = sums(gradients.actor), sums(gradients.critic)
    outputs, out, out_critic = len(actor.bias3), len(actor_weights.bias3), len(critic_weights.bias3)
    by_deviation = 0.0
    found[:] = 0
    for first in range(0, n, ROWS):
        some = rows[first : first + ROWS]
        ahead(actor, actor_weights, seen, some, actor_room)
        made = actor_room.outputs
        for s in range(ROWS):
            for k in range(outputs if s < len(some) else 0, out):
                made[s * out + k] = 0
        for s in range(len(some)):
            row, at = some[s], (s * out, outputs)
            by_deviation += _score(made, at, samples, row, log_deviation, batch, found)
        back(actor, actor_weights, seen, some, actor_room, actor_sums, gradients.actor)
        ahead(critic, critic_weights, judged, some, critic_room)
        made = critic_room.outputs
        for s in range(len(some)):
            row = some[s]
            column = samples.column[row] if len(samples.column) else 0
            apart = made[s * out_critic + column] - samples.returns[row]
            found[1] += apart * apart
            for k in range(out_critic):
                made[s * out_critic + k] = 0
            made[s * out_critic + column] = apart * share
        made[len(some) * out_critic :] = 0
        back(critic, critic_weights, judged, some, critic_room, critic_sums, gradients.critic)
    given_back(actor_sums, gradients.actor)
    given_back(critic_sums, gradients.critic)
    if len(gradients.log_deviation):
        gradients.log_deviation[0] = by_deviation
    for k in range(4):
        found[k] *= share


_batch_of = compiled_loop(_batch)
_learn_some = compiled_loop(_learn, dense)

WORTH = 1 << 16
"""Rows times width of a minibatch from which on a second thread does half of it."""


def fits(model: ActorCritic) -> bool:
    """Return whether a model's networks are such as can be learned here."""
    return is_dense(model.policy.network) and is_dense(model.critic) and not model.policy.heads


class Learning:
    """Learns a model from some experience, a row a sample: call it with the rows of a minibatch.

    It leaves gradients with the parameters, and returns what ``_learn`` has found. How many threads there are
    changes nothing: who has a minibatch large enough adds up its halves.
    """

    def __init__(
        self, model: ActorCritic, view: View, parts: list[Tensor], clip: float, entropy: float
    ) -> None:
        policy: Any = model.policy
        actions, logs, advantages, returns = (part.contiguous().numpy() for part in parts)
        masks = np.zeros((0, policy.outputs), np.int8) if view.masks is None else view.masks.numpy()
        column = np.empty(0, np.int64)
        seen: Any = view.obs
        whose = view.position
        if model.central:
            seen, whose = view.state, None
            if view.position is not None:
                column = view.position.contiguous().numpy()
        self._given = policy.network.given(view.obs, view.position), model.critic.given(seen, whose)
        self._samples = Samples(actions, masks, column, logs, advantages, returns)
        self._clip, self._entropy = clip, entropy
        self._model, self._width = model, policy.about["width"]
        self._gradients: Any = [parameter.grad for parameter in model.parameters()]
        self._others: Any = [torch.empty_like(parameter) for parameter in model.parameters()]
        others = dict(zip(model.parameters(), self._others, strict=True))
        self._weights = self._of(lambda parameter: parameter)
        self._halves = self._of(lambda parameter: parameter.grad), self._of(others.__getitem__)
        self._helper = ThreadPoolExecutor(1)

    def _of(self, part: Callable[[Any], Any]) -> Weights:
        """Return what belongs to each of the weights, as compiled loops take it."""
        model: Any = self._model
        deviation = part(model.log_deviation) if model.continuous else torch.empty(0)
        layers = model.policy.network.layers(part), model.critic.layers(part)
        return Weights(*layers, deviation.detach().numpy())

    def __call__(self, rows: Tensor) -> Tensor:
        """Learn from some rows."""
        given = rows.numpy()
        batch = _batch_of(self._samples.advantages, given, self._clip, self._entropy)
        if len(given) * self._width < WORTH:
            return torch.from_numpy(self._half(given, batch, self._halves[0]))
        middle = len(given) // 2
        second = self._helper.submit(self._half, given[middle:], batch, self._halves[1])
        found = self._half(given[:middle], batch, self._halves[0]) + second.result()
        for gradient, other in zip(self._gradients, self._others, strict=True):
            gradient += other
        return torch.from_numpy(found)

    def _half(self, rows: Array, batch: Batch, gradients: Weights) -> Array:
        found = np.empty(4)
        _learn_some(self._weights, gradients, *self._given, self._samples, rows, batch, found)
        return found
