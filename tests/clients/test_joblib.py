"""joblib hands environments to its workers as pickles."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

import pearl_marl

joblib = pytest.importorskip("joblib", reason="joblib is not installed: make test-clients")


def steps(env: Any) -> list[Any]:
    return [env.step_batch(np.zeros(env.batch_size, np.int64)).obs.tolist() for _ in range(3)]


@pytest.mark.parametrize("backend", ["loky", "multiprocessing", "threading"])
def test_workers_go_on(backend: str) -> None:
    environments = [pearl_marl.parallel_env(name, 4) for name in ("Taxi", "FrozenLake", "CoinGame")]
    environments += [pearl_marl.make_vec("MountainCar", 4), pearl_marl.make_vec("Blackjack", 4)]
    for env in environments:
        env.reset(seed=3)
    expected = [steps(env) for env in copy.deepcopy(environments)]
    assert joblib.Parallel(2, backend=backend)(joblib.delayed(steps)(env) for env in environments) == expected
