"""Records episodes of CoinGame of the package ``jaxmarl``, for ``test_coin_game.py`` to replay.

    python -m venv oracle && oracle/bin/pip install jaxmarl==0.2.0
    oracle/bin/python tests/envs/record_coin_game.py tests/envs/coin_game.npz [TIMES_AS_MANY_EPISODES]

The package needs JAX, so it has an environment of its own. Beside what the package says, the numbers that
it drew are recorded: they are drawn again by the same keys.
"""

from __future__ import annotations

import json
import sys
import zlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxmarl.environments.coin_game import CoinGame

UNEVEN = [[0.3, 1.7, -2.6], [1.1, 0.7, -0.1]]
CASES: dict[str, dict[str, Any]] = {
    "default": {},
    "egocentric": {"egocentric": True, "cnn": True},
    "shared": {"shared_rewards": True, "cnn": True, "num_inner_steps": 20, "num_outer_steps": 5},
    "uneven": {
        "payoff_matrix": [[0.3, 1.7, -2.6], [1.1, 0.7, -0.1]],
        "num_inner_steps": 17,
        "num_outer_steps": 4,
    },
    "uneven, shared": {
        "payoff_matrix": [[0.3, 1.7, -2.6], [1.1, 0.7, -0.1]],
        "shared_rewards": True,
        "egocentric": True,
        "num_inner_steps": 9,
    },
    "one step a game": {"num_inner_steps": 1, "num_outer_steps": 30},
    "one game": {"num_inner_steps": 64, "num_outer_steps": 1, "payoff_matrix": [[3, 2, -4], [3, 2, -4]]},
}
EPISODES, STARTS = 32, 20_000
DIGITS = 3 ** np.arange(7, -1, -1)
"""Eight numbers from 0 to 2 are one, the first the most significant digit."""


def drawn(key: Any) -> Any:
    """Return the coins and the places of a new game that the package draws in a step with a key."""
    key, coins = jax.random.split(key)
    _, places = jax.random.split(key)
    draw = jax.random.randint
    return draw(coins, (2, 2), 0, 3).ravel(), draw(places, (4, 2), 0, 3).ravel()


def places(state: Any) -> Any:
    return jnp.concatenate([state.red_pos, state.blue_pos, state.red_coin_pos, state.blue_coin_pos], -1)


def record(name: str, options: dict[str, Any], episodes: int) -> dict[str, Any]:
    env = CoinGame(**options)
    steps = env.num_inner_steps * env.num_outer_steps
    step = jax.jit(jax.vmap(lambda k, s, a, b: env.step_env(k, s, {"0": a, "1": b})))
    key, start = jax.random.split(jax.random.PRNGKey(zlib.crc32(name.encode())))
    views, state = jax.vmap(env.reset)(jax.random.split(start, episodes))
    rows: dict[str, list[Any]] = {"actions": [], "draws": [], "rewards": []}
    rows |= {"places": [places(state) @ DIGITS], "seen": [seen(views)]}
    for t in range(steps):
        key, chosen, used = jax.random.split(key, 3)
        actions, keys = jax.random.randint(chosen, (2, episodes), 0, 5), jax.random.split(used, episodes)
        coins, game = jax.vmap(drawn)(keys)
        views, state, rewards, dones, infos = step(keys, state, *actions)
        last = (t + 1) % env.num_inner_steps == 0
        assert bool((infos["inner_episode_done"] == last).all())
        assert bool((dones["__all__"] == (t + 1 == steps)).all())
        rows["actions"].append(actions.T)
        rows["draws"].append(game @ DIGITS if last else coins @ DIGITS[:4])
        rows["rewards"].append(jnp.stack([rewards[k] for k in "01"], -1))
        rows["places"].append(places(state) @ DIGITS)
        rows["seen"].append(seen(views))
    types = {
        "actions": np.uint8,
        "rewards": np.float32,
        "draws": np.uint16,
        "places": np.uint16,
        "seen": np.uint8,
    }
    shape = env.observation_space("0").shape
    return {key: np.array(row, types.get(key, np.uint8)) for key, row in rows.items()} | {
        "options": np.array(json.dumps({"options": options, "shape": shape, "steps": steps}))
    }


def seen(views: Any) -> Any:
    """Return the observations of both, as bits."""
    both = np.stack([np.asarray(views[k]) for k in "01"], 1)
    return np.packbits(both.reshape(len(both), -1).astype(np.uint8), axis=1)


def main() -> None:
    path, times = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 1
    arrays, count = {}, 0
    for name, options in CASES.items():
        columns = record(name, options, EPISODES * times)
        count += columns["draws"].size
        arrays.update({f"{name}/{key}": value for key, value in columns.items()})
    _, state = jax.vmap(CoinGame().reset)(jax.random.split(jax.random.PRNGKey(0), STARTS))
    arrays["starts"] = np.array(places(state) @ DIGITS, np.uint16)
    np.savez_compressed(path, **arrays)
    print(f"{count:,} steps")


if __name__ == "__main__":
    main()
