"""Our worlds for other packages' trainers of single agents, which share one policy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.benchmark.training import TrainingTask
from pearl_marl.interfaces.parallel import parallel_env
from pearl_marl.wrappers import agent_indicator_v0


def environments(task: TrainingTask, n: int) -> Any:
    """Return worlds of ``n`` agents, of which each observes at the end which of its world it is."""
    return agent_indicator_v0(parallel_env(task.env_id, n_agents=n, **dict(task.options)))


def indicated(obs: npt.NDArray[Any], agents: int) -> npt.NDArray[np.float32]:
    """Return vectors as those environments have them, of what worlds of so many agents return."""
    which = np.tile(np.eye(agents, dtype=np.float32), (len(obs) // agents, 1))
    return np.concatenate((obs, which), 1, dtype=np.float32)
