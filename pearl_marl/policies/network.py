"""The network that the trainers learn: observations of any environment in, numbers for actions out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium.spaces import Box, Space
from torch import Tensor, nn
from torch.nn.functional import layer_norm

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.packing import unpacked
from pearl_marl.errors import ArgumentError
from pearl_marl.policies import dense
from pearl_marl.policies.convolution import (
    SIDE,
    SPARE,
    Planes,
    PlanesLayer,
    are_planes,
    elements_of,
    room_for,
)
from pearl_marl.policies.convolution_vectors import FILTERS
from pearl_marl.policies.memory import Memory, Recall
from pearl_marl.policies.second_thread import over_rows
from pearl_marl.spec import EnvSpec
from pearl_marl.spec.elements import are_numbers, bounds

_EMPTY = torch.empty(0, 1)

SEEN_NUMBERS = 1 << 17
"""Numbers that go into the statistics at a time on a CPU, so that they stay in a cache."""

SHARED_ROWS = 2048
"""A second thread helps if each thread has at least so many rows."""

SHARING = ("all", "indicator", "none")
"""Whether the agents of a world share a network: see :class:`NetworkPolicy`."""

MASKED = torch.finfo(torch.float32).min
"""The output of a masked action. Minus infinity would do for its probability, but makes the entropy NaN.
Where all actions are masked, all are equally likely, and the first is the best."""


def masked(outputs: Tensor, masks: Tensor | None) -> Tensor:
    """Return outputs, shape ``(..., actions)``, with :data:`MASKED` where ``masks`` are 0."""
    return outputs if masks is None else outputs.masked_fill(masks == 0, MASKED)


def most(outputs: Tensor, heads: Sequence[int]) -> Tensor:
    """Return the numbers of the greatest outputs: ``int64``, one for each field of an action.

    ``heads`` says how many outputs each field has; without any, an action is one number.
    """
    if not heads:
        return outputs.argmax(-1)
    return torch.stack([field.argmax(-1) for field in torch.split(outputs, list(heads), -1)], -1)


class _Dense(torch.autograd.Function):
    """The outputs of a :class:`Network` by compiled loops, which also find the gradients."""

    @staticmethod
    def forward(ctx: Any, network: Network, observed: dense.NetworkInputs, *_: Tensor) -> Tensor:
        """Return the outputs; the other arguments are the network's parameters."""
        ctx.network, ctx.observed = network, observed
        return network.dense_outputs(observed)

    @staticmethod
    def backward(ctx: Any, by_outputs: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients by the parameters."""
        found = {parameter: torch.empty_like(parameter) for parameter in ctx.network.parameters()}
        weights, gradients = ctx.network.layers(), ctx.network.layers(found)
        dense.backward()(weights, ctx.observed, by_outputs.contiguous().numpy(), gradients)
        return None, None, *found.values()


class Encoder(nn.Module):
    """The first layer: makes ``width`` features of an observation, whatever its space.

    Numbers (``Discrete``, a ``Tuple`` of it, ``MultiDiscrete``, ``MultiBinary``) choose rows of a table,
    which is what a linear layer over their one-hot form computes. Vectors are standardised by the statistics
    of all observations in training, then go through a linear layer. Pictures (``Box`` of three axes,
    channels last) go through a convolution, as in MinAtar's DQN. Observations that the environment ``packs``
    may be given packed.
    """

    offsets: Tensor
    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, space: Space[Any], width: int, packs: EnvSpec | None = None) -> None:
        super().__init__()
        self.packs = packs
        self.kind = "vector"
        if are_numbers(space):
            self.kind = "numbers"
            low, high = (end.ravel().astype(np.int64) for end in bounds(space))
            sizes = (high - low + 1).tolist()
            offsets = np.cumsum([0, *sizes[:-1]]) - low
            self.register_buffer("offsets", torch.from_numpy(offsets))
            self.table = nn.Embedding(sum(sizes), width)
            nn.init.normal_(self.table.weight, std=1.0)
            self.bias = nn.Parameter(torch.zeros(width))
            return
        if not isinstance(space, Box):
            raise ArgumentError(f"no network is known for observations in {space}")
        if len(space.shape) == 3:
            self.kind = "picture"
            height, breadth, channels = space.shape
            if min(height, breadth) < SIDE:
                raise ArgumentError(
                    f"pictures of {height} by {breadth} are too small for filters of {SIDE} by {SIDE}: "
                    "declare observations of one axis, or wrap the environment in flatten_v0"
                )
            self.shape, self.planes = space.shape, are_planes(space)
            self.convolution = nn.Conv2d(channels, FILTERS, SIDE)
            self.linear = nn.Linear(FILTERS * (height - 2) * (breadth - 2), width)
            return
        size = int(np.prod(space.shape))
        self.linear = nn.Linear(size, width)
        nn.init.orthogonal_(self.linear.weight, 2**0.5)
        nn.init.zeros_(self.linear.bias)
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(size, dtype=torch.float64))
        self.register_buffer("count", torch.tensor(1e-4, dtype=torch.float64))

    @torch.no_grad()
    def see(self, obs: Tensor) -> None:
        """Take a batch of observations into the statistics."""
        if self.kind != "vector" or not len(obs):
            return
        size = self.mean.numel()
        at_a_time = len(obs) if obs.is_cuda else max(SEEN_NUMBERS // size, 1)
        for some in torch.split(self.whole(obs).reshape(len(obs), size), at_a_time):
            rows = some.to(torch.float64, copy=True)
            mean = rows.mean(0)
            total, shift = self.count + len(rows), mean - self.mean
            squares = self.variance * self.count + rows.sub_(mean).square_().sum(0)
            squares += shift**2 * self.count * len(rows) / total
            self.mean += shift * len(rows) / total
            self.variance.copy_(squares / total)
            self.count.copy_(total)

    def whole(self, obs: Tensor) -> Tensor:
        """Return observations unpacked, if they are packed."""
        spec = self._packed_for(obs)
        return obs if spec is None else torch.from_numpy(unpacked(spec, obs.numpy()))

    def _packed_for(self, obs: Tensor) -> EnvSpec | None:
        """Return the environment that observations are packed for, if they are."""
        spec = self.packs
        packed = spec is not None and spec.unpack is not None and obs.shape[1:] != spec.observation_shape
        return spec if packed else None

    def elements(self, obs: Tensor, rows: Array) -> Array:
        """Return the elements of some pictures, with :data:`~convolution.SPARE` zeros behind them."""
        some, spec = obs.numpy().take(rows, 0), self._packed_for(obs)
        if spec is None:
            return elements_of(torch.from_numpy(some))
        elements = room_for(len(rows), math.prod(self.shape))
        pictures = elements[:-SPARE].view(spec.observation_dtype)
        unpacked(spec, some, pictures.reshape(len(rows), *self.shape))
        return elements

    def forward(self, obs: Tensor) -> Tensor:
        """Return features, shape ``(batch, width)``; the batch may be empty."""
        obs = self.whole(obs)
        if self.kind == "numbers":
            found: Tensor = self.table(self.numbers(obs))
            return found.sum(1) + self.bias
        features: Tensor
        if self.kind == "vector":
            mean, scale = self.statistics()
            rows = obs.reshape(len(obs), self.mean.numel())
            features = self.linear(((rows - mean) * scale).clamp(-dense.FARTHEST, dense.FARTHEST))
        elif self.linear.weight.is_cuda or not self.planes or obs.element_size() > 1:  # or made floats
            planes = obs.permute(0, 3, 1, 2).float()
            # Channels stay last, as they are in the observations: to reorder them would be a copy.
            features = self.linear(self.convolution(planes).relu_().permute(0, 2, 3, 1).flatten(1))
        else:
            features = PlanesLayer.apply(obs, *self.picture_weights())  # type: ignore[no-untyped-call]
        return features

    def picture_weights(self) -> tuple[Tensor, ...]:
        """Return those that pictures go through: of the filters, and of the linear layer."""
        return (*self.convolution.parameters(), *self.linear.parameters())

    def numbers(self, obs: Tensor) -> Tensor:
        """Return the rows of the table that observations choose, shape ``(batch, parts)``."""
        return obs.reshape(len(obs), self.offsets.numel()) + self.offsets

    def statistics(self) -> tuple[Tensor, Tensor]:
        """Return the means that are taken from vectors, and the factors that the rest is multiplied by."""
        return self.mean.float(), (self.variance + 1e-8).rsqrt().float()


class Network(nn.Module):
    """An :class:`Encoder`, a hidden layer as wide, and an output layer whose first weights have ``scale``.

    With ``positions``, the first layer is also told which of so many agents of a world it is for. With
    ``layer_norm``, what each of the two layers makes is standardised, row by row (Ba et al., 2016,
    arXiv:1607.06450), without weights of its own. With ``memory``, what the first layer makes goes through
    :class:`~pearl_marl.policies.memory.Memory`.
    """

    def __init__(
        self,
        space: Space[Any],
        outputs: int,
        width: int,
        scale: float = 1.0,
        positions: int = 0,
        packs: EnvSpec | None = None,
        layer_norm: bool = False,
        memory: bool = False,
    ) -> None:
        super().__init__()
        self.encoder, self.layer_norm = Encoder(space, width, packs), layer_norm
        self.hidden, self.output = nn.Linear(width, width), nn.Linear(width, outputs)
        nn.init.orthogonal_(self.hidden.weight, 2**0.5)
        nn.init.orthogonal_(self.output.weight, scale)
        nn.init.zeros_(self.hidden.bias)
        nn.init.zeros_(self.output.bias)
        self.indicator = nn.Embedding(positions, width) if positions else None
        self.memory = Memory(width) if memory else None

    def see(self, obs: Tensor, _: Tensor | None = None) -> None:
        """Take a batch of observations into the statistics by which they are standardised."""
        self.encoder.see(obs)

    def take_statistics(self, other: Network) -> None:
        """Take those of a network that is given the same observations."""
        for name, buffer in self.encoder.named_buffers():
            buffer.copy_(other.encoder.get_buffer(name))

    def features(self, obs: Tensor, position: Tensor | None = None) -> Tensor:
        """Return the inputs of the output layer, shape ``(batch, width)``; not of a network with memory."""
        if self.memory is not None:
            raise ArgumentError(
                "the network has a memory, and one call does not say what is remembered: call unrolled(), or "
                "the policy's choose()"
            )
        features: Tensor = self._bent(self.hidden(self._first(obs, position)))
        return features

    def unrolled(self, obs: Tensor, position: Tensor | None, recall: Recall) -> tuple[Tensor, Tensor]:
        """Return the same with a memory, of some steps of some agents; and the memories after each step."""
        assert self.memory is not None
        memories = self.memory(self._first(obs, position), recall)
        return self._bent(self.hidden(memories.flatten(0, 1))), memories

    def _first(self, obs: Tensor, position: Tensor | None) -> Tensor:
        """Return what the first layer makes."""
        first = self.encoder(obs)
        if self.indicator is not None:
            first = first + self.indicator(position)
        return self._bent(first)

    def _bent(self, made: Tensor) -> Tensor:
        """Return what a layer made, standardised or not, through the nonlinearity."""
        if self.layer_norm:
            made = layer_norm(made, made.shape[1:], eps=dense.EPSILON)
        return torch.relu(made) if self.encoder.kind == "picture" else torch.tanh(made)

    def forward(self, obs: Tensor, position: Tensor | None = None) -> Tensor:
        """Return the outputs, shape ``(batch, outputs)``; of agents with these positions in their worlds."""
        outputs: Tensor
        if not is_dense(self):
            outputs = self.output(self.features(obs, position))
        elif torch.is_grad_enabled():
            outputs = _Dense.apply(self, self.observed(obs, position), *self.parameters())  # type: ignore[no-untyped-call]
        else:
            outputs = self.dense_outputs(self.observed(obs, position))
        return outputs

    def layers(
        self, instead: Mapping[Tensor, Tensor] | None = None, made: Tensor | None = None
    ) -> dense.Layers:
        """Return the weights as compiled loops take them, or the tensors that stand for them ``instead``.

        For pictures, these are the layers behind the first; ``made``, of which numbers are rows, is what that
        makes, or where the gradients by it go.
        """
        encoder, empty = self.encoder, _EMPTY.expand(0, self.hidden.in_features)
        weights, table, bias = empty.t(), empty, None
        if made is not None:
            table, bias = made, made.new_zeros(self.hidden.in_features)
        elif encoder.kind == "numbers":
            table, bias = encoder.table.weight, encoder.bias
        else:
            weights, bias = encoder.linear.weight, encoder.linear.bias
        tensors: tuple[Tensor, ...] = (
            weights,
            table,
            empty if self.indicator is None else self.indicator.weight,
            bias,
            *(self.hidden.weight, self.hidden.bias, self.output.weight, self.output.bias),
        )
        if instead is not None:
            tensors = tuple(instead.get(tensor, tensor) for tensor in tensors)
        arrays = (tensor.detach().numpy() for tensor in tensors)
        return dense.Layers(*arrays, self.layer_norm, encoder.kind == "picture")  # type: ignore[call-arg, arg-type]

    def observed(self, obs: Tensor, position: Tensor | None) -> dense.NetworkInputs:
        """Return observations as compiled loops take them; of pictures, rows of a table that is yet to be."""
        encoder, n = self.encoder, len(obs)
        mean = scale = np.empty(0, np.float32)
        x, numbers = np.empty((n, 0), np.float32), np.empty((n, 0), np.int64)
        positions = np.empty(0, np.int64)
        if encoder.kind == "numbers":
            numbers = encoder.numbers(encoder.whole(obs)).contiguous().numpy()
        elif encoder.kind == "picture":
            numbers = np.zeros((n, 1), np.int64)
        else:
            mean, scale = (tensor.numpy() for tensor in encoder.statistics())
            x = encoder.whole(obs).reshape(n, len(mean)).float().contiguous().numpy()
        if self.indicator is not None:
            positions = torch.as_tensor(position).contiguous().numpy()
        return dense.NetworkInputs(x, mean, scale, numbers, positions)

    def dense_outputs(self, observed: dense.NetworkInputs) -> Tensor:
        """Return the outputs, by compiled loops."""
        outputs = np.empty((len(observed.x), self.output.out_features), np.float32)
        layers, forward = self.layers(), dense.forward()
        over_rows(len(outputs), SHARED_ROWS, lambda rows: forward(layers, observed.pick(rows), outputs[rows]))
        return torch.from_numpy(outputs)


class PictureGradients(NamedTuple):
    """Where the gradients by a network's weights go."""

    first: list[Tensor]  # those by the weights of the first layer
    others: dense.Layers  # of which the table is missing


class Pictures:
    """Pictures that a network is given, for compiled loops that learn the layers behind the first.

    ``inputs`` are those of the loops, with a row for each picture. What the first layer makes of those that
    the loops are given is a table, and they are numbers of its rows.
    """

    def __init__(self, network: Network, obs: Tensor, position: Tensor | None) -> None:
        self._network, self._obs = network, obs
        self._layers = network.layers(made=_EMPTY)
        self.inputs = network.observed(obs, position)

    def gradients(self, instead: Mapping[Tensor, Tensor]) -> PictureGradients:
        """Return where gradients go: to the tensors that stand for the weights."""
        first = [instead[parameter] for parameter in self._network.encoder.picture_weights()]
        return PictureGradients(first, self._network.layers(instead, _EMPTY))

    @contextmanager
    def first_layer(
        self, rows: Array, gradients: PictureGradients
    ) -> Iterator[tuple[dense.Layers, dense.Layers]]:
        """Yield the layers behind the first, with what that makes of some pictures; and their gradients.

        From those by what the first layer makes, the gradients by its weights follow at the end.
        """
        encoder = self._network.encoder
        filters, filter_bias, weights, bias = (parameter.detach() for parameter in encoder.picture_weights())
        planes = Planes(encoder.elements(self._obs, rows), encoder.shape, filters, filter_bias)
        self.inputs.numbers[rows, 0] = np.arange(len(rows))
        made = planes.outputs(weights, bias).numpy()
        by_made = np.empty_like(made)
        yield self._layers._replace(table=made), gradients.others._replace(table=by_made)
        planes.find_gradients(weights, torch.from_numpy(by_made), gradients.first)


def takes_planes(network: nn.Module) -> bool:
    """Return whether compiled loops can learn it with :class:`Pictures`."""
    if not isinstance(network, Network) or network.memory is not None or network.encoder.kind != "picture":
        return False
    return network.encoder.planes and not network.output.weight.is_cuda


def is_dense(network: nn.Module) -> bool:
    """Return whether compiled loops can do all of it: no picture, memory, separate networks or GPU."""
    if not isinstance(network, Network) or network.memory is not None:
        return False
    return network.encoder.kind != "picture" and not network.output.weight.is_cuda


class SeparateNetworks(nn.ModuleList):
    """A :class:`Network` for each agent of a world, which share nothing."""

    def see(self, obs: Tensor, position: Tensor) -> None:
        """Take a batch of observations into the statistics of the networks that they are for."""
        for k, network in enumerate(self):
            network.see(obs[position == k])  # type: ignore[operator]

    def take_statistics(self, other: SeparateNetworks) -> None:
        """Take those of networks that are given the same observations."""
        for own, another in zip(self, other, strict=True):
            own.take_statistics(another)  # type: ignore[operator]

    def forward(self, obs: Tensor, position: Tensor) -> Tensor:
        """Return the outputs, shape ``(batch, outputs)``."""
        rows = [(position == k).nonzero()[:, 0] for k in range(len(self))]
        outputs = torch.cat([network(obs[own]) for network, own in zip(self, rows, strict=True)])
        return outputs[torch.cat(rows).argsort()]


def networks(
    spec: EnvSpec,
    outputs: int,
    width: int,
    scale: float = 1.0,
    sharing: str = "all",
    layer_norm: bool = False,
    memory: bool = False,
) -> Network | SeparateNetworks:
    """Return networks for a world's agents, with so many outputs; ``sharing`` is of :data:`SHARING`."""
    kinds: dict[str, Any] = {"packs": spec, "layer_norm": layer_norm, "memory": memory}
    made = partial(Network, spec.observation_space, outputs, width, scale, **kinds)
    if sharing == "none":
        if memory:
            raise ArgumentError(
                "agents with memory share a network: take sharing all or indicator, or the memory none"
            )
        return SeparateNetworks(made() for _ in range(spec.agents))
    return made(positions=spec.agents if sharing == "indicator" else 0)
