"""Records episodes of the package ``or-gymnasium``, for ``test_inventory.py`` to replay.

    python -m venv oracle && oracle/bin/pip install or-gymnasium==0.1.0
    oracle/bin/python tests/envs/record_or_gymnasium.py tests/envs/or_gymnasium.npz

The package needs pandas, so it has an environment of its own. Orders and demands follow from a seed. Of each
step a checksum is recorded of what the package says: the observation, and the reward in fortieths of money,
without the discount, which are whole.
"""

from __future__ import annotations

import sys
import zlib
from typing import Any

import numpy as np

EPISODES, PERIODS = 3_400, 30


def inputs() -> tuple[Any, Any]:
    """Return orders, shape ``(periods, episodes, 3)``, and demands, ``(periods, episodes)``.

    They are those of NumPy's old generator, whose numbers stay what they are.
    """
    generator = np.random.RandomState(7)
    orders = generator.randint(0, [101, 91, 81], (PERIODS, EPISODES, 3))
    # Some episodes order little.
    orders = orders * generator.randint(1, 9, (EPISODES, 1)) // 8
    return orders, generator.poisson(20, (PERIODS, EPISODES))


def checksum(observation: Any, fortieths: Any) -> int:
    """Return eight bits of all that is said of a step."""
    return zlib.crc32(np.int32(observation).tobytes() + np.int32(fortieths).tobytes()) & 255


def main() -> None:
    from or_gymnasium import InvManagementLostSalesEnv

    env, (orders, demands) = InvManagementLostSalesEnv(), inputs()
    checks = np.zeros((PERIODS, EPISODES), np.uint8)
    env.dist = 5  # demands are given
    for episode in range(EPISODES):
        env.demand_dist = demands[:, episode]
        env.reset()
        for period in range(PERIODS):
            seen, reward, terminated, truncated, _ = env.step(orders[period, episode])
            fortieths = 40 * reward / 0.97**period
            assert abs(fortieths - round(fortieths)) < 1e-6
            assert (terminated, truncated) == (False, period == PERIODS - 1)
            checks[period, episode] = checksum(seen, round(fortieths))
    np.savez_compressed(sys.argv[1], checks=checks)
    print(f"{checks.size:,} steps")


if __name__ == "__main__":
    main()
