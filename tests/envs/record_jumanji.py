"""Records episodes of games of the package ``jumanji``, for ``episodes.py`` to replay.

    python -m venv oracle && oracle/bin/pip install jumanji==1.1.2
    oracle/bin/python tests/envs/record_jumanji.py tests/envs/jumanji.npz

The package needs JAX, so it has an environment of its own. Of each step the action and what was drawn are
recorded, and a checksum of what the package says: the board, the reward, the mask and the end.
"""

from __future__ import annotations

import json
import sys
import zlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jumanji.environments import Game2048, Minesweeper, Snake
from jumanji.environments.logic.game_2048.utils import move
from jumanji.environments.logic.minesweeper.generator import UniformSamplingGenerator


class OfTiles:
    """The game 2048: which of how many free cells a new tile is in, and the tile; 0 if there is none."""

    def __init__(self, **options: int) -> None:
        self.env = Game2048(**options)
        self._slide = jax.jit(jax.vmap(move))

    def action(self, action: Any) -> Any:
        return action

    def start(self, state: Any) -> list[Any]:
        return [self._tile(np.zeros_like(board), board) for board in state.board]

    def drawn(self, before: Any, action: Any, after: Any) -> list[Any]:
        slid, _ = self._slide(before.board, jnp.int32(action))
        return [self._tile(*boards) for boards in zip(np.asarray(slid), after.board, strict=True)]

    def board(self, state: Any, observation: Any) -> Any:
        return np.uint8(state.board)

    def stays(self, legal: Any) -> Any:
        return np.zeros_like(legal)

    def liking(self, state: Any, masks: Any) -> Any:
        """Mostly legal actions, and now and then one that changes nothing."""
        return masks + 0.4

    def _tile(self, slid: Any, after: Any) -> list[int]:
        where = np.flatnonzero(slid != after)
        if not len(where):
            return [0, 0, 0]
        (cell,) = where
        free = np.flatnonzero(slid == 0)
        return [int(np.searchsorted(free, cell)), len(free), int(after.ravel()[cell])]


class OfSnake:
    """Snake: which of how many free cells a new fruit is in, and in which cell the snake starts."""

    def __init__(self, **options: int) -> None:
        self.env = Snake(**options, time_limit=1_000_000)

    def action(self, action: Any) -> Any:
        return action

    def start(self, state: Any) -> list[Any]:
        heads = np.argmax(state.body.reshape(len(state.body), -1), 1)
        rows = zip(self._fruits(state), heads, strict=True)
        return [[*fruit, int(head)] for fruit, head in rows]

    def drawn(self, before: Any, action: Any, after: Any) -> list[Any]:
        eaten = after.length > before.length
        return [fruit if new else [0, 0] for fruit, new in zip(self._fruits(after), eaten, strict=True)]

    def board(self, state: Any, observation: Any) -> Any:
        """The last plane is a share of the length, rounded as XLA divides, so its numerators are taken."""
        planes = np.array(observation.grid)
        planes[..., 4] *= state.body_state.max((1, 2), keepdims=True)
        whole = np.rint(planes)
        assert abs(planes - whole).max() < 1e-4
        return np.uint8(whole)

    def stays(self, legal: Any) -> Any:
        """A snake that ran into something is not looked at: the package lets its head leave the grid."""
        return ~legal

    def liking(self, state: Any, masks: Any) -> Any:
        """Mostly what leads to the fruit, and now and then what ends the episode."""
        head, fruit = (np.stack(cell, 1)[:, None] for cell in (state.head_position, state.fruit_position))
        ways = head + np.asarray(self.env.MOVES)
        nearer = np.abs(ways - fruit).sum(2) < np.abs(head - fruit).sum(2)
        return masks * (1 + nearer) + 0.2

    def _fruits(self, state: Any) -> list[list[int]]:
        free = ~state.body.reshape(len(state.body), -1)
        cells = state.fruit_position.row * state.body.shape[2] + state.fruit_position.col
        return [[int(row[:cell].sum()), int(row.sum())] for row, cell in zip(free, cells, strict=True)]


class OfMines:
    """Minesweeper: where the mines are."""

    def __init__(self, **options: int) -> None:
        self.env = Minesweeper(UniformSamplingGenerator(**options))

    def action(self, action: Any) -> Any:
        return np.stack(np.divmod(action, self.env.num_cols), -1)

    def start(self, state: Any) -> list[Any]:
        return np.sort(state.flat_mine_locations, 1).tolist()

    def drawn(self, before: Any, action: Any, after: Any) -> list[Any]:
        return [[]] * len(action)

    def board(self, state: Any, observation: Any) -> Any:
        return np.int8(observation.board)

    def stays(self, legal: Any) -> Any:
        return np.zeros_like(legal)

    def liking(self, state: Any, masks: Any) -> Any:
        """Mines and explored cells the more, the higher the number of the game."""
        daring = np.linspace(0.4, 1, len(masks))[:, None]
        liked = np.where(masks, 1, daring - 0.03)
        np.put_along_axis(liked, state.flat_mine_locations, daring, 1)
        return liked


CASES: dict[str, tuple[Any, dict[str, int], int, int]] = {
    "Game2048": (OfTiles, {"board_size": 4}, 4, 740),
    "Game2048, 3": (OfTiles, {"board_size": 3}, 3, 440),
    "Game2048, 2": (OfTiles, {"board_size": 2}, 2, 200),
    "Snake": (OfSnake, {"num_rows": 12, "num_cols": 12}, 0, 640),
    "Snake, small": (OfSnake, {"num_rows": 3, "num_cols": 4}, 1, 400),
    "Minesweeper": (OfMines, {"num_rows": 10, "num_cols": 10, "num_mines": 10}, 0, 1_230),
    "Minesweeper, small": (OfMines, {"num_rows": 3, "num_cols": 5, "num_mines": 4}, 1, 400),
}
"""The game of each case, its options, a seed, and how many episodes are played."""


def checksum(board: Any, reward: Any, mask: Any, over: Any) -> int:
    """Return eight bits of all that is said of a step."""
    parts = board, np.float32(reward), np.uint8(mask), np.uint8(over)
    return zlib.crc32(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)) & 255


def record(game: Any, seed: int, episodes: int) -> dict[str, Any]:
    env, generator = game.env, np.random.default_rng(seed)
    step = jax.jit(jax.vmap(env.step))
    begun, timestep = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(seed), episodes))
    rows: dict[str, list[Any]] = {"actions": [], "drawn": [], "checks": [], "running": []}

    def said(state: Any, timestep: Any) -> list[Any]:
        observation = timestep.observation
        board = game.board(state, observation)
        mask = np.asarray(observation.action_mask).reshape(episodes, -1)
        return [board, np.asarray(timestep.reward), mask, np.asarray(timestep.last())]

    state = jax.tree.map(np.asarray, begun)
    start, shown = game.start(state), said(state, timestep)
    nothing = np.zeros(episodes)
    rows["checks"].append([checksum(*one) for one in zip(shown[0], nothing, shown[2], nothing, strict=True)])
    running = np.ones(episodes, bool)
    while running.any():
        masks = shown[2]
        actions = (generator.random(masks.shape) * game.liking(state, masks)).argmax(1)
        following, timestep = step(state, jnp.int32(game.action(actions)))
        before, state = state, jax.tree.map(np.asarray, following)
        stays = game.stays(masks[np.arange(episodes), actions])
        drawn = game.drawn(before, actions, state)
        last, shown = shown, said(state, timestep)
        for k in (0, 2):
            shown[k] = np.where(stays.reshape(-1, *[1] * (shown[k].ndim - 1)), last[k], shown[k])
        rows["actions"].append(actions)
        rows["running"].append(running)
        rows["drawn"].append([one if on else [0] * len(one) for one, on in zip(drawn, running, strict=True)])
        parts = zip(*shown, running, strict=True)
        rows["checks"].append([checksum(*one) if on else 0 for *one, on in parts])
        running = running & ~shown[3]
    arrays = {key: np.array(row, np.uint8) for key, row in rows.items()}
    arrays["start"] = np.array(start, np.uint8)
    return {**arrays, "actions": arrays["actions"] * arrays["running"]}


def main() -> None:
    arrays: dict[str, Any] = {}
    for name, (game, options, seed, episodes) in CASES.items():
        columns = record(game(**options), seed, episodes)
        print(f"{name}: {int(columns['running'].sum()):,} steps")
        arrays.update({f"{name}/{key}": value for key, value in columns.items()})
        arrays[f"{name}/options"] = np.array(json.dumps(options))
    np.savez_compressed(sys.argv[1], **arrays)


if __name__ == "__main__":
    main()
