"""BenchMARL's task of an environment: its algorithms run on the worlds of :func:`to_torchrl` as they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarl.environments import TaskClass
from gymnasium.spaces import Box
from torchrl.data import Composite
from torchrl.envs import EnvBase

from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.parallel import PearlParallelEnv, parallel_env

from .base import in_wrappers
from .torchrl import to_torchrl


def benchmarl_task(
    env_id: str, *, state: bool = False, wrap: Callable[[Any], Any] | None = None, **arguments: Any
) -> PearlTask:
    """Return the task of an environment, as BenchMARL's ``Experiment`` takes it.

    ::

        Experiment(benchmarl_task("LevelBasedForaging"), MappoConfig.get_from_yaml(), ...)

    Its worlds are BenchMARL's environments: ``on_policy_n_envs_per_worker`` and the like say how many.

    Parameters
    ----------
    env_id
        A name of :func:`pearl_marl.list_envs`, in any case.
    state
        Whether critics and mixers get a world's state instead of all observations: see :func:`to_torchrl`.
    wrap
        Puts wrappers of this package around the environment; given the environment, returns another.
        BenchMARL pickles tasks, so it is a function that can be imported.
    **arguments
        As in :func:`pearl_marl.parallel_env`.

    Raises
    ------
    ArgumentError
        What :func:`pearl_marl.parallel_env` and :func:`to_torchrl` refuse; ``n_agents``; or there is no time
        limit, which evaluation needs.
    """
    if "n_agents" in arguments:
        raise ArgumentError(
            f"n_agents is {arguments['n_agents']!r}; BenchMARL says how many worlds there are: set "
            "on_policy_n_envs_per_worker or off_policy_n_envs_per_worker of its ExperimentConfig"
        )
    return PearlTask(env_id, {"state": state, "wrap": wrap, **arguments})


class PearlTask(TaskClass):  # type: ignore[misc]  # benchmarl has no types
    """An environment of this package as a task of BenchMARL; made by :func:`benchmarl_task`."""

    def __init__(self, name: str, config: dict[str, Any]) -> None:
        super().__init__(name, config)
        one = self._make(None)  # refuses what is wrong now, not when the experiment is under way
        if not one.max_cycles:
            raise ArgumentError(
                f"{name} has no time limit here, and BenchMARL's evaluation needs one: give max_cycles"
            )
        self._agents = one.env.agents_per_world
        self._continuous = isinstance(one.env.batch.action_space, Box)
        one.close()

    def _make(self, n_agents: int | None) -> Any:
        arguments = dict(self.config)
        state, wrap = arguments.pop("state"), arguments.pop("wrap")
        env = parallel_env(self.name, n_agents, **arguments)
        return to_torchrl(in_wrappers(env, wrap, lambda it: isinstance(it, PearlParallelEnv)), state=state)

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Return what makes an environment of so many worlds."""

        def make() -> EnvBase:
            env = self._make(num_envs * self._agents)
            env.set_seed(seed)
            return env.to(device)

        return make

    def supports_continuous_actions(self) -> bool:
        """Return whether actions are numbers of a ``Box``."""
        return self._continuous

    def supports_discrete_actions(self) -> bool:
        """Return whether they are integers."""
        return not self._continuous

    def max_steps(self, env: EnvBase) -> int:
        """Return the time limit."""
        limit: int = env.max_cycles
        return limit

    def has_render(self, env: EnvBase) -> bool:
        """Return that BenchMARL can make no film of it."""
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """Return the names of the agents in each group."""
        groups: dict[str, list[str]] = env.group_map
        return groups

    def observation_spec(self, env: EnvBase) -> Composite:
        """Return the spec of one world's observations."""
        return self._of_groups(env, "observation")

    def action_mask_spec(self, env: EnvBase) -> Composite | None:
        """Return the spec of its masks, if there are any."""
        spec = env.full_observation_spec_unbatched
        masked = all("action_mask" in spec[name].keys() for name in env.group_map)  # noqa: SIM118  # no dict
        return self._of_groups(env, "action_mask") if masked else None

    def action_spec(self, env: EnvBase) -> Composite:
        """Return the spec of its actions."""
        return env.full_action_spec_unbatched

    def state_spec(self, env: EnvBase) -> Composite | None:
        """Return the spec of its state, if that is shown."""
        spec = env.full_observation_spec_unbatched
        return Composite({"state": spec["state"].clone()}) if self.config["state"] else None

    def info_spec(self, env: EnvBase) -> None:
        """Return that there is nothing else."""
        return

    @staticmethod
    def env_name() -> str:
        """Return under what name BenchMARL logs it."""
        return "pearl"

    def _of_groups(self, env: EnvBase, key: str) -> Composite:
        spec = env.full_observation_spec_unbatched
        return Composite(
            {
                name: Composite({key: spec[name, key].clone()}, shape=spec[name].shape)
                for name in env.group_map
            }
        )
