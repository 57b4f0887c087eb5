"""BenchMARL's IPPO, MAPPO, VDN and QMIX on our worlds, with our settings as far as it has them."""

from __future__ import annotations

import contextlib
import operator
import tempfile
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from benchmarl.algorithms import IppoConfig, MappoConfig, QmixConfig, VdnConfig
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.benchmark.watch import Watch
from pearl_marl.spec import EnvSpec
from pearl_marl.training.run import ALGORITHMS as TRAINERS
from pearl_marl.wrappers import agent_indicator_v0, benchmarl_task, dtype_v0, reward_lambda_v0

from .worlds import indicated

ALGORITHMS: dict[str, Any] = {"ppo": IppoConfig, "mappo": MappoConfig, "vdn": VdnConfig, "qmix": QmixConfig}
ON_POLICY = ("ppo", "mappo")
MEMORY = 50
"""Of how many rollouts the off-policy algorithms keep the samples."""


class Over(Exception):  # noqa: N818  # no error
    """The watch says that the training is over; BenchMARL has no other way to end one."""


class WatchCallback(Callback):  # type: ignore[misc]  # benchmarl has no types
    """Calls a watch after every iteration."""

    def __init__(self, watch: Watch, spec: EnvSpec, settings: Any) -> None:
        super().__init__()
        self.watch, self.spec, self.settings = watch, spec, settings

    def on_train_end(self, training_td: Any, group: str) -> None:
        """Count an iteration: all agents of a world are one group."""
        steps = self.experiment.total_frames * self.spec.agents
        if self.watch(steps, actions(self.experiment.policy, group, self.spec, self.settings)):
            raise Over


def actions(policy: Any, group: str, spec: EnvSpec, settings: Any) -> Callable[[Any], Any]:
    """Return a function from observations and masks, as environments return them, to actions.

    They are as random as our settings say: drawn from the policy if it has a temperature.
    """
    sampled = getattr(settings, "temperature", 0.0) > 0
    epsilon = getattr(settings, "evaluation_epsilon", 0.0)
    random = torch.Generator().manual_seed(settings.seed)
    space: Any = spec.action_space

    def choose(obs: Any, masks: Any = None) -> Any:
        worlds = len(obs) // spec.agents
        shape = worlds, spec.agents
        seen = {"observation": torch.from_numpy(indicated(obs, spec.agents)).reshape(*shape, -1)}
        possible = torch.ones((len(obs), int(space.n)), dtype=torch.bool)
        if masks is not None:
            possible = torch.as_tensor(masks, dtype=torch.bool)
            seen["action_mask"] = possible.reshape(*shape, -1)
        kind = ExplorationType.RANDOM if sampled else ExplorationType.DETERMINISTIC
        with torch.no_grad(), set_exploration_type(kind):
            data = policy(TensorDict({group: TensorDict(seen, shape)}, (worlds,)))
        chosen = data[group, "action"].reshape(-1)
        others = torch.multinomial(possible.float(), 1, generator=random)[:, 0]
        return torch.where(torch.rand(len(obs), generator=random) < epsilon, others, chosen).numpy()

    return choose


def in_floats(env: Any, scale: float) -> Any:
    """Return an environment whose agents are told who they are, with our scale of rewards."""
    return reward_lambda_v0(dtype_v0(agent_indicator_v0(env), np.float32), partial(operator.mul, scale))


def train(task: TrainingTask, settings: Any, watch: Watch) -> None:
    """Train until the watch says that it is over."""
    spec = task.spec
    algorithm = ALGORITHMS[task.algorithm].get_from_yaml()
    if task.algorithm in ON_POLICY:
        algorithm.clip_epsilon, algorithm.lmbda = settings.clip, settings.gae_lambda
        algorithm.entropy_coef, algorithm.critic_coef = settings.entropy, 0.5
    if task.algorithm == "qmix":
        algorithm.mixing_embed_dim = settings.mixer_width
    # Its teams get the mean of their agents' rewards.
    scale = settings.reward_scale * (spec.agents if settings.rewards == "sum" else 1)
    layers = MlpConfig.get_from_yaml()
    layers.num_cells = [settings.width] * 2
    # TorchRL and BenchMARL warn of their own coming changes.
    with warnings.catch_warnings(action="ignore"), tempfile.TemporaryDirectory() as folder:
        experiment = Experiment(
            task=benchmarl_task(
                task.env_id,
                state=task.algorithm in ("mappo", "qmix"),
                wrap=partial(in_floats, scale=scale),
                max_cycles=spec.max_cycles,
                **dict(task.options),
            ),
            algorithm_config=algorithm,
            model_config=layers,
            critic_model_config=layers,
            seed=settings.seed,
            config=configured(task, settings, folder),
            callbacks=[WatchCallback(watch, spec, settings)],
        )
        watch.start()
        with contextlib.suppress(Over):
            experiment.run()


def configured(task: TrainingTask, settings: Any, folder: str) -> ExperimentConfig:
    """Return our settings as BenchMARL's, which count steps of worlds, and no logs."""
    config, spec = ExperimentConfig.get_from_yaml(), task.spec
    config.clip_grad_val, config.adam_eps = TRAINERS[task.algorithm].max_grad_norm, 1e-5
    config.loggers, config.create_json, config.evaluation, config.render = [], False, False, False
    config.save_folder = folder
    config.max_n_frames, config.max_n_iters = None, settings.iterations
    config.lr, config.gamma = settings.learning_rate, settings.discount
    worlds, minibatch = settings.n_agents // spec.agents, settings.minibatch // spec.agents
    batch = worlds * settings.rollout_length
    config.on_policy_n_envs_per_worker = config.off_policy_n_envs_per_worker = worlds
    config.on_policy_collected_frames_per_batch = config.off_policy_collected_frames_per_batch = batch
    config.on_policy_minibatch_size = config.off_policy_train_batch_size = minibatch
    config.on_policy_n_minibatch_iters = settings.epochs
    config.off_policy_n_optimizer_steps = settings.epochs * batch // minibatch
    config.off_policy_memory_size = MEMORY * batch
    config.exploration_eps_init = getattr(settings, "epsilon", 1.0)
    config.exploration_eps_end = getattr(settings, "final_epsilon", 0.0)
    share = getattr(settings, "exploration_fraction", 1.0)
    config.exploration_anneal_frames = round(share * batch * settings.iterations)
    return config
