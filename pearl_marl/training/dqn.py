"""Deep Q-learning, one network for all agents (Mnih et al., 2015, doi:10.1038/nature14236).

With double estimation (van Hasselt et al., 2016, arXiv:1509.06461). All agents explore at once, and the
replay memory holds their last steps. In worlds it is independent Q-learning (IQL): to an agent, the others
are part of the environment.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import huber_loss

from pearl_marl.errors import ArgumentError
from pearl_marl.policies.network import is_dense
from pearl_marl.policies.trained import NetworkPolicy
from pearl_marl.spec import MAX_SLOTS, EnvSpec
from pearl_marl.training.action_values import explored
from pearl_marl.training.adam import Adam
from pearl_marl.training.agents import Agents, team_rewards
from pearl_marl.training.dense_values import Steps, huber_gradients_of
from pearl_marl.training.restoring import copied, observed, whole
from pearl_marl.training.settings import NetworkSettings, check_memory, count, number
from pearl_marl.training.trainer import Trainer


class Minibatch(NamedTuple):
    """Some steps of single agents, a row for each."""

    obs: Tensor
    actions: Tensor
    rewards: Tensor
    arrivals: Tensor  # observations of where the step led
    over: Tensor  # whether the episode ended there
    alive: Tensor  # whether the agent took part in the step
    position: Tensor  # of the agent in its world
    masks: Tensor | None = None  # of the actions that were allowed there, where the environment has any


@dataclass(frozen=True, kw_only=True)
class DQNSettings(NetworkSettings):
    """What a run of DQN depends on beside :class:`NetworkSettings`, each said beside its default."""

    n_agents: int = count(512, most=MAX_SLOTS)  # that gather experience
    iterations: int = count(1000)  # steps of every agent
    memory: int = count(200)  # how many of every agent's last steps are kept
    warm_up: int = count(10, least=0)  # steps of every agent before the first update
    updates: int = count(4)  # after each step of all agents
    minibatch: int = count(256)  # how many single steps an update learns from
    learning_rate: float = number(2e-3, most=1, above=True)  # of Adam
    discount: float = number(0.99, most=1)  # gamma
    target_update: int = count(50, formerly="refresh")  # updates between two copies into the target network
    epsilon: float = number(1.0, most=1, formerly="explore_first")  # share of random actions at first
    final_epsilon: float = number(0.02, most=1, formerly="explore_last")  # and at last
    # The part of the run in which it falls.
    exploration_fraction: float = number(0.2, most=1, above=True, formerly="exploring")
    # Share of random actions where the trained policy is used.
    evaluation_epsilon: float = number(0.0, most=1, formerly="chance")


class DQN(Trainer):
    """A run of DQN: :meth:`iterate` is a step of all agents with its updates."""

    def __init__(self, spec: EnvSpec, device: Any, settings: DQNSettings) -> None:
        n, depth = settings.n_agents, settings.memory
        if spec.turns:
            raise ArgumentError(
                f"dqn learns from every step, and in {spec.name} agents take turns: use self-play"
            )
        # Of every step in memory, and of every one in a minibatch: two observations, action, reward and end.
        rows = n * depth + settings.minibatch
        grows_with = "n_agents", "memory", "minibatch"
        self.need = check_memory(spec, settings, device, grows_with, 2 * rows, 13 * rows)
        torch.manual_seed(settings.seed)
        self.policy = NetworkPolicy(
            spec, "values", settings.width, settings.sharing, epsilon=settings.evaluation_epsilon
        )
        self.target = NetworkPolicy(spec, "values", settings.width, settings.sharing)
        agents = Agents(spec, device, n, settings.seed)
        obs, masks, where = agents.obs, agents.inputs.masks, agents.obs.device
        super().__init__(settings, agents, where)
        self.policy.to(where)
        self.target.to(where)
        self.target.load_state_dict(self.policy.state_dict())
        self.optimiser = Adam(self.policy.parameters(), epsilon=1e-8, max_grad_norm=10.0)
        self.components = {"policy": self.policy, "target": self.target, "optimiser": self.optimiser}
        self.losses: list[Tensor] = []
        # A row for each step, and a column for each agent: see Minibatch.
        self.memory = {
            "obs": obs.new_zeros((depth, *obs.shape)),
            "actions": torch.zeros((depth, n), dtype=torch.int64, device=where),
            "rewards": torch.zeros((depth, n), device=where),
            "arrivals": obs.new_zeros((depth, *obs.shape)),
            "over": torch.zeros((depth, n), dtype=torch.bool, device=where),
            "alive": torch.ones((depth, n), dtype=torch.bool, device=where),
        }
        if masks is not None:
            self.memory["masks"] = masks.new_zeros((depth, *masks.shape))
        self.updated = 0

    def update(self) -> None:
        """Step all agents and learn."""
        self._step()
        if self.done > self.settings.warm_up:
            self.losses = [self.learn() for _ in range(self.settings.updates)]
            self.check(torch.stack(self.losses))

    def figures(self) -> dict[str, float | None]:
        """Return figures for the metrics: of episodes since they were last asked for, and the last losses."""
        loss = torch.stack(self.losses).mean().item() if self.losses else None
        return {**super().figures(), "loss": loss, "explored": self.explored}

    @property
    def explored(self) -> float:
        """The share of actions that is random now."""
        return explored(self.settings, self.done / self.settings.iterations)

    def _step(self) -> None:
        agents, inputs = self.agents, self.agents.inputs
        self.policy.network.see(inputs.obs, inputs.position)
        best = self.policy.best(inputs.obs, inputs.masks)
        actions = self.explore(best, self.policy.outputs, self.explored, inputs.masks)
        self._remember(obs=inputs.obs, actions=actions, alive=agents.alive)
        step = agents.step(actions)
        self.episodes.add(step.rewards[None], step.ended[None])
        rewards = team_rewards(step.rewards, agents.spec.agents, self.settings.rewards)
        rewards = rewards * self.settings.reward_scale
        self._remember(rewards=rewards, arrivals=step.arrivals(), over=step.terminations)
        if agents.inputs.masks is not None:
            # Where a time limit cut an episode short, the device does not tell the masks: all are allowed.
            self._remember(masks=agents.inputs.masks.masked_fill(step.ended[:, None], 1))
        self.done += 1

    def _remember(self, **tensors: Tensor) -> None:
        for name, tensor in tensors.items():
            self.memory[name][self.done % self.settings.memory] = tensor

    def learn(self) -> Tensor:
        """Learn from a minibatch of the memory; return the loss."""
        settings = self.settings
        rows = min(self.done, settings.memory)
        chosen = torch.randint(
            rows * settings.n_agents, (settings.minibatch,), generator=self.random, device=self.where
        )
        picked = {
            name: tensor[:rows].reshape(-1, *tensor.shape[2:])[chosen] for name, tensor in self.memory.items()
        }
        position = chosen % settings.n_agents % self.agents.spec.agents
        minibatch = Minibatch(**picked, position=position)
        gradients = self.compiled_gradients if is_dense(self.policy.network) else self.gradients
        loss = gradients(minibatch)
        self.optimiser.step(settings.learning_rate)
        self.updated += 1
        if self.updated % settings.target_update == 0:
            self.target.load_state_dict(self.policy.state_dict())
        return loss

    def gradients(self, minibatch: Minibatch) -> Tensor:
        """Leave the gradients of a minibatch's loss with the parameters; return the loss."""
        obs, actions, rewards, arrivals, over, alive, position, masks = minibatch
        with torch.no_grad():
            best = self.policy(arrivals, masks, position).argmax(1, keepdim=True)
            later = self.target(arrivals, None, position).gather(1, best)[:, 0]
            targets = rewards + self.settings.discount * later * ~over
        values = self.policy(obs, None, position).gather(1, actions[:, None])[:, 0]
        losses = huber_loss(values, targets, reduction="none") * alive
        loss = losses.sum() / alive.sum().clamp(1)
        self.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        return loss.detach()

    def compiled_gradients(self, minibatch: Minibatch) -> Tensor:
        """Do the same by compiled loops, for networks that these can do."""
        obs, actions, rewards, arrivals, over, alive, position, masks = minibatch
        network, target = self.policy.network, self.target.network
        if masks is None:
            masks = torch.empty(0, self.policy.outputs, dtype=torch.int8)
        loss = huber_gradients_of()(
            network.layers(),
            target.layers(),
            network.layers({parameter: parameter.grad for parameter in network.parameters()}),
            network.observed(obs, position),
            network.observed(arrivals, position),
            target.observed(arrivals, position),
            Steps(*(tensor.numpy() for tensor in (actions, rewards, over, alive, masks))),
            self.settings.discount,
        )
        return torch.tensor(loss)

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on."""
        return {**super().state(), "updated": self.updated, "memory": self.memory}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        super().load(state)
        self.updated = whole("number of updates", state["updated"])
        for name, rows in self.memory.items():
            kept = state["memory"][name]
            if name in ("obs", "arrivals"):
                observed(f"memory of {name}", rows, kept, self.done, self.policy.spec)
            else:
                bounds = {"actions": (0, self.policy.outputs - 1), "masks": (0, 1)}.get(name, (None, None))
                copied(f"memory of {name}", rows, kept, *bounds)
