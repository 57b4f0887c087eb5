"""Stable-Baselines3's ``VecEnv`` around an environment of either interface."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np
from gymnasium.spaces import Discrete, MultiBinary, MultiDiscrete, Space, Tuple
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from pearl_marl.base.arrays import Array
from pearl_marl.base.deferral import uninterrupted
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.batch.step import BatchStep
from pearl_marl.checks import checked_flag
from pearl_marl.devices.by_name import make_host_device
from pearl_marl.errors import ArgumentError, OrderError
from pearl_marl.evaluation.episodes import RunningEpisodes
from pearl_marl.interfaces.batch import Batch
from pearl_marl.interfaces.parallel import PearlParallelEnv
from pearl_marl.interfaces.vector import PearlVectorEnv

from .base import differing

RENDERED_SLOTS = 16
"""The most slots that ``render`` draws: Gymnasium's renderers take milliseconds for each."""


def sb3_vec_env(env: Any, *, staggered: bool = False) -> PearlVecEnv:
    """Make a Stable-Baselines3 ``VecEnv`` of an environment.

    Parameters
    ----------
    env
        Of :func:`pearl_marl.parallel_env` with ``autoreset=True``, or of :func:`pearl_marl.make_vec` in
        SAME_STEP mode; wrapped or not.
    staggered
        Whether first episodes are cut short, each slot's at another step, so that a time limit does not
        end all episodes at once: SB3 takes some 0.25 ms for each, one after the other.

    Raises
    ------
    ArgumentError
        The environment does not start its slots over as SB3 expects, or there is no time limit to stagger.
    """
    return PearlVecEnv(env, staggered)


class PearlVecEnv(VecEnv):
    """The agents of one environment as a Stable-Baselines3 ``VecEnv``; made by :func:`sb3_vec_env`.

    Each agent is an environment to SB3, whose policy all of them share. One that ended before its world sees
    zeros until that starts over, and is done once more then. Masks are not observed: ``MaskablePPO`` of
    sb3-contrib asks for them.

    Observations are arrays of the device's, which later steps leave alone. Observations in a ``Tuple``
    of ``Discrete`` spaces, which SB3 has not, become ``MultiDiscrete``. Rewards are ``float32``.

    ``infos`` of slots whose episode ended hold ``terminal_observation``, the last of that episode;
    ``TimeLimit.truncated``, whether nothing but the time limit ended it; and ``episode``, what SB3's
    ``Monitor`` says of it: return ``r``, length ``l``, seconds ``t`` since the start. The first episodes of
    ``staggered`` slots, which are cut, have no ``episode``, so that neither ``evaluate_policy`` nor SB3's own
    figures count them. Other slots' infos are empty. Each slot's is a dict of its own in every step.
    """

    def __init__(self, env: Any, staggered: bool = False) -> None:
        self._batch = batch = _checked(env)
        self.env = env
        self._show, observation_space = _observations_for_sb3(batch.observation_space)
        super().__init__(batch.batch_size, observation_space, batch.action_space)
        self.metadata = env.metadata  # whose render_fps films go by
        device = make_host_device(batch.innermost.device)
        if checked_flag("staggered", staggered) and not device.config.limit:
            raise ArgumentError(
                "staggered=True spreads a time limit, and this environment has none (max_cycles=0): "
                "leave it out, or make the environment with max_cycles"
            )
        self._staggered = staggered
        # Whose episode has less than the time limit to go.
        self._cut = np.zeros(self.num_envs, np.bool_)
        # SB3 looks at the observations of one step when it has taken the next.
        self._reused = not device.config.copy
        self._next_seed: int | None = None
        self._actions: Array | None = None
        self._began = time.time()
        self._episodes = RunningEpisodes(self.num_envs)

    # As of the environment inside: two that share it would step each other's slots.
    __copy__ = deepcopy

    @uninterrupted
    def reset(self) -> Array:
        """Begin an episode in every slot; return observations of shape ``(num_envs, ...)``."""
        obs = self.env.reset_batch(self._next_seed)
        self._next_seed = self._actions = None
        if self._staggered:
            self._stagger()
        self._episodes.clear()
        self._reset_seeds()
        return self._own(obs)

    @uninterrupted
    def step_async(self, actions: Array) -> None:
        """Take up actions of shape ``(num_envs, ...)``; :meth:`step_wait` steps."""
        self._actions = actions

    @uninterrupted
    def step_wait(self) -> VecEnvStepReturn:
        """Step every slot once.

        Returns
        -------
        Observations, rewards (``float32``), whether the episode ended (``bool``), and infos.

        Raises
        ------
        ActionError
            Names the first agent whose action is not in the action space. Nothing has stepped.
        """
        if self._actions is None:
            raise OrderError("step_wait() without a step under way: call step_async(actions) first")
        actions, self._actions = self._actions, None
        if isinstance(self.action_space, MultiBinary):
            actions = _flags(actions)
        over = ~self._batch.in_episode if self._batch.world.agents > 1 else np.False_
        step = self._batch.step_batch(actions)
        dones = step.ended | (over & step.in_episode) if over.any() else step.ended
        return self._own(step.obs), step.rewards, dones, self._infos(step)

    def _infos(self, step: BatchStep) -> list[dict[str, Any]]:
        """Count a step; return what SB3 is told of the episodes that it ended."""
        # One of each slot's own, in every step: wrappers write into them, and SB3 keeps them.
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = self._episodes.add(step)
        if not ended.slots.size:
            return infos
        seconds = round(time.time() - self._began, 6)
        finals = self._show(step.final_obs[ended.slots])
        columns = [column.tolist() for column in ended]
        for final, slot, total, length, truncated in zip(finals, *columns, strict=True):
            infos[slot].update({"terminal_observation": final, "TimeLimit.truncated": truncated})
            if not self._cut[slot]:
                infos[slot]["episode"] = {"r": total, "l": length, "t": seconds}
        self._cut[ended.slots] = False
        return infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the next :meth:`reset`.

        One seed serves the whole batch: slots draw different numbers from it. ``None`` takes one from
        ``numpy.random``, as SB3 does. Returns the seed once for each slot.
        """
        if seed is None:
            seed = int(np.random.randint(0, np.iinfo(np.uint32).max, dtype=np.uint32))  # noqa: NPY002
        self._next_seed = seed
        self._seeds = [seed] * self.num_envs
        return self._seeds

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Refuse options for the next :meth:`reset`: these environments have none, and empty ones pass."""
        values = options if isinstance(options, list) else [options or {}]
        first = next((one for one in values if one), None)
        if first is not None:
            raise ArgumentError(
                f"reset option {next(iter(first))!r}: these environments have none; "
                "give arguments when the environment is made"
            )

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the environment, once for each of the slots asked about."""
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the environment, for all slots."""
        self._refuse_some("set_attr", indices)
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environment, which holds all slots, once; return its result for each slot."""
        masks = self._batch.action_masks
        if method_name == "action_masks" and masks is not None:  # as sb3-contrib has it of single ones
            return [masks[slot] for slot in self._get_indices(indices)]
        self._refuse_some("env_method", indices)
        result = getattr(self.env, method_name)(*method_args, **method_kwargs)
        return [result] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Return whether there is such a wrapper, for each slot.

        Of ``Monitor``, ``True``: the infos have its statistics, as ``evaluate_policy`` wants them.
        """
        inside, found = self.env, wrapper_class is Monitor
        while not found and inside is not None:
            found = isinstance(inside, wrapper_class)
            inside = getattr(inside, "env", None)
        return [found for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[Array | None]:
        """Return images of the first worlds, 16 at the most."""
        if self.render_mode != "rgb_array":
            raise OrderError(
                f"images with render_mode {self.render_mode!r}: "
                "make the environment by parallel_env(..., render_mode='rgb_array')"
            )
        k = self._batch.world.agents
        agents = self.env.possible_agents[: RENDERED_SLOTS * k : k]
        return [self.env.render(agent) for agent in agents]

    def _own(self, obs: Array) -> Array:
        """Return observations as SB3 takes them, in an array that the next step leaves alone."""
        shown = self._show(obs)
        return shown.copy() if self._reused and np.may_share_memory(shown, obs) else shown

    def _stagger(self) -> None:
        """Let every slot's episode seem some steps old, evenly from none to one less than the limit."""
        device = self._batch.innermost.device
        saved = device.snapshot()
        elapsed = SlotMemory(device.config.spec, device.config.n_envs, saved.memory).elapsed
        elapsed[:] = np.linspace(0, device.config.limit, device.config.n_envs, endpoint=False)
        device.restore(saved)
        self._cut = self._batch.world.rows(elapsed > 0).copy()

    def _refuse_some(self, call: str, indices: VecEnvIndices) -> None:
        if indices is not None and sorted(set(self._get_indices(indices))) != list(range(self.num_envs)):
            raise ArgumentError(
                f"{call} for slots {indices!r}: one environment holds all {self.num_envs} slots; "
                "leave out indices"
            )


def _checked(env: Any) -> Batch:
    """Return an environment whose slots start over as SB3 expects, or refuse it."""
    if isinstance(env, PearlParallelEnv) and not env.autoreset:
        raise ArgumentError(
            "agents of autoreset=False leave when their episode ends, and SB3's slots start over: "
            "make the environment with autoreset=True"
        )
    if isinstance(env, PearlVectorEnv) and env.autoreset_mode is not AutoresetMode.SAME_STEP:
        raise ArgumentError(
            f"autoreset_mode is {env.autoreset_mode.name}, and SB3's slots start over in the step in which "
            "they end: make the environment with autoreset_mode='SameStep'"
        )
    if isinstance(env, (PearlParallelEnv, PearlVectorEnv)):
        batch = env.batch
        roles = sorted({*differing(batch, "observation_space"), *differing(batch, "action_space")})
        if roles:
            raise ArgumentError(
                f"SB3 has one policy for all agents, and {' and '.join(roles)} have other spaces than the "
                "widest: put pad_observations_v0 and pad_action_space_v0 around the environment"
            )
        return batch
    raise ArgumentError(
        f"{type(env).__name__} is no environment of this package; sb3_vec_env takes those of "
        "parallel_env and make_vec, in this package's wrappers or none"
    )


def _flags(actions: Array) -> Array:
    """Return flags as integers, which SB3's policies give as floats; what is none is left to be refused."""
    values = np.asarray(actions)
    whole = values.dtype.kind == "f" and ((values == 0) | (values == 1)).all()
    return values.astype(np.int8) if whole else actions


def _observations_for_sb3(space: Space[Any]) -> tuple[Callable[[Array], Array], Space[Any]]:
    """Return what makes observations SB3's, and the space of those."""
    if isinstance(space, Tuple):
        parts: tuple[Any, ...] = space.spaces
        starts = np.array([space.start for space in parts])
        shown: Space[Any] = MultiDiscrete([space.n for space in parts])
    elif isinstance(space, Discrete):
        starts, shown = np.array(space.start), Discrete(space.n)
    elif isinstance(space, MultiDiscrete):
        starts, shown = space.start, MultiDiscrete(space.nvec, dtype=space.dtype.type)
    else:
        return _as_they_are, space
    # SB3 encodes such numbers one-hot, from 0.
    return partial(_from_zero, starts) if starts.any() else _as_they_are, shown


def _from_zero(starts: Array, obs: Array) -> Array:
    shown: Array = obs - starts
    return shown


def _as_they_are(obs: Array) -> Array:
    return obs
