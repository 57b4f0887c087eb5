"""The network that the trainers learn: observations of any environment in, numbers for actions out.

A trained one is a ``policy.safetensors`` with all that is needed to use it again; see :func:`load`.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Box, Discrete, Space, Tuple
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from pearl_marl.errors import ArgumentError
from pearl_marl.files import replace_file
from pearl_marl.packing import unpacked
from pearl_marl.policies import dense
from pearl_marl.registry import get_spec
from pearl_marl.spec import EnvSpec

Array = npt.NDArray[Any]

_NOTHING = torch.empty(0, 1)

FORMAT = "pearl-policy-1"

KINDS = ("logits", "values", "mean")
"""How a network's outputs are meant: see :class:`NetworkPolicy`."""

SHARING = ("all", "indicator", "none")
"""What the networks of a world's agents have in common: see :class:`NetworkPolicy`."""

MASKED = torch.finfo(torch.float32).min
"""The output of a masked action. Minus infinity would do for its probability, but makes the entropy NaN.
Where all actions are masked, all are equally likely, and the first is the best."""


def masked(outputs: Tensor, masks: Tensor | None) -> Tensor:
    """Return outputs, shape ``(..., actions)``, with :data:`MASKED` where ``masks`` are 0."""
    return outputs if masks is None else outputs.masked_fill(masks == 0, MASKED)


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

    Numbers (``Discrete``, or a ``Tuple`` of it) choose rows of a table, which is what a linear layer over
    their one-hot form computes. Vectors are standardised by the statistics of all that were seen in
    training, then go through a linear layer. Pictures (``Box`` of three axes, channels last) go through
    a convolution, as in MinAtar's DQN. Observations that the environment ``packs`` may be given packed.
    """

    offsets: Tensor
    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, space: Space[Any], width: int, packs: EnvSpec | None = None) -> None:
        super().__init__()
        self.packs = packs
        self.kind = "vector"
        if isinstance(space, (Discrete, Tuple)):
            self.kind = "numbers"
            parts: list[Any] = list(space) if isinstance(space, Tuple) else [space]
            sizes = [int(part.n) for part in parts]
            offsets = np.cumsum([0, *sizes[:-1]]) - [int(part.start) for part in parts]
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
            given = torch.relu(self.convolution(planes)).flatten(1)
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
        if self.indicator is not None and position is not None:
            whose = position.contiguous().numpy()
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


class _Trained(nn.Module):
    """A policy that says what it is for, and ``about`` what it was made."""

    def __init__(self, spec: EnvSpec, **about: Any) -> None:
        super().__init__()
        self.spec = spec
        self.about = {"environment": spec.name, "options": dict(spec.options), **about}

    def best(self, obs: Tensor, masks: Tensor | None = None) -> Tensor:
        """Return the best actions that masks allow; of agents of whole worlds, in their order."""
        raise NotImplementedError

    def choose(self, obs: Array, masks: Array | None = None) -> Array:
        """Return an action for each observation, as ``step_batch`` takes them, of those allowed."""
        where = next(self.buffers()).device
        allowed = None if masks is None else torch.from_numpy(masks).to(where)
        actions: Array = self.act(torch.from_numpy(obs).to(where), allowed).cpu().numpy()
        return actions

    def act(self, obs: Tensor, masks: Tensor | None = None) -> Tensor:
        """Return the actions that it takes where it is used: the best, unless it says otherwise."""
        return self.best(obs, masks)

    def seed(self, seed: int) -> None:
        """Begin the random numbers anew, of a policy that uses any."""

    def positions(self, n: int) -> Tensor:
        """Return who of its world each of ``n`` agents is."""
        return torch.arange(n, device=next(self.buffers()).device) % self.spec.agents

    def save(self, path: Path) -> None:
        """Write what :func:`load` reads."""
        header = {"format": FORMAT, "policy": json.dumps(self.about)}
        replace_file(path, _ordered(save(self.state_dict(), header)))


class NetworkPolicy(_Trained):
    """What chooses actions: a network, and how its outputs are meant.

    Parameters
    ----------
    spec
        The environment that it is for.
    kind
        ``"logits"``: an output for each action, the most probable is the best. ``"values"``: likewise, the
        most valuable. ``"mean"``: the outputs are the action, of a ``Box``, in units of its bounds.
    width
        Of the network's layers.
    sharing
        What agents of a world have in common. ``"all"``: one network, that sees nothing but observations.
        ``"indicator"``: one network, which is told whose they are. ``"none"``: each has its own.
    chance
        What part chance has in what it does where it is used. With ``"logits"``, the temperature at which
        actions are drawn; 0 for the most probable. With ``"values"``, the share of random actions. Agents of
        a team who always do their best wait for each other for ever, where both want to be in the same cell.
    """

    bound: Tensor

    def __init__(
        self, spec: EnvSpec, kind: str, width: int, sharing: str = "all", chance: float = 0.0
    ) -> None:
        sharing = sharing if spec.agents > 1 else "all"
        super().__init__(spec, kind=kind, width=width, sharing=sharing, chance=chance)
        self.chance, self.random = chance, torch.Generator().manual_seed(0)
        actions = spec.action_space
        if isinstance(actions, Box) != (kind == "mean"):
            raise ArgumentError(
                f"dqn chooses among numbered actions, and {spec.name}'s are in {actions}: use ppo"
            )
        self.outputs = int(actions.n) if isinstance(actions, Discrete) else int(np.prod(actions.shape))
        self.network = networks(spec, self.outputs, width, 1.0 if kind == "values" else 0.01, sharing)
        high = actions.high if isinstance(actions, Box) else np.ones(1, np.float32)
        self.register_buffer("bound", torch.from_numpy(high.copy()))

    def forward(self, obs: Tensor, masks: Tensor | None = None, position: Tensor | None = None) -> Tensor:
        """Return the network's outputs, shape ``(batch, outputs)``; :data:`MASKED` where ``masks`` are 0.

        Unless positions are given, the batch is of whole worlds.
        """
        if position is None and self.about["sharing"] != "all":
            position = self.positions(len(obs))
        return masked(self.network(obs, position), masks)

    def see(self, obs: Tensor, position: Tensor | None) -> None:
        """Take a batch of observations into the statistics by which they are standardised."""
        network: Any = self.network
        network.see(obs, position)

    @torch.no_grad()
    def best(self, obs: Tensor, masks: Tensor | None = None) -> Tensor:
        """Return the best actions: ``int64`` numbers, or ``float32`` within the bounds."""
        outputs = self(obs, masks)
        if self.about["kind"] == "mean":
            return self.within_bounds(outputs)
        best: Tensor = outputs.argmax(1)
        return best

    @torch.no_grad()
    def act(self, obs: Tensor, masks: Tensor | None = None) -> Tensor:
        """Return actions of the policy's probabilities, if chance has a part in it, else the best."""
        if not self.chance or self.about["kind"] == "mean":
            return self.best(obs, masks)
        outputs = self(obs, masks)
        noise = torch.rand(outputs.shape, generator=self.random).to(outputs.device)
        if self.about["kind"] == "logits":  # Gumbel's trick
            drawn: Tensor = (outputs / self.chance - noise.log().neg().log()).argmax(1)
            return drawn
        anyone = torch.rand(len(outputs), generator=self.random).to(outputs.device) < self.chance
        return torch.where(anyone, masked(noise, masks).argmax(1), outputs.argmax(1))

    def seed(self, seed: int) -> None:
        """Begin the random numbers anew."""
        self.random.manual_seed(seed)

    def within_bounds(self, outputs: Tensor) -> Tensor:
        """Return outputs of the kind ``"mean"`` as actions that the environment takes."""
        return outputs.clamp(-1, 1) * self.bound


class Table(_Trained):
    """What chooses actions by tables: a value for each observation and action, one table a learner.

    Observations are numbers, or tuples of them. Of ``n``, the first ``n / learners`` are the first learner's,
    and so on.
    """

    values: Tensor
    """Shape ``(learners, observations, actions)``, ``float32``."""

    def __init__(self, spec: EnvSpec, learners: int = 1) -> None:
        super().__init__(spec, kind="table")
        space, actions = spec.observation_space, spec.action_space
        parts: list[Any] = list(space) if isinstance(space, Tuple) else [space]
        if not all(isinstance(part, Discrete) for part in parts) or not isinstance(actions, Discrete):
            raise ArgumentError(
                f"a table has a row for each observation, and {spec.name}'s are in {space}: use ppo or dqn"
            )
        sizes = [int(part.n) for part in parts]
        # The number of a row is a sum, of each part's offset from its start times the rows between two of it.
        self._strides = [int(np.prod(sizes[i + 1 :])) for i in range(len(sizes))]
        self._first = sum(int(part.start) * stride for part, stride in zip(parts, self._strides, strict=True))
        self.register_buffer("values", torch.zeros(learners, int(np.prod(sizes)), int(actions.n)))

    def rows(self, obs: Tensor) -> Tensor:
        """Return the number of the row of each observation, counted through all tables."""
        learners, size, _ = self.values.shape
        columns = obs.reshape(len(obs), -1).unbind(1)
        rows = sum((part * stride for part, stride in zip(columns, self._strides, strict=True)), -self._first)
        if learners > 1:
            rows = rows + torch.arange(len(obs), device=obs.device) * learners // len(obs) * size
        return torch.as_tensor(rows)

    def best(self, obs: Tensor, masks: Tensor | None = None) -> Tensor:
        """Return the best actions, as ``int64`` numbers."""
        return masked(self.values.view(-1, self.values.shape[2])[self.rows(obs)], masks).argmax(1)


def load(path: Path) -> NetworkPolicy | Table:
    """Read a policy, or the one in a run folder.

    Raises
    ------
    ArgumentError
        There is none, or not one of this package's.
    """
    file = path / "policy.safetensors" if path.is_dir() else path
    try:
        with safe_open(file, "pt") as stored:
            header = stored.metadata() or {}
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise ArgumentError(f"{file} cannot be read as a policy: {error}") from None
    if header.get("format") != FORMAT:
        raise ArgumentError(f"{file} is no policy of `pearl train`: its format is {header.get('format')}")
    try:
        return _rebuilt(_described(header), tensors)
    except ArgumentError as error:
        raise ArgumentError(f"{file} is damaged, or of another version: {error}") from None


def _described(header: dict[str, str]) -> dict[str, Any]:
    """Return what a file's metadata say of its policy."""
    try:
        about = json.loads(header["policy"])
    except (KeyError, ValueError):
        about = None
    if not isinstance(about, dict):
        raise ArgumentError("its metadata says nothing of its policy")
    needed: dict[str, type] = {"environment": str, "options": dict, "kind": str}
    if about.get("kind") != "table":
        needed["width"] = int
    for name, kind in needed.items():
        if name not in about:
            raise ArgumentError(f"its policy has no {name!r}")
        if not isinstance(about[name], kind):
            raise ArgumentError(f"its policy has the {name} {about[name]!r}")
    return about


def _rebuilt(about: dict[str, Any], tensors: dict[str, Tensor]) -> NetworkPolicy | Table:
    """Make the policy that metadata describe, with these tensors."""
    spec = get_spec(about["environment"]).with_options(**about["options"])
    policy: NetworkPolicy | Table
    if about["kind"] == "table":
        policy = Table(spec, len(tensors.get("values", ())))
    elif about["kind"] in KINDS:
        width, sharing = about["width"], about.get("sharing", "all")  # which older files do not tell
        if sharing not in SHARING:
            raise ArgumentError(f"its policy has the sharing {sharing!r}; possible are {', '.join(SHARING)}")
        layer = "network.0.hidden.weight" if sharing == "none" else "network.hidden.weight"
        hidden = tensors.get(layer, torch.empty(0))
        if hidden.shape != (width, width):  # and memory for another width need not be there
            raise ArgumentError(f"its policy has the width {width}, and layers of {tuple(hidden.shape)}")
        chance = about.get("chance", 0.0)
        if not isinstance(chance, (int, float)) or not 0 <= chance < float("inf"):
            raise ArgumentError(f"its policy has the chance {chance!r}; it must be a number from 0")
        policy = NetworkPolicy(spec, about["kind"], width, sharing, chance)
    else:
        raise ArgumentError(
            f"its policy has the kind {about['kind']!r}; possible are {', '.join(KINDS)}, table"
        )
    wanted = policy.state_dict()
    for name in {**wanted, **tensors}:
        found, expected = (tuple(of[name].shape) if name in of else "of nothing" for of in (tensors, wanted))
        if found != expected:
            raise ArgumentError(
                f"its tensors are not those of {spec.name}: {name} has the shape {found}, not {expected}"
            )
    policy.load_state_dict(tensors)
    return policy


def _ordered(content: bytes) -> bytes:
    """Return a safetensors file with its header in order: the library's order differs from run to run."""
    (size,) = struct.unpack_from("<Q", content)
    header = json.loads(content[8 : 8 + size])
    text = json.dumps(header, sort_keys=True, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # tensors begin at a multiple of eight
    return struct.pack("<Q", len(text)) + text + content[8 + size :]
