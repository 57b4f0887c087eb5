"""Records every transition of some environments of the package ``bsuite``, for tests to look them up.

    python -m venv oracle && oracle/bin/pip install bsuite==0.3.6
    oracle/bin/python tests/envs/record_bsuite.py tests/envs/bsuite.npz

The package needs a dozen others, so it has an environment of its own. Every state that a start leads to is
found by running the package from it by every action.
"""

from __future__ import annotations

import json
import sys
import warnings
from itertools import product
from typing import Any

import numpy as np
from bsuite.environments.catch import Catch
from bsuite.environments.deep_sea import DeepSea
from bsuite.environments.memory_chain import MemoryChain

warnings.filterwarnings("ignore", message="Environment is in debug mode")

CASES: dict[str, tuple[Any, dict[str, Any]]] = {
    "Catch": (Catch, {}),
    "Catch, wide": (Catch, {"rows": 6, "columns": 12}),
    "Catch, least": (Catch, {"rows": 2, "columns": 2}),
    "DeepSea": (DeepSea, {"size": 10, "mapping_seed": 42}),
    "DeepSea, another": (DeepSea, {"size": 34, "mapping_seed": 3, "unscaled_move_cost": 0.3}),
    "DeepSea, debug": (DeepSea, {"size": 4, "randomize_actions": False}),
    "MemoryChain": (MemoryChain, {"memory_length": 5, "num_bits": 1}),
    "MemoryChain, short": (MemoryChain, {"memory_length": 1, "num_bits": 3}),
    "MemoryChain, size": (MemoryChain, {"memory_length": 2, "num_bits": 6}),
}


def starts(env: Any) -> list[tuple[int, ...]]:
    """Return the states that episodes start in, each equally likely."""
    if isinstance(env, Catch):
        return [(column, 0, env._columns // 2) for column in range(env._columns)]
    if isinstance(env, DeepSea):
        return [(0, 0)]
    return [(0, context, query) for context, query in product(range(2**env._num_bits), range(env._num_bits))]


def pose(env: Any, state: tuple[int, ...]) -> None:
    env._reset_next_step = False
    if isinstance(env, Catch):
        env._ball_x, env._ball_y, env._paddle_x = state
        env._paddle_y = env._rows - 1
    elif isinstance(env, DeepSea):
        env._row, env._column = state
    else:
        env._timestep, context, env._query = state
        env._context = np.array([context >> k & 1 for k in range(env._num_bits)])


def state_of(env: Any) -> tuple[int, ...]:
    if isinstance(env, Catch):
        return int(env._ball_x), int(env._ball_y), int(env._paddle_x)
    if isinstance(env, DeepSea):
        return int(env._row), int(env._column)
    return env._timestep, sum(int(bit) << k for k, bit in enumerate(env._context)), int(env._query)


def record(env: Any) -> dict[str, Any]:
    """Return states, what is seen in each, and what each action leads to."""
    begins = starts(env)
    env.reset()
    assert state_of(env) in begins
    states, seen, rows = {}, [], []
    for state in begins:
        pose(env, state)
        states[state] = len(states)
        seen.append(env._get_observation() if hasattr(env, "_get_observation") else env._observation())
    over = set()
    for state in states_in_turn(states):
        row = []
        for action in range(env.action_spec().num_values):
            if state in over:
                row.append((states[state], 0.0))
                continue
            pose(env, state)
            step = env._step(action)
            after = state_of(env)
            if after not in states:
                states[after] = len(states)
                seen.append(step.observation)
            assert np.array_equal(seen[states[after]], step.observation)
            if step.last():
                over.add(after)
            row.append((states[after], step.reward))
        rows.append(row)
    after, reward = np.moveaxis(np.array(rows, np.float64), -1, 0)
    return {
        "states": np.array(list(states), np.uint16),
        "seen": np.array(seen, np.float32),
        "starts": np.array(len(begins)),
        "over": np.array([state in over for state in states]),
        "after": after.astype(np.uint16),
        "reward": reward.astype(np.float32),
    }


def states_in_turn(states: dict[tuple[int, ...], int]) -> Any:
    """Yield the states, and those that are found meanwhile."""
    done = 0
    while done < len(states):
        yield list(states)[done]
        done += 1


def main() -> None:
    arrays, count = {}, 0
    for name, (make, options) in CASES.items():
        found = record(make(**options))
        count += int((~found["over"]).sum()) * found["after"].shape[1]
        arrays.update({f"{name}/{key}": value for key, value in found.items()})
        arrays[f"{name}/options"] = np.array(json.dumps(options))
    np.savez_compressed(sys.argv[1], **arrays)
    print(f"{count:,} transitions")


if __name__ == "__main__":
    main()
