"""Gathering experience: agents act by a policy that stays as it is, for some steps of each.

What is gathered depends on the weights, the state of the agents and the number of the rollout, and on
nothing else. Whoever gathers, and with whomever the agents are shared, gathers the same.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Normal

from pearl_marl.batch.config import worlds_of
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.devices import BatchConfig, BatchStep, Device, make_device
from pearl_marl.policies.network import Network, NetworkPolicy
from pearl_marl.spec import EnvSpec

ROWS = 16_384
"""Observations that the critic is given at a time, for the memory that its layers take."""


class Agents:
    """``n`` agents of whole worlds, the first of the global number ``first``; ``obs`` is what they see now.

    They are stepped by tensors. Where the device has its results, these stay: of ``"cuda"`` on the GPU.
    """

    def __init__(self, spec: EnvSpec, device: str | Device, n: int, seed: int, first: int = 0) -> None:
        self.device = make_device(device, tensors=True)
        first_slot = first // spec.agents
        self.device.open(BatchConfig(spec=spec, n_envs=worlds_of(spec, n), first_slot=first_slot))
        self.obs = torch.as_tensor(self.device.reset(seed))

    def step(self, actions: Tensor) -> Any:
        """Step every agent; return a :class:`BatchStep` of tensors."""
        given: Any = actions if self.device.tensors else actions.numpy()
        step: Any = BatchStep(*map(torch.as_tensor, self.device.step(given)))  # type: ignore[arg-type]
        self.obs = step.obs
        return step

    @property
    def identity(self) -> dict[str, Any]:
        """What a saved state of these agents has to agree with."""
        return self.device.config.identity()

    def state(self) -> SavedState:
        """Return all that the agents' continuation depends on."""
        return self.device.snapshot()

    def load(self, state: SavedState) -> None:
        """Go on from what :meth:`state` returned."""
        self.obs = torch.as_tensor(self.device.restore(state))


class Returns:
    """Mean return and length of the episodes that ``n`` agents finish, added up where the rewards are."""

    def __init__(self, n: int, where: torch.device) -> None:
        # Of the episodes under way: returns, lengths. Of those finished: number, returns, lengths.
        self._under_way = torch.zeros(2, n, dtype=torch.float64, device=where)
        self._finished = torch.zeros(3, dtype=torch.float64, device=where)

    def add(self, rewards: Tensor, ended: Tensor) -> None:
        """Count some steps of every agent, shape ``(steps, n)``."""
        steps = len(rewards)
        number = torch.arange(1, steps + 1, device=rewards.device)[:, None]
        # An agent's finished episodes together are all that it had up to the last step that ended one.
        last = (ended * number).amax(0, keepdim=True)
        so_far = torch.zeros(2, steps + 1, rewards.shape[1], dtype=torch.float64, device=rewards.device)
        so_far[0, 1:] = rewards
        so_far[1, 1:] = 1
        so_far[:, 0] = self._under_way
        so_far = so_far.cumsum(1)
        until_last = so_far.gather(1, last.expand(2, 1, -1))[:, 0] * (last > 0)
        self._under_way = so_far[:, -1] - until_last
        self._finished[0] += ended.sum()
        self._finished[1:] += until_last.sum(1)

    def take(self) -> dict[str, float | None]:
        """Return means, and the number of episodes, by the names of metrics; and begin anew."""
        episodes, returns, lengths = self._finished.tolist()
        self._finished.zero_()
        return {
            "train_return": returns / episodes if episodes else None,
            "train_length": lengths / episodes if episodes else None,
            "episodes": int(episodes),
        }

    def state(self) -> tuple[Tensor, Tensor]:
        """Return all that the continuation depends on."""
        return self._under_way, self._finished

    def load(self, state: tuple[Tensor, Tensor]) -> None:
        """Go on from what :meth:`state` returned."""
        for mine, kept in zip(self.state(), state, strict=True):
            mine.copy_(kept)


class Trainer:
    """A run of any algorithm: ``iterate`` goes on by one iteration, and ``policy`` is what has been learned.

    Parameters
    ----------
    settings
        The run's.
    agents
        Who gathers: :class:`Agents`, or what else has ``state``, ``load`` and ``identity``.
    where
        The device of torch that has their observations, and on which is learned.
    """

    def __init__(self, settings: Any, agents: Any, where: torch.device) -> None:
        self.settings, self.agents, self.where = settings, agents, where
        self.random = torch.Generator(where).manual_seed(settings.seed)
        self.episodes = Returns(settings.n_agents, where)
        self.learned: dict[str, Any] = {}  # modules and optimisers, by their names in a checkpoint
        self.done = 0  # iterations so far
        self.depth = 1  # steps of every agent in an iteration
        self.evaluated = 1000  # agents whose first episodes are an evaluation, unless said otherwise

    @property
    def agent_steps(self) -> int:
        """Steps of single agents so far."""
        return int(self.done * self.depth * self.settings.n_agents)

    def figures(self) -> dict[str, float | None]:
        """Return figures for the metrics, of episodes since they were last asked for."""
        return self.episodes.take()

    def explore(self, best: Tensor, n_actions: int, share: float) -> Tensor:
        """Return the best actions, of which a share is replaced by random ones."""
        random = torch.rand(len(best), generator=self.random, device=self.where) < share
        anything = torch.randint(n_actions, best.shape, generator=self.random, device=self.where)
        return torch.where(random, anything, best)

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on: tensors and plain data."""
        agents = torch.frombuffer(bytearray(self.agents.state().to_bytes()), dtype=torch.uint8)
        return {
            "done": self.done,
            "random": self.random.get_state(),
            "agents": agents,
            "episodes": self.episodes.state(),
            **{name: part.state_dict() for name, part in self.learned.items()},
        }

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        self.done = state["done"]
        for name, part in self.learned.items():
            part.load_state_dict(state[name])
        self.random.set_state(state["random"])
        self.agents.load(SavedState.from_bytes(state["agents"].numpy().tobytes(), self.agents.identity))
        self.episodes.load(state["episodes"])


class ActorCritic(nn.Module):
    """A policy, and a critic that says what is still to come by it."""

    def __init__(self, spec: EnvSpec, width: int) -> None:
        super().__init__()
        self.continuous = not hasattr(spec.action_space, "n")
        self.policy = NetworkPolicy(spec, "mean" if self.continuous else "logits", width)
        # Of a picture, most of the work is to see what is on it: actor and critic do that together.
        self.shared = self.policy.network.encoder.kind == "picture"
        self.critic: nn.Module = (
            nn.Linear(width, 1) if self.shared else Network(spec.observation_space, 1, width)
        )
        if self.continuous:
            self.log_deviation = nn.Parameter(torch.full((1,), -0.5))

    def see(self, obs: Tensor) -> None:
        """Take a batch of observations into the statistics by which they are standardised."""
        self.policy.network.encoder.see(obs)
        if isinstance(self.critic, Network):
            self.critic.encoder.see(obs)

    def values(self, obs: Tensor) -> Tensor:
        """Return what the critic expects, shape ``(batch,)``."""
        values: Tensor = self.critic(self.policy.network.features(obs) if self.shared else obs)
        return values[:, 0]

    def forward(self, obs: Tensor) -> tuple[Tensor, Tensor]:
        """Return the policy's outputs, and what the critic expects."""
        if not self.shared:
            return self.policy(obs), self.critic(obs)[:, 0]
        features = self.policy.network.features(obs)
        return self.policy.network.output(features), self.critic(features)[:, 0]

    def noise(self, shape: tuple[int, ...], random: torch.Generator) -> Tensor:
        """Return what makes random actions of outputs of that shape: see :meth:`draw`."""
        noise = torch.empty(shape, device=random.device)
        if self.continuous:
            return noise.normal_(generator=random)
        return -noise.exponential_(generator=random).log_()

    def draw(self, outputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions of the policy's probabilities, and as the environment takes them."""
        if self.continuous:
            actions = outputs + self.log_deviation.exp() * noise
            return actions, self.policy.within_bounds(actions)
        # Gumbel's trick: the largest of logits with such noise has the probabilities that these are of.
        actions = (outputs + noise).argmax(-1)
        return actions, actions

    def weigh(self, outputs: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return the logarithms of the actions' probabilities, and the mean entropy."""
        if self.continuous:
            chosen = Normal(outputs, self.log_deviation.exp().expand_as(outputs), validate_args=False)
            logs = chosen.log_prob(actions).sum(-1)  # type: ignore[no-untyped-call]
            return logs, chosen.entropy().sum(-1).mean()  # type: ignore[no-untyped-call]
        everything = outputs.log_softmax(-1)
        logs = everything.gather(-1, actions[..., None])[..., 0]
        return logs, -(everything.exp() * everything).sum(-1).mean()


class Experience(NamedTuple):
    """A rollout, a row a step and a column an agent."""

    obs: Tensor
    actions: Tensor  # of the policy's own form
    logs: Tensor  # logarithms of the actions' probabilities
    advantages: Tensor  # how much better than expected it went
    returns: Tensor  # what came of it
    rewards: Tensor  # as the device had them, and the ends
    ended: Tensor


class RolloutWorker:
    """Gathers with the agents of some blocks, by default all: see :class:`pearl_marl.training.ppo.Settings`.

    The weights of the model, which acts, may change between rollouts.
    """

    def __init__(
        self,
        spec: EnvSpec,
        device: str | Device,
        settings: Any,
        model: ActorCritic,
        blocks: range | None = None,
    ) -> None:
        self.settings, self.model = settings, model
        self.numbers = range(settings.blocks) if blocks is None else blocks
        edges = block_edges(settings, self.numbers)
        self.blocks = [slice(a - edges[0], b - edges[0]) for a, b in itertools.pairwise(edges)]
        self.agents = Agents(spec, device, edges[-1] - edges[0], settings.seed, edges[0])
        self.where = self.agents.obs.device

    @torch.no_grad()
    def gather(self, rollout: int) -> Experience:
        """Step all agents; return the experience of the rollout of that number."""
        settings, agents, model = self.settings, self.agents, self.model
        size = (settings.depth, len(agents.obs), model.policy.outputs)
        noise = torch.empty(size, device=self.where)
        for number, block in zip(self.numbers, self.blocks, strict=True):
            seed = np.random.SeedSequence([settings.seed, rollout, number]).generate_state(1, np.uint64)
            random = torch.Generator(self.where).manual_seed(int(seed[0]) >> 1)
            noise[:, block] = model.noise((size[0], block.stop - block.start, size[2]), random)
        seen, made, taken, steps = [agents.obs], [], [], []
        for t in range(settings.depth):
            outputs = _joined([model.policy(agents.obs[block]) for block in self.blocks])
            actions, given = model.draw(outputs, noise[t])
            steps.append(agents.step(given))
            seen.append(agents.obs)
            made.append(outputs)
            taken.append(actions)
        obs, actions = torch.stack(seen), torch.stack(taken)
        rewards, terminations, truncations = map(torch.stack, list(zip(*steps, strict=True))[1:4])
        logs, _ = model.weigh(torch.stack(made), actions)
        values = _joined([self._values(obs[:, block]) for block in self.blocks], 1)
        wanted = rewards * settings.reward_scale
        cut = truncations & ~terminations
        if cut.any():  # only the time limit ended it: what was to come counts
            final = torch.stack([step.final_obs for step in steps])
            for block in self.blocks:
                rows = cut[:, block].nonzero(as_tuple=True)
                if len(rows[0]):
                    wanted[:, block][rows] += settings.discount * self._values(final[:, block][rows])
        ended = terminations | truncations
        advantages = self._advantages(wanted, values, ended)
        return Experience(obs[:-1], actions, logs, advantages, advantages + values[:-1], rewards, ended)

    def _values(self, obs: Tensor) -> Tensor:
        """Return what the critic expects; ``obs`` may have an axis of steps."""
        one = self.agents.obs.ndim - 1
        leading = obs.shape[: obs.ndim - one]
        rows = obs.reshape(-1, *obs.shape[obs.ndim - one :])
        return torch.cat([self.model.values(part) for part in torch.split(rows, ROWS)]).reshape(leading)

    def _advantages(self, rewards: Tensor, values: Tensor, ended: Tensor) -> Tensor:
        discount, trace = self.settings.discount, self.settings.trace
        going_on = (~ended).float() * discount
        errors = rewards + values[1:] * going_on - values[:-1]
        going_on *= trace
        advantages = torch.empty_like(errors)
        advantage = torch.zeros_like(errors[0])
        for t in reversed(range(len(errors))):
            advantage = torch.addcmul(errors[t], going_on[t], advantage)
            advantages[t] = advantage
        return advantages


def block_edges(settings: Any, blocks: range) -> list[int]:
    """Return the first agent of each of the blocks, and the end of the last."""
    return [number * settings.n_agents // settings.blocks for number in (*blocks, blocks.stop)]


def _joined(parts: list[Tensor], axis: int = 0) -> Tensor:
    return parts[0] if len(parts) == 1 else torch.cat(parts, axis)
