"""Overcooked as overcooked-ai has it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.spec import EnvSpec


class Kitchen:
    """The package's game, with an observation for each step, in the form of Gymnasium's environments."""

    def __init__(self, spec: EnvSpec) -> None:
        from overcooked_ai_py.mdp.overcooked_mdp import OvercookedGridworld

        cook_time = spec.options["cook_time"]
        options = {} if cook_time is None else {"cook_time": cook_time}
        self.mdp = OvercookedGridworld.from_layout_name(spec.options["layout"], **options)
        self.horizon = spec.options["horizon"]

    def reset(self, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin with both cooks in their places."""
        self.state = self.mdp.get_standard_start_state()
        return self._observed(), {}

    def step(self, actions: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Move both cooks."""
        self.state, infos = self.mdp.get_state_transition(self.state, actions)
        return (
            self._observed(),
            infos["sparse_reward_by_agent"],
            False,
            self.state.timestep == self.horizon,
            {},
        )

    def _observed(self) -> Any:
        return self.mdp.lossless_state_encoding(self.state, self.horizon)


def pairs_of(spec: EnvSpec, actions: npt.NDArray[np.integer[Any]]) -> list[tuple[Any, Any]]:
    """Return the package's actions of each pair of cooks."""
    from overcooked_ai_py.mdp.actions import Action

    named = [Action.INDEX_TO_ACTION[k] for k in actions.tolist()]
    return list(zip(named[::2], named[1::2], strict=True))
