"""Records every transition of the games of poker of the package ``pgx``, for tests to look them up.

    python -m venv oracle && oracle/bin/pip install pgx==2.6.0
    oracle/bin/python tests/envs/record_pgx.py tests/envs/pgx.npz

The package needs JAX, so it has an environment of its own. Every state that a deal leads to is found by
running the package from it by every action, legal or not.
"""

from __future__ import annotations

import sys
from itertools import permutations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pgx


def kuhn_columns(state: Any) -> tuple[int, ...]:
    last = int(state._last_action) % 3  # -1 is none, which is 2 here
    return (*numbers(state._cards), int(state.current_player), last, *numbers(state._pot))


def leduc_columns(state: Any) -> tuple[int, ...]:
    return (
        *numbers(state._cards),
        *numbers(state._chips),
        int(state.current_player),
        int(state._first_player),
        int(state._round),
        int(state._last_action) >= 0,
        int(state._raise_count),
    )


def numbers(array: Any) -> list[int]:
    return np.asarray(array).tolist()


GAMES: dict[str, tuple[str, Any, list[tuple[int, ...]]]] = {
    "KuhnPoker": ("kuhn_poker", kuhn_columns, list(permutations(range(3), 2))),
    "LeducPoker": ("leduc_holdem", leduc_columns, sorted(set(permutations([0, 0, 1, 1, 2, 2], 3)))),
}


def record(game: str, columns: Any, deals: list[tuple[int, ...]]) -> dict[str, Any]:
    """Return states, what each player sees in them, masks, and what each action leads to."""
    env = pgx.make(game)
    step, observe = jax.jit(env.step), jax.jit(env.observe)
    begin = env.init(jax.random.PRNGKey(0))
    states, found = {}, []

    def key(state: Any) -> tuple[int, ...]:
        # A game that is over may be in a state that another one goes on from.
        return (*columns(state), bool(state.terminated))

    for deal in deals:
        for first in range(2):
            begun = begin.replace(_cards=jnp.int32(deal), current_player=jnp.int32(first))
            if hasattr(begin, "_first_player"):
                begun = begun.replace(_first_player=jnp.int32(first))
            states[key(begun)] = len(found)
            found.append(begun)
    rows: dict[str, list[Any]] = {"after": [], "reward": [], "seen": [], "mask": [], "legal": []}
    for state in growing(found):
        legal = np.asarray(state.legal_action_mask)
        after, reward = [], []
        for action in range(env.num_actions):
            now = state if state.terminated else step(state, action)
            if key(now) not in states and legal[action]:
                states[key(now)] = len(found)
                found.append(now)
            after.append(states.get(key(now), 0))
            reward.append(np.asarray(now.rewards))
        mask = np.zeros((2, env.num_actions), np.float32)
        mask[int(state.current_player)] = legal
        rows["after"].append(after)
        rows["reward"].append(reward)
        rows["seen"].append([np.asarray(observe(state, player)) for player in range(2)])
        # What it says of actions after the end is not about the game.
        rows["mask"].append(mask if not state.terminated else np.full_like(mask, np.nan))
        rows["legal"].append(legal)
    return {
        "states": np.array(list(states), np.uint8)[:, :-1],
        "over": np.array([bool(state.terminated) for state in found]),
        "starts": np.array(2 * len(deals)),
        "after": np.array(rows["after"], np.uint16),
        "reward": np.array(rows["reward"], np.float32),
        "seen": np.array(rows["seen"], np.int8),
        "mask": np.array(rows["mask"], np.float32),
        "legal": np.array(rows["legal"], np.bool_),
    }


def growing(found: list[Any]) -> Any:
    """Yield the elements of a list, and those that are added meanwhile."""
    for k in range(1_000_000):
        if k == len(found):
            return
        yield found[k]


def main() -> None:
    arrays, count = {}, 0
    for name, (game, columns, deals) in GAMES.items():
        table = record(game, columns, deals)
        count += int(table["legal"][~table["over"]].sum())
        arrays.update({f"{name}/{key}": value for key, value in table.items()})
        arrays[f"{name}/options"] = np.array("{}")
    np.savez_compressed(sys.argv[1], **arrays)
    print(f"{count:,} legal transitions")


if __name__ == "__main__":
    main()
