"""PPO as CleanRL writes it, mostly on EnvPool: one file from top to bottom, and nothing hidden.

Written after the algorithm of CleanRL's ``ppo_atari_envpool.py`` (Huang et al., 2022, JMLR 23:274), with its
details: orthogonal weights, Adam with an epsilon of 1e-5, a learning rate that falls evenly, advantages
normalised in each minibatch, gradients clipped. The step in which an environment starts over counts like any
other, and a time limit is an end like any other. As with ours, values are not clipped (its
``--no-clip-vloss``) and their squared errors have a weight of 1/2 (its ``--vf-coef 1``).
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Discrete
from gymnasium.wrappers.utils import RunningMeanStd
from torch import Tensor, nn
from torch.distributions import Categorical

from pearl_marl.benchmark.peers import envpool_of, quiet_spaces
from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.benchmark.watch import Watch

from . import worlds


class Normalised(RunningMeanStd):
    """Standardises vectors by the statistics of all before, as Gymnasium's wrapper does."""

    def __call__(self, obs: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return a batch standardised."""
        scaled: npt.NDArray[Any] = (obs - self.mean) / np.sqrt(self.var + 1e-8)
        return scaled.clip(-10, 10).astype(np.float32)


def layer(inputs: int, outputs: int, deviation: float = math.sqrt(2)) -> nn.Linear:
    """Return a linear layer with orthogonal weights."""
    made = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(made.weight, deviation)
    nn.init.zeros_(made.bias)
    return made


class Channels(nn.Module):
    """Moves the channels of pictures to the front."""

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the pictures with channels first."""
        return pictures.permute(0, 3, 1, 2)


class Agent(nn.Module):
    """Actor and critic: separate for vectors and numbers, with a shared convolution for pictures."""

    def __init__(self, shape: tuple[int, ...], actions: int, width: int) -> None:
        super().__init__()
        if len(shape) == 3:
            height, breadth, channels = shape
            self.shared: nn.Module = nn.Sequential(
                *(Channels(), nn.Conv2d(channels, 16, 3), nn.ReLU(), nn.Flatten()),
                *(layer(16 * (height - 2) * (breadth - 2), width), nn.ReLU()),
                *(layer(width, width), nn.ReLU()),
            )
            self.actor: nn.Module = layer(width, actions, 0.01)
            self.critic: nn.Module = layer(width, 1, 1.0)
            return
        self.shared = nn.Identity()
        self.actor, self.critic = (
            nn.Sequential(
                *(layer(shape[0], width), nn.Tanh(), layer(width, width), nn.Tanh()),
                layer(width, outputs, deviation),
            )
            for outputs, deviation in ((actions, 0.01), (1, 1.0))
        )

    def value(self, obs: Tensor) -> Tensor:
        """Return what the critic expects."""
        values: Tensor = self.critic(self.shared(obs))
        return values[:, 0]

    def logits(self, features: Tensor, masks: Tensor | None = None) -> Tensor:
        """Return those of the actions; an action that may not be taken has practically no probability."""
        found: Tensor = self.actor(features)
        return found if masks is None else found.masked_fill(masks == 0, -1e8)

    def forward(
        self, obs: Tensor, masks: Tensor | None, actions: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return actions, drawn unless given, their log-probabilities, entropies, and values."""
        features = self.shared(obs)
        chances = Categorical(logits=self.logits(features, masks))
        if actions is None:
            actions = chances.sample()  # type: ignore[no-untyped-call]
        logs = chances.log_prob(actions)  # type: ignore[no-untyped-call]
        return actions, logs, chances.entropy(), self.critic(features)[:, 0]  # type: ignore[no-untyped-call]


class Worlds:
    """The agents of our worlds as Gymnasium's vector environments, with masks of their actions."""

    def __init__(self, env: Any, seed: int) -> None:
        self.env, self.seed = env, seed
        self.observation_space, self.action_space = env.batch.observation_space, env.batch.action_space

    def reset(self) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Return the first observations; and in a dict, masks, as :meth:`step` does."""
        return self.env.reset_batch(self.seed), {"masks": self.env.action_masks}

    def step(self, actions: npt.NDArray[Any]) -> tuple[Any, ...]:
        """Step all; return what Gymnasium's environments do."""
        return *self.env.step_batch(actions)[:4], {"masks": self.env.action_masks}


def environments(task: TrainingTask, n: int, seed: int) -> Any:
    """Return EnvPool's environments; where its rules are others, our worlds or MinAtar's own games."""
    if task.spec.agents > 1:
        return Worlds(worlds.environments(task, n), seed)
    oracle = task.spec.oracle or ""
    if "MinAtar" not in oracle:
        return envpool_of(task.spec, n, seed)
    envs = gymnasium.make_vec(oracle, num_envs=n, vectorization_mode="sync")
    envs.reset(seed=seed)
    return envs


def masks_in(infos: Any) -> Tensor | None:
    """Return which actions may be taken, or None where all may."""
    masks = infos.get("masks")
    return None if masks is None else torch.from_numpy(masks)


def train(task: TrainingTask, settings: Any, watch: Watch) -> None:
    """Train until the watch says that it is over."""
    n, depth, width = settings.n_agents, settings.rollout_length, settings.width
    batch = n * depth
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    envs = environments(task, n, settings.seed)
    with quiet_spaces():
        space: Any = getattr(envs, "single_observation_space", None) or envs.observation_space
        actions_space: Any = getattr(envs, "single_action_space", None) or envs.action_space
    update = None
    if isinstance(space, Discrete):
        rows, shape = np.eye(int(space.n), dtype=np.float32), (int(space.n),)
        prepared: Any = rows.__getitem__
    elif len(space.shape) == 3:
        shape, prepared = space.shape, lambda obs: obs.astype(np.float32)
    else:
        shape, prepared = space.shape, Normalised(shape=space.shape)  # type: ignore[no-untyped-call]
        update = prepared.update
    agent = Agent(shape, int(actions_space.n), width)
    optimiser = torch.optim.Adam(agent.parameters(), lr=settings.learning_rate, eps=1e-5)

    obs = torch.zeros((depth, n, *shape))
    actions = torch.zeros((depth, n), dtype=torch.int64)
    logs, rewards, dones, values = (torch.zeros((depth, n)) for _ in range(4))
    observed, infos = envs.reset()
    if update:
        update(observed)
    next_obs, next_done = torch.from_numpy(prepared(observed)), torch.zeros(n)
    next_masks = masks_in(infos)
    masks = None if next_masks is None else next_masks.expand(depth, -1, -1).clone()

    def choose(observations: npt.NDArray[Any], allowed: npt.NDArray[Any] | None = None) -> npt.NDArray[Any]:
        if task.spec.agents > 1:
            observations = worlds.indicated(observations, task.spec.agents)
        with torch.no_grad():
            features = agent.shared(torch.from_numpy(prepared(observations)))
            logits = agent.logits(features, None if allowed is None else torch.from_numpy(allowed))
            drawn: Tensor = Categorical(logits=logits).sample()  # type: ignore[no-untyped-call]
            chosen = drawn if settings.temperature else logits.argmax(1)
        found: npt.NDArray[Any] = chosen.numpy()
        return found

    watch.start()
    for iteration in range(settings.iterations):
        optimiser.param_groups[0]["lr"] = settings.learning_rate * (1 - iteration / settings.iterations)
        for t in range(depth):
            obs[t], dones[t] = next_obs, next_done
            if masks is not None and next_masks is not None:
                masks[t] = next_masks
            with torch.no_grad():
                actions[t], logs[t], _, values[t] = agent(next_obs, next_masks)
            taken = actions[t].numpy().astype(actions_space.dtype)
            observed, reward, terminations, truncations, infos = envs.step(taken)
            if update:
                update(observed)
            rewards[t] = torch.from_numpy(np.asarray(reward, np.float32)) * settings.reward_scale
            next_obs = torch.from_numpy(prepared(observed))
            next_done = torch.from_numpy((terminations | truncations).astype(np.float32))
            next_masks = masks_in(infos)

        with torch.no_grad():
            following, done, gain = agent.value(next_obs), next_done, torch.zeros(n)
            gains = torch.zeros((depth, n))
            for t in reversed(range(depth)):
                surprise = rewards[t] + settings.discount * following * (1 - done) - values[t]
                gain = surprise + settings.discount * settings.gae_lambda * (1 - done) * gain
                gains[t], following, done = gain, values[t], dones[t]
            returns = gains + values

        flat = [array.flatten(0, 1) for array in (obs, actions, logs, gains, returns)]
        flat_masks = None if masks is None else masks.flatten(0, 1)
        order = np.arange(batch)
        for _ in range(settings.epochs):
            rng.shuffle(order)
            for start in range(0, batch, settings.minibatch):
                some = torch.from_numpy(order[start : start + settings.minibatch])
                some_obs, some_actions, old, some_gains, some_returns = (array[some] for array in flat)
                some_masks = None if flat_masks is None else flat_masks[some]
                _, new, entropy, expected = agent(some_obs, some_masks, some_actions)
                ratio = (new - old).exp()
                scaled = (some_gains - some_gains.mean()) / (some_gains.std() + 1e-8)
                clipped = ratio.clamp(1 - settings.clip, 1 + settings.clip)
                policy_loss = torch.max(-scaled * ratio, -scaled * clipped).mean()
                value_loss = 0.5 * ((expected - some_returns) ** 2).mean()
                loss = policy_loss - settings.entropy * entropy.mean() + value_loss
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimiser.step()
        if watch((iteration + 1) * batch, choose):
            return
