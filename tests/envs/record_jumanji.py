"""Records episodes of the game 2048 of the package ``jumanji``, for ``test_game2048.py`` to replay.

    python -m venv oracle && oracle/bin/pip install jumanji==1.1.2
    oracle/bin/python tests/envs/record_jumanji.py tests/envs/jumanji.npz

The package needs JAX, so it has an environment of its own. Of each step the action and the new tile are
recorded, and a checksum of what the package says: the board, the reward, the mask and the end.
"""

from __future__ import annotations

import sys
import zlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jumanji.environments import Game2048
from jumanji.environments.logic.game_2048.utils import move

CASES = {4: 740, 3: 440, 2: 200}
"""How many episodes are played on boards of each size."""


def tile(slid: Any, after: Any) -> tuple[int, int, int]:
    """Return which of the free cells a new tile is in, how many there were, and the tile; 0 if none is."""
    where = np.flatnonzero(slid != after)
    if not len(where):
        return 0, 0, 0
    (cell,) = where
    free = np.flatnonzero(slid == 0)
    return int(np.searchsorted(free, cell)), len(free), int(after.ravel()[cell])


def checksum(board: Any, reward: float, mask: Any, over: bool) -> int:
    """Return eight bits of all that is said of a step."""
    parts = (
        np.uint8(board).tobytes(),
        np.float32(reward).tobytes(),
        np.uint8(mask).tobytes(),
        np.uint8(over).tobytes(),
    )
    return zlib.crc32(b"".join(parts)) & 255


def record(size: int, episodes: int) -> dict[str, Any]:
    env, generator = Game2048(board_size=size), np.random.default_rng(size)
    step, slide = jax.jit(jax.vmap(env.step)), jax.jit(jax.vmap(move))
    state, timestep = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(size), episodes))
    rows: dict[str, list[Any]] = {"actions": [], "tiles": [], "checks": [], "running": []}
    board = np.asarray(state.board)
    rows["tiles"].append([tile(np.zeros_like(one), one) for one in board])
    masks = np.asarray(state.action_mask)
    none = [0] * episodes
    rows["checks"].append([checksum(*one) for one in zip(board, none, masks, none, strict=True)])
    running = np.ones(episodes, bool)
    while running.any():
        # Mostly legal actions, and now and then one that changes nothing.
        chances = generator.random((episodes, 4)) * (masks + 0.4)
        actions = chances.argmax(1)
        slid, _ = slide(state.board, jnp.int32(actions))
        state, timestep = step(state, jnp.int32(actions))
        board, masks = np.asarray(state.board), np.asarray(state.action_mask)
        said = board, np.asarray(timestep.reward), masks, np.asarray(timestep.last())
        rows["actions"].append(actions)
        rows["running"].append(running)
        pairs = zip(np.asarray(slid), board, running, strict=True)
        rows["tiles"].append([tile(a, b) if on else (0, 0, 0) for a, b, on in pairs])
        parts = zip(*said, running, strict=True)
        rows["checks"].append([checksum(*one) if on else 0 for *one, on in parts])
        running = running & ~said[3]
    arrays = {key: np.array(row, np.uint8) for key, row in rows.items()}
    return {**arrays, "actions": arrays["actions"] * arrays["running"]}


def main() -> None:
    arrays, count = {}, 0
    for size, episodes in CASES.items():
        columns = record(size, episodes)
        count += int(columns["running"].sum())
        arrays.update({f"{size}/{key}": value for key, value in columns.items()})
    np.savez_compressed(sys.argv[1], **arrays)
    print(f"{count:,} steps")


if __name__ == "__main__":
    main()
