"""The AEC form: PettingZoo's conversion of the parallel one, with actions checked at once."""

from __future__ import annotations

from typing import Any

from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from pearl_marl.batch.actions import refuse_first, why_not
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.parallel import parallel_env


def raw_env(env_id: str, n_agents: int = 1, **arguments: Any) -> Any:
    """Make the AEC form, without PettingZoo's check of the order of calls.

    Takes what :func:`parallel_env` takes but ``autoreset``: turn by turn, agents leave when their
    episode ends.
    """
    if arguments.pop("autoreset", False):
        raise ArgumentError("the AEC form has no autoreset: its agents leave when their episode ends")
    return _CheckedAEC(parallel_env(env_id, n_agents, autoreset=False, **arguments))


def env(env_id: str, n_agents: int = 1, **arguments: Any) -> Any:
    """Make the AEC form; takes what :func:`raw_env` takes."""
    return OrderEnforcingWrapper(raw_env(env_id, n_agents, **arguments))


class _CheckedAEC(parallel_to_aec_wrapper):  # type: ignore[misc]
    """PettingZoo's conversion, which by itself would notice a bad action only at the end of the round."""

    def step(self, action: Any) -> None:
        agent = self.agent_selection
        if not (self.terminations[agent] or self.truncations[agent]):
            space = self.env.unwrapped.spec.action_space
            if why_not(action, space):
                raise refuse_first([agent], [action], space)
        super().step(action)
