"""Minesweeper as jumanji and EnvPool have it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.spec import EnvSpec


def make(spec: EnvSpec) -> Any:
    """Return jumanji's environment."""
    from jumanji.environments import Minesweeper
    from jumanji.environments.logic.minesweeper.generator import UniformSamplingGenerator

    return Minesweeper(UniformSamplingGenerator(**spec.options))


def cells_of(spec: EnvSpec, actions: npt.NDArray[np.integer[Any]]) -> npt.NDArray[np.integer[Any]]:
    """Return the row and the column of each action."""
    return np.stack(np.divmod(actions, spec.options["num_cols"]), 1)
