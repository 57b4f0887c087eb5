"""Policies that trainers make, by a network or by tables, and the file that keeps one.

A trained policy is a ``policy.safetensors`` with all that is needed to use it again; see :func:`load`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete
from torch import Tensor, nn

from pearl_marl.base.arrays import Array
from pearl_marl.checks import is_number
from pearl_marl.envs import registered_spec
from pearl_marl.errors import ArgumentError, brief, one_line
from pearl_marl.policies import policy_file
from pearl_marl.policies.dense_policy import DenseNetwork
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.policies.memory import MEMORY, Recall, acting
from pearl_marl.policies.network import SHARING, Network, is_dense, masked, most, networks
from pearl_marl.spec import EnvSpec
from pearl_marl.spec.elements import are_numbers, bounds

KINDS = ("logits", "values", "mean")
"""How a network's outputs are meant: see :class:`NetworkPolicy`."""

SECOND_THREAD = 1 << 17
"""Elements of a layer's output, rows times width, from which on a second thread helps, except for pictures.

Of fewer, threads that wait for each other take longer.
"""

_SCALAR = torch.zeros(())
"""Stands for a tensor that a file does not have."""


class _Trained(nn.Module):
    """A policy with its environment, and with ``about``, which describes it in its file."""

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

    @property
    def function(self) -> Callable[..., Array]:
        """The policy as evaluations call it: :meth:`choose`, with ``forget`` where it remembers."""
        return self.choose

    @property
    def beside(self) -> DevicePolicy | None:
        """The policy as rollouts on the CPU run it beside the environments; ``None`` if they do not."""
        return None

    def act(self, obs: Tensor, masks: Tensor | None = None) -> Tensor:
        """Return the actions that it takes where it is used: the best, unless it says otherwise."""
        return self.best(obs, masks)

    def seed(self, seed: int) -> None:
        """Begin the random numbers anew, of a policy that uses any."""

    def positions(self, n: int) -> Tensor:
        """Return the position of each of ``n`` agents in its world."""
        return torch.arange(n, device=next(self.buffers()).device) % self.spec.agents

    def save(self, path: Path) -> None:
        """Write what :func:`load` reads."""
        policy_file.write(path, self.about, self.state_dict())


class Remembering:
    """A policy with memory as a function, which is called once for each step of all its agents.

    ``forget`` is to be called after each step, with those whose episodes ended, and without an argument
    before a reset: see :func:`pearl_marl.policies.loading.forget`.
    """

    def __init__(self, policy: NetworkPolicy) -> None:
        self._policy, self.forget = policy, policy.forget

    def __call__(self, obs: Array, masks: Array | None = None) -> Array:
        """Return an action for each observation; of few agents with one thread of PyTorch."""
        threads = torch.get_num_threads()
        if len(obs) * self._policy.about["width"] < SECOND_THREAD:
            torch.set_num_threads(1)
        try:
            return self._policy.choose(obs, masks)
        finally:
            torch.set_num_threads(threads)


class NetworkPolicy(_Trained):
    """A policy by a network, whose outputs are meant in one of several ways.

    Parameters
    ----------
    spec
        The environment that it is for.
    kind
        ``"logits"``: an output for each action, the most probable is the best; or where actions have several
        fields, one for each value of each, and each field is chosen for itself. ``"values"``: an output for
        each action, the most valuable is the best. ``"mean"``: the outputs are the action, of a ``Box``,
        whose least is -1 here, and whose greatest is 1.
    width
        Of the network's layers.
    sharing
        What agents of a world have in common. ``"all"``: one network, whose only input is observations.
        ``"indicator"``: one network, which is also told the agent's position in its world. ``"none"``: each
        agent has its own.
    temperature, epsilon
        How random its actions are where it is used. With ``"logits"``, they are drawn at this temperature; 0
        takes the most probable. With ``"values"``, this share is random. Two agents of a team that both want
        to be in the same cell, and always take the best action, wait for each other forever.
    layer_norm
        Whether layers are standardised: see :class:`~pearl_marl.policies.network.Network`.
    memory
        ``"gru"``: it remembers. Each call is then a step of the same agents; see :meth:`forget`.
    """

    network: Any
    bound: Tensor
    low: Tensor
    high: Tensor

    def __init__(
        self,
        spec: EnvSpec,
        kind: str,
        width: int,
        sharing: str = "all",
        temperature: float = 0.0,
        epsilon: float = 0.0,
        layer_norm: bool = False,
        memory: str = "none",
    ) -> None:
        sharing = sharing if spec.agents > 1 else "all"
        randomness = {"logits": {"temperature": temperature}, "values": {"epsilon": epsilon}}.get(kind, {})
        described: dict[str, Any] = {"layer_norm": True} if layer_norm else {}
        if memory != "none":
            described["memory"] = memory
        self.memory: Tensor | None = None
        super().__init__(spec, kind=kind, width=width, sharing=sharing, **randomness, **described)
        self.temperature, self.epsilon = temperature, epsilon
        self.random = torch.Generator().manual_seed(0)
        actions = spec.action_space
        if isinstance(actions, Box) != (kind == "mean") or (
            kind == "values" and not isinstance(actions, Discrete)
        ):
            raise ArgumentError(
                f"action values are of numbered actions, and {spec.name}'s are in {actions}: use ppo"
            )
        self.heads = [] if isinstance(actions, (Box, Discrete)) else list(spec.action_counts)
        """How many outputs each field of an action has, where it has fields to be chosen one by one."""
        self.outputs = sum(spec.action_counts) or len(spec.action_fields)
        scale = 1.0 if kind == "values" else 0.01
        self.network = networks(spec, self.outputs, width, scale, sharing, layer_norm, memory != "none")
        low, high = bounds(actions) if isinstance(actions, Box) else np.array([[-1], [1]], np.float32)
        self.register_buffer("bound", torch.from_numpy((high - low) / 2))
        for name, end in (("low", low), ("high", high)):
            self.register_buffer(name, torch.from_numpy(end.copy()), persistent=False)

    def forward(self, obs: Tensor, masks: Tensor | None = None, position: Tensor | None = None) -> Tensor:
        """Return the network's outputs, shape ``(batch, outputs)``; :data:`MASKED` where ``masks`` are 0.

        Unless positions are given, the batch is of whole worlds.
        """
        if position is None and self.about["sharing"] != "all":
            position = self.positions(len(obs))
        return masked(self.network(obs, position), masks)

    @property
    def function(self) -> Callable[..., Array]:
        """The policy as evaluations call it."""
        return Remembering(self) if self.remembers else self.choose

    @property
    def beside(self) -> DenseNetwork | None:
        """See :class:`_Trained`; of small networks that choose the best of numbered actions."""
        random = {"logits": self.temperature, "values": self.epsilon}.get(self.about["kind"], 1.0)
        return None if random else self.dense

    @property
    def dense(self) -> DenseNetwork | None:
        """What chooses the best of numbered actions in a rollout, if the network is small."""
        network, spec = self.network, self.spec
        # Floats that are unpacked have no fixed point, and would be rounded.
        rounded = spec.unpack is not None and spec.observation_dtype.kind == "f"
        numbered = self.about["kind"] != "mean"
        if not numbered or rounded or not isinstance(network, Network) or not is_dense(network):
            return None
        encoder, nothing = network.encoder, torch.zeros(0)
        numbers = encoder.kind == "numbers"
        mean, scale = (nothing, nothing) if numbers else encoder.statistics()
        offsets = encoder.offsets if numbers else nothing
        return DenseNetwork(
            spec,
            network.layers(),
            mean.numpy(),
            scale.numpy(),
            offsets.long().numpy(),
            tuple(self.heads) or (self.outputs,),
        )

    @property
    def remembers(self) -> bool:
        """Whether it has a memory."""
        return "memory" in self.about

    def unrolled(
        self, obs: Tensor, masks: Tensor | None, position: Tensor | None, recall: Recall
    ) -> tuple[Tensor, Tensor]:
        """Return the outputs with a memory, of some steps of some agents; and the memories after each step.

        Observations, masks and positions have steps and agents as one axis.
        """
        features, memories = self.network.unrolled(obs, position, recall)
        return masked(self.network.output(features), masks), memories

    def forget(self, ended: Array | None = None) -> None:
        """Forget what agents remember: those whose episodes ended, or all."""
        if ended is None or self.memory is None:
            self.memory = None
        else:
            rows = torch.from_numpy(ended).to(self.memory.device)
            self.memory = self.memory.masked_fill(rows[:, None], 0)

    def _outputs(self, obs: Tensor, masks: Tensor | None) -> Tensor:
        """Return the outputs, of the next step where it remembers."""
        if not self.remembers:
            outputs: Tensor = self(obs, masks)
            return outputs
        if self.memory is None or len(self.memory) != len(obs):
            self.memory = torch.zeros(len(obs), self.about["width"], device=obs.device)
        acts = acting(masks)
        recall = Recall(self.memory, acting=None if acts is None else acts[None])
        outputs, (self.memory,) = self.unrolled(obs, masks, self.positions(len(obs)), recall)
        return outputs

    @torch.no_grad()
    def best(self, obs: Tensor, masks: Tensor | None = None) -> Tensor:
        """Return the best actions: ``int64`` numbers, or ``float32`` within the bounds."""
        outputs = self._outputs(obs, masks)
        if self.about["kind"] == "mean":
            return self.within_bounds(outputs)
        return most(outputs, self.heads)

    @torch.no_grad()
    def act(self, obs: Tensor, masks: Tensor | None = None) -> Tensor:
        """Return random actions, as the policy's temperature or epsilon says; without one, the best."""
        kind = self.about["kind"]
        if not {"logits": self.temperature, "values": self.epsilon}.get(kind):
            return self.best(obs, masks)
        outputs = self._outputs(obs, masks)
        noise = torch.rand(outputs.shape, generator=self.random).to(outputs.device)
        if kind == "logits":  # Gumbel's trick
            return most(outputs / self.temperature - noise.log().neg().log(), self.heads)
        anyone = torch.rand(len(outputs), generator=self.random).to(outputs.device) < self.epsilon
        return torch.where(anyone, masked(noise, masks).argmax(1), outputs.argmax(1))

    def seed(self, seed: int) -> None:
        """Begin the random numbers anew."""
        self.random.manual_seed(seed)

    def within_bounds(self, outputs: Tensor) -> Tensor:
        """Return outputs of the kind ``"mean"`` as actions that the environment takes."""
        # The sum may round to beyond an end.
        return torch.clamp(
            outputs.clamp(-1, 1) * self.bound + (self.low + self.high) / 2, self.low, self.high
        )


class TabularPolicy(_Trained):
    """A policy by tables of a value for each observation and action, one table for each learner.

    Observations are numbers, or tuples of them. Of ``n``, the first ``n / learners`` are the first learner's,
    and so on.
    """

    values: Tensor
    """Shape ``(learners, observations, actions)``, ``float32``."""

    def __init__(self, spec: EnvSpec, learners: int = 1) -> None:
        super().__init__(spec, kind="table")
        space, actions = spec.observation_space, spec.action_space
        if not are_numbers(space):
            raise ArgumentError(
                f"a table has a row for each observation, and {spec.name}'s are in {space}: use ppo or dqn"
            )
        if not isinstance(actions, Discrete):
            raise ArgumentError(
                f"a table has a column for each action, and {spec.name}'s are in {actions}: use ppo"
            )
        starts, last = (end.ravel().tolist() for end in bounds(space))
        sizes = [high - low + 1 for low, high in zip(starts, last, strict=True)]
        # The number of a row is a sum, of each part's offset from its start times the rows between two of it.
        self._strides = [int(np.prod(sizes[i + 1 :])) for i in range(len(sizes))]
        self._first = sum(start * stride for start, stride in zip(starts, self._strides, strict=True))
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


def load(path: Path) -> NetworkPolicy | TabularPolicy:
    """Read a policy, or the one in a run folder.

    Raises
    ------
    ArgumentError
        There is none, or not one of this package's.
    """
    file = path / "policy.safetensors" if path.is_dir() else path
    about, tensors = policy_file.read(file)
    try:
        # On torch's device of no memory: the file may name any size.
        with torch.device("meta"):
            policy = _described(about, tensors)
        policy_file.check_weights(policy, tensors, policy.spec.name)
    except ArgumentError as error:
        raise ArgumentError(f"{file} is damaged, or of another version: {one_line(error)}") from None
    policy.load_state_dict(tensors, assign=True)
    return policy


def _described(about: Any, tensors: dict[str, Tensor]) -> NetworkPolicy | TabularPolicy:
    """Make the policy that metadata describe, for these tensors, as yet without them."""
    if not isinstance(about, dict):
        raise ArgumentError("its metadata say nothing of its policy")
    needed: dict[str, type] = {"environment": str, "options": dict, "kind": str}
    if about.get("kind") not in ("table", "integers"):
        needed["width"] = int
    for field, of_type in needed.items():
        if field not in about:
            raise ArgumentError(f"its policy has no {field!r}")
        if type(about[field]) is not of_type:
            raise ArgumentError(f"its policy has the {field} {brief(about[field])}")
    spec = registered_spec(about["environment"]).with_options(**about["options"])
    if about["kind"] == "table":
        values = tensors.get("values", _SCALAR)
        return TabularPolicy(spec, max(1, len(values)) if values.ndim else 1)
    if about["kind"] == "integers":
        raise ArgumentError("it is a policy in integers, which pearl_marl.load_policy() reads for rollout()")
    if about["kind"] not in KINDS:
        raise ArgumentError(
            f"its policy has the kind {brief(about['kind'])}; possible are {', '.join(KINDS)}, table"
        )
    width, sharing = about["width"], about.get("sharing", "all")
    if sharing not in SHARING:
        raise ArgumentError(f"its policy has the sharing {brief(sharing)}; possible are {', '.join(SHARING)}")
    layer = "network.0.hidden.weight" if sharing == "none" else "network.hidden.weight"
    hidden = tensors.get(layer, _SCALAR)
    if width < 1 or hidden.shape != (width, width):
        raise ArgumentError(f"its policy has the width {brief(width)}, and layers of {tuple(hidden.shape)}")
    if not isinstance(layer_norm := about.get("layer_norm", False), bool):
        raise ArgumentError(f"its policy has the layer_norm {brief(layer_norm)}; possible are true, false")
    if (memory := about.get("memory", "none")) not in MEMORY:
        raise ArgumentError(f"its policy has the memory {brief(memory)}; possible are {', '.join(MEMORY)}")
    make: Any = partial(
        NetworkPolicy, spec, about["kind"], width, sharing, layer_norm=layer_norm, memory=memory
    )
    name = {"logits": "temperature", "values": "epsilon"}.get(about["kind"])
    policy: NetworkPolicy
    if name is None:
        policy = make()
        return policy
    randomness = about.get(name, about.get("chance", 0.0))  # older files have "chance" for both
    if not is_number(randomness) or randomness < 0:
        raise ArgumentError(f"its policy has the {name} {brief(randomness)}; it must be a number from 0")
    policy = make(**{name: float(randomness)})
    return policy
