"""The spec of MiniGridKeyCorridor: MiniGrid's arguments."""

from __future__ import annotations

from typing import Any

from pearl_marl.checks import checked_integer
from pearl_marl.envs.mini_grid import Thing
from pearl_marl.envs.mini_grid_spec import checked_max_steps, rewards_until, spec_parts
from pearl_marl.spec import EnvSpec

from .step import BALL, KEY, THINGS, Rooms, make_golden

ROWS, SIZES = (1, 3), (3, 8)


def carried(state: Any) -> Thing | None:
    """Return what the agent of a state carries."""
    for first, thing in ((BALL, state.ball), (KEY, state.key)):
        if thing.carried:
            return THINGS[int(first + thing.colour)]
    return None


def configure(num_rows: int = 1, room_size: int = 3, max_steps: int | None = None) -> EnvSpec:
    """Return the spec under MiniGrid's keyword arguments.

    Parameters
    ----------
    num_rows
        Rows of rooms, 1 to 3.
    room_size
        Columns and rows of a room with its walls, 3 to 8.
    max_steps
        The time limit; None is ``30 * room_size**2``.
    """
    rows, size = checked_integer("num_rows", num_rows, *ROWS), checked_integer("room_size", room_size, *SIZES)
    rooms = Rooms(rows, size - 1, checked_max_steps(max_steps, 30 * size**2))

    def pose_ball(game: Any, state: Any) -> None:
        """Tell MiniGrid's game which ball is the one to take."""
        ball = state.ball
        game.obj = game.carrying if ball.carried else game.grid.get(ball.x, ball.y)

    return EnvSpec(
        **spec_parts(
            "KeyCorridor",
            "KeyCorridorS3R1",
            THINGS,
            rooms.boxes,
            {"num_rows": rows, "room_size": size, "max_steps": max_steps},
            carried=carried,
            pose_more=pose_ball,
        ),
        summary="Find the key to the room with the ball, and take it",
        rewards=rewards_until(rooms.max_steps),
        golden=make_golden(rooms),
        max_cycles=rooms.max_steps,
        configure=configure,
    )


SPEC = configure()
