"""RLlib's two ways in: many slots as one vector environment, or a few agents of one multi-agent environment.

Both functions return what ``ray.tune.register_env`` takes: a function that env runners call with their
``env_config`` and that makes the environment there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import pettingzoo
from gymnasium.spaces import Dict
from gymnasium.vector import AutoresetMode

from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.parallel import PearlParallelEnv, parallel_env
from pearl_marl.interfaces.vector import PearlVectorEnv, make_vec

from .base import in_wrappers

Creator = Callable[[Mapping[str, Any]], Any]


def rllib_vector_env(env_id: str, *, wrap: Callable[[Any], Any] | None = None, **arguments: Any) -> Creator:
    """Return the maker of vector environments for RLlib's env runners.

    ::

        tune.register_env("pearl", rllib_vector_env("CartPole"))
        config = PPOConfig().environment("pearl").env_runners(
            gym_env_vectorize_mode="vector_entry_point", num_envs_per_env_runner=1024
        )

    RLlib takes it that environments reset in NEXT_STEP mode, and does not look: of one in another mode it
    joins the end of an episode to the start of the next. So that mode is the only one here.

    Parameters
    ----------
    env_id
        A name of :func:`pearl_marl.list_envs`, in any case.
    wrap
        Puts wrappers of this package around the environment; given the environment, returns another.
    **arguments
        As in :func:`pearl_marl.make_vec`. RLlib's ``env_config`` adds to them.

    Raises
    ------
    ArgumentError
        Another reset mode is asked for, or ``copy=False``: RLlib keeps observations as long as episodes.
    """
    _check_vector_arguments(arguments)

    def create(config: Mapping[str, Any]) -> Any:
        chosen = {**arguments, **config}
        if "num_envs" not in chosen:
            raise ArgumentError(
                "env_config has no num_envs, which RLlib adds for vector environments: "
                "configure env_runners(gym_env_vectorize_mode='vector_entry_point')"
            )
        _check_vector_arguments(chosen)
        chosen["autoreset_mode"] = AutoresetMode.NEXT_STEP
        env = make_vec(env_id, chosen.pop("num_envs"), **chosen)
        mode = AutoresetMode.NEXT_STEP
        return in_wrappers(env, wrap, lambda it: isinstance(it, PearlVectorEnv) and it.autoreset_mode is mode)

    return create


def rllib_multi_agent_env(
    env_id: str, n_agents: int | None = None, *, wrap: Callable[[Any], Any] | None = None, **arguments: Any
) -> Creator:
    """Return the maker of multi-agent environments for RLlib's env runners.

    Each is RLlib's ``ParallelPettingZooEnv`` around a :func:`pearl_marl.parallel_env` whose agents leave
    when their episode ends. RLlib keeps a Python object for every step of every agent and manages a few
    thousand of them a second: this is for a few agents. For many take :func:`rllib_vector_env`.

    Where there are masks, observations are dicts of ``"observations"`` and ``"action_mask"``, as RLlib's
    ``ActionMaskingTorchRLModule`` takes them.

    Takes ``wrap`` as that does, and the arguments of :func:`pearl_marl.parallel_env`, to which RLlib's
    ``env_config`` adds.

    Raises
    ------
    ArgumentError
        Agents are to stay when their episode ends, or ``copy=False``.
    """
    _check_parallel_arguments(arguments)

    def create(config: Mapping[str, Any]) -> Any:
        chosen = {"n_agents": n_agents, **arguments, **config}
        _check_parallel_arguments(chosen)
        env = parallel_env(env_id, **{**chosen, "autoreset": False})
        env = in_wrappers(env, wrap, lambda it: isinstance(it, PearlParallelEnv) and not it.autoreset)
        from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

        return ParallelPettingZooEnv(_Masked(env) if env.batch.world.masked else env)

    return create


class _Masked(pettingzoo.utils.BaseParallelWrapper):  # type: ignore[misc]
    """Names observations beside masks as RLlib's ``ActionMaskingTorchRLModule`` asks for them."""

    def observation_space(self, agent: str) -> Dict:
        """Return the space, with the other name."""
        return Dict(_renamed(self.env.observation_space(agent)))

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Begin an episode."""
        observations, infos = self.env.reset(seed, options)
        return {agent: _renamed(obs) for agent, obs in observations.items()}, infos

    def step(self, actions: dict[str, Any]) -> Any:
        """Step once."""
        observations, *others = self.env.step(actions)
        return {agent: _renamed(obs) for agent, obs in observations.items()}, *others


def _renamed(observation: Mapping[str, Any]) -> dict[str, Any]:
    return {"action_mask": observation["action_mask"], "observations": observation["observation"]}


def _check_vector_arguments(arguments: Mapping[str, Any]) -> None:
    mode = arguments.get("autoreset_mode", AutoresetMode.NEXT_STEP)
    if mode not in (AutoresetMode.NEXT_STEP, AutoresetMode.NEXT_STEP.value):
        raise ArgumentError(
            f"autoreset_mode is {mode!r}; RLlib joins episodes wrongly in any but NEXT_STEP: leave it out"
        )
    _check_copy(arguments)


def _check_parallel_arguments(arguments: Mapping[str, Any]) -> None:
    if arguments.get("autoreset", False):
        raise ArgumentError(
            f"autoreset is {arguments['autoreset']!r}; RLlib's agents leave when their episode ends: "
            "leave it out"
        )
    _check_copy(arguments)


def _check_copy(arguments: Mapping[str, Any]) -> None:
    if not arguments.get("copy", True):
        raise ArgumentError(
            "copy is False; RLlib keeps observations as long as episodes, and the next step would overwrite "
            "them: leave it out"
        )
