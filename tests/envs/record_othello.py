"""Records games of Othello of the package ``pgx``, for ``test_othello.py`` to replay.

    python -m venv oracle && oracle/bin/pip install pgx==2.6.0
    oracle/bin/python tests/envs/record_othello.py tests/envs/othello.npz

The package needs JAX, so it has an environment of its own. Moves follow from a seed and the masks. Of each
move a checksum is recorded of what the package says: observations, the mask, rewards and the end.
"""

from __future__ import annotations

import sys
import zlib
from typing import Any

import numpy as np

GAMES, MOST_MOVES = 1_800, 130


def chances() -> Any:
    """Return two numbers from 0 to 1 for each move of each game, shape ``(moves, games, 2)``.

    They are those of NumPy's old generator, whose numbers stay what they are.
    """
    return np.random.RandomState(7).random_sample((MOST_MOVES, GAMES, 2))


def chosen(masks: Any, chance: Any) -> Any:
    """Return a move of each game, shape ``(games,)``: one of 500 is illegal."""
    masks = np.where(chance[:, :1] < 0.002, 1 - masks, masks)
    which = (chance[:, 1] * masks.sum(1)).astype(np.int64)
    return (masks.cumsum(1) == which[:, None] + 1).argmax(1)


def checksum(legal: Any, seen: Any, mask: Any, rewards: Any, over: Any) -> int:
    """Return eight bits of what is said after a move; boards after legal ones, and masks before the end."""
    parts = [rewards, over, *([seen] if legal else []), *([] if over else [mask])]
    return zlib.crc32(b"".join(np.int8(part).tobytes() for part in parts)) & 255


def main() -> None:
    import jax
    import jax.numpy as jnp
    import pgx

    env = pgx.make("othello")
    step, both = jax.jit(jax.vmap(env.step)), jnp.arange(2)
    look = jax.jit(jax.vmap(lambda state: jax.vmap(lambda player: env.observe(state, player))(both)))
    state = jax.jit(jax.vmap(env.init))(jax.random.split(jax.random.PRNGKey(0), GAMES))
    first = np.asarray(state.current_player)
    checks = np.zeros((MOST_MOVES, GAMES), np.uint8)
    running, every, count = np.ones(GAMES, bool), np.arange(GAMES), 0
    for move, chance in enumerate(chances()):
        if not running.any():
            break
        masks = np.int64(state.legal_action_mask)
        actions = chosen(masks, chance)
        state = step(state, jnp.int32(actions))
        said = masks[every, actions], look(state), state.legal_action_mask, state.rewards, state.terminated
        rows = zip(*(np.asarray(part) for part in said), strict=True)
        checks[move] = [checksum(*row) if on else 0 for row, on in zip(rows, running, strict=True)]
        count += int(running.sum())
        running = running & ~np.asarray(state.terminated)
    assert not running.any()
    np.savez_compressed(sys.argv[1], first=np.uint8(first), checks=checks, count=count)
    print(f"{count:,} moves")


if __name__ == "__main__":
    main()
