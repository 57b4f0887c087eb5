"""The network that the trainers learn: observations of any environment in, numbers for actions out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Box, Space
from torch import Tensor, nn

from pearl_marl.elements import are_numbers, bounds
from pearl_marl.errors import ArgumentError, shown
from pearl_marl.packing import unpacked
from pearl_marl.policies import dense
from pearl_marl.spec import EnvSpec

Array = npt.NDArray[Any]

_NOTHING = torch.empty(0, 1)

SHARING = ("all", "indicator", "none")
"""What the networks of a world's agents have in common: see :class:`NetworkPolicy`."""

MASKED = torch.finfo(torch.float32).min
"""The output of a masked action. Minus infinity would do for its probability, but makes the entropy NaN.
Where all actions are masked, all are equally likely, and the first is the best."""


def masked(outputs: Tensor, masks: Tensor | None) -> Tensor:
    """Return outputs, shape ``(..., actions)``, with :data:`MASKED` where ``masks`` are 0."""
    return outputs if masks is None else outputs.masked_fill(masks == 0, MASKED)


_GIVEN = "bound", "offsets"
"""Buffers that follow from the environment, and are not learned."""


def check_weights(module: nn.Module, tensors: Any, whose: str) -> None:
    """Refuse tensors from a file that are not those of a module, or that no training leaves.

    Compiled loops trust them: with other offsets, they would read what is beside a table.
    """
    wanted = module.state_dict()
    found = tensors if isinstance(tensors, Mapping) else {}
    for name in {**wanted, **found}:
        kinds = [
            f"{of[name].dtype} of shape {tuple(of[name].shape)}"
            if isinstance(of.get(name), Tensor)
            else "nothing"
            for of in (found, wanted)
        ]
        if kinds[0] != kinds[1]:
            raise ArgumentError(
                f"its tensors are not those of {whose}: {shown(name)} is {kinds[0]}, not {kinds[1]}"
            )
        tensor, last = found[name], name.rpartition(".")[2]
        if not tensor.isfinite().all():
            raise ArgumentError(f"{name} has NaN or an infinity among its numbers: the training diverged")
        if last in _GIVEN and not tensor.equal(wanted[name].to(tensor.device)):
            raise ArgumentError(f"{name} has other numbers than {whose} has")
        if last in ("variance", "count") and tensor.min() < 0:
            raise ArgumentError(f"{name} has a number below 0")


class _Dense(torch.autograd.Function):
    """The outputs of a :class:`Network` by compiled loops, of which the gradients follow likewise."""

    @staticmethod
    def forward(ctx: Any, network: Network, given: dense.Given, *_: Tensor) -> Tensor:
        """Return the outputs; the rest of what is given are the network's parameters."""
        ctx.network, ctx.given = network, given
        return network.of_given(given)

    @staticmethod
    def backward(ctx: Any, by_outputs: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients by the parameters."""
        made = {parameter: torch.empty_like(parameter) for parameter in ctx.network.parameters()}
        gradients = ctx.network.layers(made.__getitem__)
        dense.backward(ctx.network.layers(), ctx.given, by_outputs.contiguous().numpy(), gradients)
        return None, None, *made.values()


class Encoder(nn.Module):
    """The first layer: makes ``width`` features of an observation, whatever its space.

    Numbers (``Discrete``, a ``Tuple`` of it, ``MultiDiscrete``, ``MultiBinary``) choose rows of a table,
    which is what a linear layer over their one-hot form computes. Vectors are standardised by the statistics
    of all that were seen in training, then go through a linear layer. Pictures (``Box`` of three axes,
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
            self.convolution = nn.Conv2d(channels, 16, 3)
            self.linear = nn.Linear(16 * (height - 2) * (breadth - 2), width)
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
        rows = self.whole(obs).reshape(len(obs), self.mean.numel()).double()
        variance, mean = torch.var_mean(rows, 0, correction=0)
        total = self.count + len(rows)
        apart = mean - self.mean
        spread = self.variance * self.count + variance * len(rows) + apart**2 * self.count * len(rows) / total
        self.mean += apart * len(rows) / total
        self.variance.copy_(spread / total)
        self.count.copy_(total)

    def whole(self, obs: Tensor) -> Tensor:
        """Return observations unpacked, if they are packed."""
        if self.packs is None or self.packs.unpack is None or obs.shape[1:] == self.packs.observation_shape:
            return obs
        return torch.from_numpy(unpacked(self.packs, obs.numpy()))

    def forward(self, obs: Tensor) -> Tensor:
        """Return features, shape ``(batch, width)``; the batch may be empty."""
        obs = self.whole(obs)
        if self.kind == "numbers":
            found: Tensor = self.table(self.numbers(obs))
            return found.sum(1) + self.bias
        if self.kind == "picture":
            planes = obs.permute(0, 3, 1, 2).float()
            # Channels stay last, as they are in the observations: to reorder them would be a copy.
            given = self.convolution(planes).relu_().permute(0, 2, 3, 1).flatten(1)
        else:
            given = self.standardised(obs)
        features: Tensor = self.linear(given)
        return features

    def numbers(self, obs: Tensor) -> Tensor:
        """Return the rows of the table that observations choose, shape ``(batch, parts)``."""
        return obs.reshape(len(obs), self.offsets.numel()) + self.offsets

    def standardised(self, obs: Tensor) -> Tensor:
        """Return vectors by the statistics of those that were seen, shape ``(batch, inputs)``."""
        mean, scale = self.statistics()
        rows = obs.reshape(len(obs), self.mean.numel())
        return ((rows - mean) * scale).clamp(-dense.FARTHEST, dense.FARTHEST)

    def statistics(self) -> tuple[Tensor, Tensor]:
        """Return what vectors are standardised by: what is taken from them, and their factors."""
        return self.mean.float(), (self.variance + 1e-8).rsqrt().float()


class Network(nn.Module):
    """An :class:`Encoder`, a hidden layer as wide, and an output layer whose first weights have ``scale``.

    With ``positions``, the first layer is told who of so many agents of a world it is, too.
    """

    def __init__(
        self,
        space: Space[Any],
        outputs: int,
        width: int,
        scale: float = 1.0,
        positions: int = 0,
        packs: EnvSpec | None = None,
    ) -> None:
        super().__init__()
        self.encoder = Encoder(space, width, packs)
        self.hidden, self.output = nn.Linear(width, width), nn.Linear(width, outputs)
        nn.init.orthogonal_(self.hidden.weight, 2**0.5)
        nn.init.orthogonal_(self.output.weight, scale)
        nn.init.zeros_(self.hidden.bias)
        nn.init.zeros_(self.output.bias)
        self.indicator = nn.Embedding(positions, width) if positions else None

    def see(self, obs: Tensor, _: Tensor | None = None) -> None:
        """Take a batch of observations into the statistics by which they are standardised."""
        self.encoder.see(obs)

    def features(self, obs: Tensor, position: Tensor | None = None) -> Tensor:
        """Return what the output layer is given, shape ``(batch, width)``."""
        first = self.encoder(obs)
        if self.indicator is not None:
            first = first + self.indicator(position)
        bend = torch.relu if self.encoder.kind == "picture" else torch.tanh
        features: Tensor = bend(self.hidden(bend(first)))
        return features

    def forward(self, obs: Tensor, position: Tensor | None = None) -> Tensor:
        """Return the outputs, shape ``(batch, outputs)``; of agents with these positions in their worlds."""
        outputs: Tensor
        if not is_dense(self):
            outputs = self.output(self.features(obs, position))
        elif torch.is_grad_enabled():
            outputs = _Dense.apply(self, self.given(obs, position), *self.parameters())  # type: ignore[no-untyped-call]
        else:
            outputs = self.of_given(self.given(obs, position))
        return outputs

    def layers(self, of: Callable[[Tensor], Tensor] = lambda parameter: parameter) -> dense.Layers:
        """Return the weights, or what belongs to each of them, as compiled loops take them."""
        encoder, nothing = self.encoder, _NOTHING.expand(0, self.hidden.in_features)
        if encoder.kind == "numbers":
            first, table, bias = nothing.t(), of(encoder.table.weight), of(encoder.bias)
        else:
            first, table, bias = of(encoder.linear.weight), nothing, of(encoder.linear.bias)
        indicator = nothing if self.indicator is None else of(self.indicator.weight)
        hidden, output = self.hidden, self.output
        others = map(of, (hidden.weight, hidden.bias, output.weight, output.bias))
        arrays = (tensor.detach().numpy() for tensor in (first, table, indicator, bias, *others))
        return dense.Layers(*arrays)

    def given(self, obs: Tensor, position: Tensor | None) -> dense.Given:
        """Return observations as compiled loops take them."""
        encoder, n = self.encoder, len(obs)
        obs = encoder.whole(obs)
        mean = scale = np.empty(0, np.float32)
        x, numbers, whose = np.empty((n, 0), np.float32), np.empty((n, 0), np.int64), np.empty(0, np.int64)
        if encoder.kind == "numbers":
            numbers = encoder.numbers(obs).contiguous().numpy()
        else:
            mean, scale = (tensor.numpy() for tensor in encoder.statistics())
            x = obs.reshape(n, len(mean)).float().contiguous().numpy()
        if self.indicator is not None:
            whose = torch.as_tensor(position).contiguous().numpy()
        return dense.Given(x, mean, scale, numbers, whose)

    def of_given(self, given: dense.Given) -> Tensor:
        """Return the outputs, by compiled loops."""
        outputs = np.empty((len(given.x), self.output.out_features), np.float32)
        dense.forward(self.layers(), given, outputs)
        return torch.from_numpy(outputs)


def is_dense(network: nn.Module) -> bool:
    """Return whether compiled loops can do all of it: no picture, no networks apart, no GPU."""
    if not isinstance(network, Network):
        return False
    return network.encoder.kind != "picture" and not network.output.weight.is_cuda


class Apart(nn.ModuleList):
    """A :class:`Network` for each agent of a world, which have nothing in common."""

    def see(self, obs: Tensor, position: Tensor) -> None:
        """Take a batch of observations into the statistics of those that they are for."""
        for k, network in enumerate(self):
            network.see(obs[position == k])  # type: ignore[operator]

    def forward(self, obs: Tensor, position: Tensor) -> Tensor:
        """Return the outputs, shape ``(batch, outputs)``."""
        rows = [(position == k).nonzero()[:, 0] for k in range(len(self))]
        outputs = torch.cat([network(obs[each]) for network, each in zip(self, rows, strict=True)])
        return outputs[torch.cat(rows).argsort()]


def networks(
    spec: EnvSpec, outputs: int, width: int, scale: float = 1.0, sharing: str = "all"
) -> Network | Apart:
    """Return what maps observations of a world's agents to ``outputs``; ``sharing`` is of :data:`SHARING`."""
    space = spec.observation_space
    if sharing == "none":
        return Apart(Network(space, outputs, width, scale, packs=spec) for _ in range(spec.agents))
    return Network(space, outputs, width, scale, spec.agents if sharing == "indicator" else 0, spec)
