"""Stable-Baselines3's PPO and DQN, mostly on EnvPool, with our settings as far as it has them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize
from torch import Tensor, nn

from pearl_marl.benchmark.peers import envpool_of, quiet_spaces
from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.benchmark.watch import Watch
from pearl_marl.wrappers import sb3_vec_env

from . import worlds


class EnvPoolVecEnv(VecEnv):
    """EnvPool's environments for Stable-Baselines3. Those that ended are reset at once, all in one call.

    Parameters
    ----------
    envs
        EnvPool's environments of the type ``"gymnasium"``, all in one batch.
    n
        How many.
    """

    def __init__(self, envs: Any, n: int) -> None:
        self._envs = envs
        with quiet_spaces():
            super().__init__(n, envs.observation_space, envs.action_space)
        self._actions = np.zeros(n, envs.action_space.dtype)

    def reset(self) -> Any:
        """Return the first observations."""
        return self._envs.reset()[0]

    def step_async(self, actions: Any) -> None:
        """Keep the actions."""
        self._actions = actions.astype(self._actions.dtype)

    def step_wait(self) -> Any:
        """Step all; return observations, rewards, ends and infos."""
        obs, rewards, terminations, truncations, _ = self._envs.step(self._actions)
        ended = terminations | truncations
        infos: list[dict[str, Any]] = [{}] * self.num_envs
        slots = np.flatnonzero(ended)
        if slots.size:
            obs = obs.copy()
            for slot in slots:
                cut = bool(truncations[slot] and not terminations[slot])
                infos[slot] = {"terminal_observation": obs[slot].copy(), "TimeLimit.truncated": cut}
            obs[slots] = self._envs.reset(slots.astype(np.int32))[0]
        return obs, rewards.astype(np.float32), ended, infos

    def close(self) -> None:
        """Close them."""
        self._envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, the same for every environment."""
        return [getattr(self._envs, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: EnvPool's environments have none to be set."""
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refuse: EnvPool's environments have no methods of their own."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return that none is."""
        return [False] * self.num_envs


class Picture(BaseFeaturesExtractor):
    """Our network for pictures of MinAtar's size, up to the layers that give actions and values."""

    def __init__(self, space: Any, width: int) -> None:
        super().__init__(space, width)
        height, breadth, channels = space.shape
        self.convolution = nn.Sequential(nn.Conv2d(channels, 16, 3), nn.ReLU(), nn.Flatten())
        size = 16 * (height - 2) * (breadth - 2)
        self.dense = nn.Sequential(nn.Linear(size, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())

    def forward(self, pictures: Tensor) -> Tensor:
        """Return features."""
        features: Tensor = self.dense(self.convolution(pictures.permute(0, 3, 1, 2)))
        return features


class Watched(BaseCallback):
    """Calls a watch after every iteration, and ends the training when the watch says so."""

    def __init__(self, watch: Watch, choose: Callable[..., Any]) -> None:
        super().__init__()
        self.watch, self.choose, self.over = watch, choose, False

    def _on_training_start(self) -> None:
        self.watch.start()

    def _on_rollout_start(self) -> None:  # what was gathered before has been learned from
        if self.num_timesteps:
            self.over = self.watch(self.num_timesteps, self.choose)

    def _on_step(self) -> bool:
        return not self.over

    def _on_training_end(self) -> None:
        if not self.over:
            self.watch(self.num_timesteps, self.choose)


def environments(task: TrainingTask, n: int, seed: int) -> VecEnv:
    """Return EnvPool's environments; where its rules are others, our worlds or MinAtar's own games."""
    oracle = task.spec.oracle or ""
    if "MinAtar" in oracle:
        env: VecEnv = DummyVecEnv([partial(gymnasium.make, oracle)] * n)
        env.seed(seed)
        return env
    if task.spec.agents > 1:
        env = sb3_vec_env(worlds.environments(task, n))
        env.seed(seed)
    else:
        env = EnvPoolVecEnv(envpool_of(task.spec, n, seed), n)
    vector = not isinstance(env.observation_space, Discrete)
    return VecNormalize(env, norm_reward=False) if vector else env


def train(task: TrainingTask, settings: Any, watch: Watch) -> None:
    """Train until the watch says that it is over."""
    env = environments(task, settings.n_agents, settings.seed)
    network: dict[str, Any] = {"net_arch": [settings.width] * 2, "activation_fn": nn.Tanh}
    if len(env.observation_space.shape or ()) == 3:
        extractor = {
            "features_extractor_class": Picture,
            "features_extractor_kwargs": {"width": settings.width},
        }
        network = {"net_arch": [], **extractor}
    steps = settings.n_agents * settings.iterations
    if task.algorithm == "ppo":
        steps *= settings.rollout_length
    common = {"policy_kwargs": network, "seed": settings.seed, "device": "cpu"}
    choose: Callable[..., Any]
    if task.spec.agents > 1:
        from sb3_contrib import MaskablePPO

        model: Any = _ppo(env, settings, common, MaskablePPO)
        choose = team_actions(model, task.spec.agents, settings.temperature)
    else:
        model = {"ppo": _ppo, "dqn": _dqn}[task.algorithm](env, settings, common)
        choose = best_actions(model)

    try:
        model.learn(steps, callback=Watched(watch, choose))
    finally:
        env.close()


def best_actions(model: Any) -> Callable[[Any], Any]:
    """Return a function from observations, as environments return them, to a model's best actions."""

    def choose(obs: Any) -> Any:
        normalise = model.get_vec_normalize_env()
        return model.predict(normalise.normalize_obs(obs) if normalise else obs, deterministic=True)[0]

    return choose


def team_actions(model: Any, agents: int, temperature: float) -> Callable[[Any, Any], Any]:
    """Return a function from what worlds return, with masks, to actions: drawn, if there is a temperature."""

    def choose(obs: Any, masks: Any) -> Any:
        rows = model.get_vec_normalize_env().normalize_obs(worlds.indicated(obs, agents))
        return model.predict(rows, deterministic=not temperature, action_masks=masks)[0]

    return choose


def _ppo(env: VecEnv, settings: Any, common: dict[str, Any], kind: type[Any] = PPO) -> Any:
    return kind(
        "MlpPolicy",
        env,
        n_steps=settings.rollout_length,
        batch_size=settings.minibatch,
        n_epochs=settings.epochs,
        learning_rate=lambda left: settings.learning_rate * left,
        gamma=settings.discount,
        gae_lambda=settings.gae_lambda,
        clip_range=settings.clip,
        ent_coef=settings.entropy,
        **common,
    )


def _dqn(env: VecEnv, settings: Any, common: dict[str, Any]) -> DQN:
    n = settings.n_agents
    return DQN(
        "MlpPolicy",
        env,
        train_freq=1,
        gradient_steps=settings.updates,
        batch_size=settings.minibatch,
        learning_rate=settings.learning_rate,
        gamma=settings.discount,
        learning_starts=settings.warm_up * n,
        buffer_size=settings.memory * n,
        exploration_initial_eps=settings.epsilon,
        exploration_final_eps=settings.final_epsilon,
        exploration_fraction=settings.exploration_fraction,
        target_update_interval=max(settings.target_update // settings.updates, 1) * n,
        **common,
    )
