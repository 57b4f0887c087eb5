"""Many starts of an environment, to be held against the law that they follow."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl import EnvSpec
from pearl_marl.devices import BatchConfig, Native


def started(spec: EnvSpec, n: int, seed: int) -> list[npt.NDArray[Any]]:
    """Return the columns of ``n`` starts, by the kernel: other tests hold that against the reference."""
    device = Native()
    device.open(BatchConfig(spec=spec, n_envs=n))
    device.reset(seed=seed)
    return list(device.state().T.astype(np.int64))
