"""From a trained policy to one in integers: weights of a few bits, and tables between layers."""

from __future__ import annotations

import math

import numpy as np
import torch

from pearl_marl.base.arrays import Array
from pearl_marl.checks import checked_integer
from pearl_marl.errors import ArgumentError
from pearl_marl.policies import dense
from pearl_marl.policies.integer_network import (
    ENTRIES,
    HALF,
    AgentNetworks,
    Dense,
    Head,
    IntegerNetwork,
    Levels,
    Patches,
    Rows,
    Scaling,
    no_planes,
    table_network,
)
from pearl_marl.policies.network import Network, SeparateNetworks
from pearl_marl.policies.trained import NetworkPolicy, TabularPolicy

INPUT_STEPS = 128
"""Inputs that are standardised are counted in parts of a standard deviation: so many."""

ACTIVATION_STEPS = 128
"""Entries of a table of hyperbolic tangents for each unit: it reaches from -4 to 4, where 0.07 % are left."""

PICTURE_FRACTION = 8
"""Bits behind the binary point that elements of planes of floats keep."""

MULTIPLIER_BITS = 15

FARTHEST_CHANCE = 12.0
"""How many times ``e`` an action is less likely than the best when it gets the last, and least, weight."""

BITS = 4, 16
"""Possible widths of weights and activations, sign included."""


def quantized(
    policy: NetworkPolicy | TabularPolicy, observations: Array, weight_bits: int = 8, activation_bits: int = 8
) -> IntegerNetwork | AgentNetworks:
    """Return a policy in integers that does what a trained one does, as nearly as its bits allow.

    Parameters
    ----------
    policy
        What was trained. One that draws its actions is drawn from here too; one that takes a share of random
        actions takes the best only.
    observations
        Some that it meets, of shape ``(n, *spec.observation_shape)`` and of whole worlds: the range of what
        pictures become follows from them.
    weight_bits, activation_bits
        Widths of weights, and of what goes from one layer to the next, 4 to 16.

    Raises
    ------
    ArgumentError
        The widths are impossible, the policy has a memory, its layers are standardised, or its observations
        are planes of numbers below 0 or without a bound.
    """
    checked_integer("weight_bits", weight_bits, *BITS)
    checked_integer("activation_bits", activation_bits, *BITS)
    check_quantizable(policy)
    if isinstance(policy, TabularPolicy):
        ranks = np.stack([np.unique(row, return_inverse=True)[1] for row in policy.values[0].numpy()])
        return table_network(policy.spec, ranks)
    most_weight, most = ((1 << bits - 1) - 1 for bits in (weight_bits, activation_bits))
    separate = isinstance(policy.network, SeparateNetworks)
    each = policy.network if separate else [policy.network]
    made = tuple(
        _Quantizing(policy, own, observations[k :: len(each)], most_weight, most).network()
        for k, own in enumerate(each)
    )
    return AgentNetworks(made) if separate else made[0]


def check_quantizable(policy: NetworkPolicy | TabularPolicy) -> None:
    """Refuse a policy that :func:`quantized` cannot make one in integers of, whatever it meets."""
    if isinstance(policy, TabularPolicy):
        if len(policy.values) != 1:
            raise ArgumentError(
                f"the policy has {len(policy.values)} tables, a learner each: take one of them"
            )
        return
    network = policy.network
    if isinstance(network, SeparateNetworks):
        network = network[0]  # the others are like it
    if network.memory is not None:
        raise ArgumentError("the policy has a memory, for which integers have no layer: train it without")
    if network.layer_norm:
        raise ArgumentError(
            "the policy's layers are standardised, for which integers have no layer: train it by ppo or dqn"
        )
    if network.encoder.kind == "picture" and (why := no_planes(policy.spec)):
        raise ArgumentError(f"the policy cannot become one in integers: {why}")


class _Quantizing:
    """A network on its way to integers.

    ``scale`` is what a real number is multiplied by, where the layers have come to.
    """

    def __init__(
        self, policy: NetworkPolicy, network: Network, observations: Array, most_weight: int, most: int
    ) -> None:
        self.policy, self.spec, self.float = policy, policy.spec, network
        self.observations = torch.from_numpy(np.ascontiguousarray(observations))
        self.most_weight, self.most = most_weight, most

    @torch.no_grad()
    def network(self) -> IntegerNetwork:
        """Return the network in integers."""
        float_, encoder = self.float, self.float.encoder
        inputs: Scaling | Rows | Patches
        relu = encoder.kind == "picture"
        indicator = np.zeros((0, float_.hidden.in_features))
        if float_.indicator is not None:
            indicator = float_.indicator.weight.numpy()
        if encoder.kind == "numbers":
            table = encoder.table.weight.numpy()
            scale = self.most_weight / _greatest(table, indicator)
            elements = len(encoder.offsets)
            rows = np.rint(table * scale).astype(np.int32)
            inputs = Rows(encoder.offsets.numpy().astype(np.int64), np.eye(elements, dtype=np.int64), rows)
            first = np.zeros((float_.hidden.in_features, 0), np.int16), encoder.bias.numpy()
        elif relu:
            inputs, input_scale = self._patches()
            first, scale = self._weights(encoder.linear, input_scale)
        else:
            inputs, rest = self._scaling()
            (weights, bias), scale = self._weights(encoder.linear, float(INPUT_STEPS), tanh=True)
            first = weights, bias + encoder.linear.weight.double().numpy() @ rest
        layers, added = [], np.rint(indicator * scale).astype(np.int32)
        hidden = self._hidden() if relu else [None, None]
        weights, bias = first
        for k, following in enumerate((float_.hidden, float_.output)):
            layer, made = self._activated(weights, bias, scale, hidden[k])
            layers.append(layer)
            last = following is float_.output
            (weights, bias), scale = self._weights(following, made, tanh=not relu and not last)
        layers.append(Dense(weights, np.rint(bias * scale).astype(np.int32)))
        return IntegerNetwork(self.spec, inputs, added, tuple(layers), self._head(scale))

    def _weights(
        self, layer: torch.nn.Linear, input_scale: float, tanh: bool = False
    ) -> tuple[tuple[Array, Array], float]:
        """Return a layer's weights in integers, and its biases as they are; and the scale of its sums.

        In front of a table of hyperbolic tangents, sums get a scale that shifting makes that of the table, if
        the weights are large enough. Then all layers have the same table, and hardware needs only one.
        """
        weights = layer.weight.numpy()
        scale = self.most_weight / _greatest(weights)
        if tanh and scale * input_scale >= ACTIVATION_STEPS:
            steps = ACTIVATION_STEPS / input_scale
            scale = steps * 2.0 ** math.floor(math.log2(scale / steps))
        return (np.rint(weights * scale).astype(np.int16), layer.bias.numpy()), scale * input_scale

    def _activated(
        self, weights: Array, bias: Array, scale: float, reached: float | None
    ) -> tuple[Dense, float]:
        """Return a layer with what its sums become, and the scale of that."""
        sums = np.rint(bias * scale).astype(np.int32)
        if reached is None:
            shift = max(0, round(math.log2(scale / ACTIVATION_STEPS)))
            middles = (np.arange(ENTRIES) - HALF + 0.5) * 2.0**shift / scale
            table = np.rint(self.most * np.tanh(middles)).astype(np.int16)
            return Dense(weights, sums, shift, table), float(self.most)
        shift = max(0, math.ceil(math.log2(reached * scale / self.most)))
        return Dense(weights, sums, shift, limit=self.most), scale / 2**shift

    def _scaling(self) -> tuple[Scaling, Array]:
        """Return how vectors are standardised, and what each is above that then, in standard deviations.

        Elements that are small integers are no nearer to their mean than to an integer beside it.
        """
        mean, factor = (tensor.double().numpy() for tensor in self.float.encoder.statistics())
        fractions = np.array(self.spec.element_fractions, np.float64)
        per_element = factor * 2.0**-fractions * INPUT_STEPS
        shift = np.clip(MULTIPLIER_BITS - 1 - np.floor(np.log2(per_element)), 0, 62).astype(np.int64)
        multiplier = np.minimum(np.rint(per_element * 2.0**shift), (1 << 31) - 1).astype(np.int64)
        offset = np.rint(mean * 2.0**fractions).astype(np.int64)
        # Shifting rounds down, by half a step on average.
        rest = ((offset - mean * 2.0**fractions) * per_element + 0.5) / INPUT_STEPS
        scaling = Scaling(offset, multiplier, shift, dense.FARTHEST * INPUT_STEPS)
        return scaling, rest.clip(-dense.FARTHEST, dense.FARTHEST)

    def _patches(self) -> tuple[Patches, float]:
        """Return what pictures go through first, and the scale of what comes of it."""
        convolution = self.float.encoder.convolution
        weights, bias, *_ = (tensor.numpy() for tensor in self.float.encoder.picture_weights())
        fraction = max(self.spec.element_fractions)
        element_shift = max(0, fraction - PICTURE_FRACTION)
        of_weights = self.most_weight / _greatest(weights)
        scale = of_weights * 2.0 ** (fraction - element_shift)
        planes = self.float.encoder.whole(self.observations).permute(0, 3, 1, 2).float()
        reached = _reached(convolution(planes))
        shift = max(0, math.ceil(math.log2(reached * scale / self.most)))
        rows, columns, count = self.spec.observation_shape
        patches = Patches(
            (rows, columns, count),
            np.rint(weights.transpose(0, 2, 3, 1) * of_weights).astype(np.int16),
            np.rint(bias * scale).astype(np.int32),
            shift,
            self.most,
            element_shift,
        )
        return patches, scale / 2**shift

    def _hidden(self) -> list[float | None]:
        """Return how far the sums of both hidden layers reach above 0."""
        first = self.float.encoder(self.observations)
        if self.float.indicator is not None:
            first = first + self.float.indicator(self.policy.positions(len(self.observations)))
        return [_reached(first), _reached(self.float.hidden(torch.relu(first)))]

    def _head(self, scale: float) -> Head | Levels:
        """Return how the last sums, of this scale, become actions."""
        policy, spec = self.policy, self.spec
        if policy.about["kind"] == "mean":
            fields = spec.action_fields
            size = np.array([2.0**field.fraction for field in fields])
            middle = (policy.low + policy.high).double().numpy().ravel() / 2 * size
            per_sum = policy.bound.double().numpy().ravel() * size / scale
            shift = max(0, int(30 - math.ceil(math.log2(per_sum.max()))))
            low, high = (
                np.rint(end.double().numpy().ravel() * size).astype(np.int64)
                for end in (policy.low, policy.high)
            )
            return Levels(
                np.rint(per_sum * 2.0**shift).astype(np.int64),
                np.rint(middle * 2.0**shift).astype(np.int64),
                shift,
                low,
                high,
            )
        if policy.about["kind"] != "logits" or not policy.temperature:
            return Head(spec.action_counts)
        per_sum = 1 / (scale * policy.temperature)
        shift = max(0, math.ceil(math.log2(FARTHEST_CHANCE / per_sum / ENTRIES)))
        distances = np.arange(ENTRIES) * 2.0**shift * per_sum
        return Head(spec.action_counts, shift, np.rint(65535 * np.exp(-distances)).astype(np.int32))


def _greatest(*arrays: Array) -> float:
    """Return the greatest size of a number in some arrays, or 1 where all are 0."""
    return max(float(np.abs(array).max(initial=0)) for array in arrays) or 1.0


def _reached(sums: torch.Tensor) -> float:
    """Return how far sums go above 0, but for one in a thousand."""
    above = sums.clamp(min=0).double().flatten().numpy()
    return max(float(np.quantile(above, 0.999)), 1e-3)
